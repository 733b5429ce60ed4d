"""PLC and robot connections, chosen on the page in a real browser, and their effect."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
from helpers.browser import Browser, browser
from helpers.needs import needs
from helpers.ports import answers, free_port
from helpers.setuppage import (
    IN_FORCE,
    SMALL_TARGETS,
    TOO_WIDE,
    UNTRANSLATED,
    go,
    log_in,
    press,
    put_in_force,
    said,
    take_over,
)
from helpers.stagecell import PASSWORD, Newcomer, run

from edged.commands.stage import USER
from edged.config.chosenconnections import ChosenConnections, connections_of
from edged.config.reading import load
from edged.errors import ConfigError

CHANGE = 'document.querySelector("#plc-settings ~ details")'


async def save(page: Browser) -> None:
    """Check the chosen connections and put them in force."""
    await press(page, "Check these connections")
    await put_in_force(page)


@pytest.mark.long
@needs("chromium")
def test_a_plc_and_a_robot_are_connected_on_the_page(tmp_path: Path) -> None:
    """Connections are changed twice and back, an unsuitable brand is questioned, and failures change
    nothing."""
    first, second, lines = free_port(), free_port(), free_port()

    async def test(newcomer: Newcomer) -> None:
        config = newcomer.daemon.loaded.cell.config
        async with browser() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await take_over(page)
            await go(page, "plc")
            await page.until(CHANGE)
            await page.value(f"{CHANGE}.open = true")
            await page.type("[name=port]", str(first))
            await page.type("[name=writers]", "127.0.0.1/32, 192.168.10.2/32")
            await page.choose('[name="convention"]', "kuka_abc")
            await page.click("[name=socket]")
            await page.type("[name=socket-port]", str(lines))
            await page.choose('[name="brand"]', "fanuc")
            await page.until(said("FANUC shows"))
            assert await page.value(
                """[...document.querySelectorAll("button")]
                  .find((b) => b.textContent.trim() === "Check these connections").disabled"""
            )
            await press(page, "The PLC gets W P R, Rx Ry Rz (FANUC, Yaskawa)")
            assert [] == await page.violations()
            assert [] == await page.value(SMALL_TARGETS)
            await save(page)
            await page.until(said("As chosen on this page"))
            assert answers(first) and answers(lines) and not answers(config.modbus.port)
            chosen = newcomer.daemon.loaded.cell.config.modbus
            assert ["127.0.0.1/32", "192.168.10.2/32"] == chosen.writers
            assert "fixed_xyz" == chosen.convention

            with socket.create_server(("127.0.0.1", second)):
                await page.type("[name=port]", str(second))
                await press(page, "Check these connections")
                await press(page, "Use these settings")
                await press(page, "Put them in force")
                await page.until(said("the cell cannot run with it, and goes on as before"))
                assert answers(first)
            page.complaints.clear()  # about the refusal
            await press(page, "Put them in force")
            await page.until(IN_FORCE)
            assert answers(second) and not answers(first)
            await press(page, "As in the configuration file")
            await page.until(said("As in the configuration file."))
            await put_in_force(page)
            assert config.modbus == newcomer.daemon.loaded.cell.config.modbus
            await page.value(f"{CHANGE}.open = true")
            await page.type("[name=port]", str(first))
            await save(page)
            await page.until(said("As chosen on this page"))
            assert answers(first)

            await page.open(f"{newcomer.origin}/setup?pseudo#/plc", 360, 740)
            await page.until(CHANGE)
            await page.value(f"{CHANGE}.open = true")
            assert [] == await page.value(UNTRANSLATED)
            assert 0 == await page.value(TOO_WIDE)
            assert [] == page.complaints

    run(tmp_path, test, gige=False)


def test_what_was_chosen_counts_before_the_file(tmp_path: Path) -> None:
    """Chosen values override the file key by key, null removes a key or server, and the rest stays."""
    config = tmp_path / "cell.toml"
    config.write_text(
        '[cell]\nname = "c"\nrig = "rig.json"\njobs = "jobs"\n[cameras]\nsource = "virtual-inprocess"\n'
        '[modbus]\nport = 1602\nidle_s = 30.0\n[modbus.socket]\nbrand = "ur"\n'
        "[opcua]\nanonymous = true\nport = 4841\n"
    )
    file = tmp_path / "rig.connections.json"
    file.write_text(json.dumps({"modbus": {"port": 1702, "socket": None}, "opcua": None}))
    loaded = load(config)
    assert (1702, 30.0, None, None) == (
        loaded.modbus.port,
        loaded.modbus.idle_s,
        loaded.modbus.socket,
        loaded.opcua,
    )
    file.write_text(json.dumps({"opcua": {"port": 4842}}))
    loaded = load(config)
    assert loaded.opcua is not None
    assert (1602, 4842, True) == (loaded.modbus.port, loaded.opcua.port, loaded.opcua.anonymous)


@pytest.mark.parametrize(
    "content",
    [b"{", b"[]", b'{"modbus": 3}', b'{"zenoh": {}}', b"[" * 100_000, b'{"modbus": {"port": 99999999}}'],
)
def test_a_damaged_choice_is_named(tmp_path: Path, content: bytes) -> None:
    """The error names the damaged file."""
    config, file = tmp_path / "cell.toml", tmp_path / "rig.connections.json"
    config.write_text(
        '[cell]\nname = "c"\nrig = "rig.json"\njobs = "jobs"\n[cameras]\nsource = "virtual-inprocess"\n'
    )
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"rig\.connections\.json"):
        load(config)


def test_a_choice_of_nothing_is_the_file(tmp_path: Path) -> None:
    """An empty choice leaves the configuration unchanged."""
    data = {"cell": {"name": "c"}, "modbus": {"port": 5}}
    assert data == connections_of(b"{}", tmp_path).over(data)
    assert {"cell": {}} == ChosenConnections().over({"cell": {}})
