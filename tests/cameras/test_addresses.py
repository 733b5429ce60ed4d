"""A camera in another network is found and gets a permanent address here; others are not changed."""

from __future__ import annotations

import io
import ipaddress
import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from helpers.browser import browser
from helpers.browsersession import PASSWORD
from helpers.gigecell import LEFT, NOBODY, RIGHT, Sensor, gige_camera
from helpers.needs import needs, needs_aravis
from helpers.setuppage import SMALL_TARGETS, TOO_WIDE, go, log_in, press, said, take_over
from helpers.stagecell import staged
from rich.console import Console

from edged.adapters.aravis import addresses, give_address, list_cameras, with_addresses
from edged.adapters.aravis.addresses import DiscoveredCamera, discover_cameras, free_address
from edged.commands.cameras import address as give
from edged.commands.cameras import cameras as list_them
from edged.commands.stage import USER
from edged.errors import CameraBusy, CameraSetupError, CameraUnreachable
from edged.sim.gige import genicam as g
from edged.sim.gige.camera import GigeCamera
from edged.sim.world import SERIALS

FOREIGN = "198.51.100.77"
SERIAL = "EDGED-LOST"
needs_camera = needs_aravis()
needs_chromium = needs("chromium")


@pytest.fixture(autouse=True)
def only_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    """Broadcast on loopback alone, where the virtual cameras listen."""
    host = ipaddress.IPv4Interface("127.0.0.1/8")
    monkeypatch.setattr("edged.adapters.aravis.addresses._ports", lambda: [("lo", host)])


def number_of(address: str) -> int:
    """An address as registers have it."""
    return int(ipaddress.IPv4Address(address))


@contextmanager
def lost(**identity: Any) -> Iterator[GigeCamera]:
    """A camera that says that it is in another network, so that it is reached by broadcasts alone."""
    with gige_camera(LEFT, SERIAL, Sensor(1), **identity) as camera:
        camera.registers.put(g.CURRENT_IP, number_of(FOREIGN))
        camera.registers.put(g.SUBNET_MASK, number_of("255.255.255.0"))
        yield camera


def heard(serial: str = SERIAL) -> DiscoveredCamera:
    """The camera from its answer to a broadcast."""
    return next(one for one in discover_cameras() if one.serial == serial)


def test_a_camera_of_another_network_is_heard_and_told_as_lost() -> None:
    """The lost camera is listed with MAC address, port and origin of its address; one of this network is
    not lost."""
    with lost():
        camera = heard()
        assert (FOREIGN, "lo", True, "DHCP") == (camera.address, camera.port, camera.is_lost, camera.ways)
    with gige_camera(LEFT, "EDGED-HERE", Sensor(1)) as here:
        assert not heard("EDGED-HERE").is_lost
        here.registers.put(g.IP_CONFIGURATION, 0x5)
        assert "persistent" == heard("EDGED-HERE").ways
        here.registers.put(g.CURRENT_IP, number_of("169.254.7.8"))
        assert "link-local" == heard("EDGED-HERE").ways


@pytest.mark.slow
def test_it_gets_an_address_here_and_keeps_it() -> None:
    """The camera gets the address by broadcast and keeps it in its persistent registers, and nobody
    controls it afterwards."""
    with lost() as camera:
        assert (NOBODY, True) == give_address(SERIAL, NOBODY)
        found = heard()
        assert (NOBODY, False) == (found.address, found.is_lost)
        assert number_of(NOBODY) == camera.registers.word(g.PERSISTENT_IP)
        assert number_of("255.0.0.0") == camera.registers.word(g.PERSISTENT_MASK)
        assert camera.registers.word(g.IP_CONFIGURATION) & 1
        assert not camera.controlled


@pytest.mark.slow
def test_a_free_address_is_one_that_nobody_has() -> None:
    """The proposal keeps the last part of the camera's address, if no device has it; otherwise it is the
    next free one."""
    with lost():
        camera = heard()
        assert "127.0.0.77" == free_address(camera, set())
        assert "127.0.0.10" == free_address(camera, {"127.0.0.77"})
    with gige_camera("127.0.0.77", "EDGED-THERE", Sensor(2)):
        assert "127.0.0.10" == free_address(camera, set())


@pytest.mark.slow
def test_a_camera_that_a_program_controls_is_left_alone() -> None:
    """A camera that another program controls is refused, by its register or by its own refusal."""
    with gige_camera(RIGHT, "EDGED-TAKEN", Sensor(1)) as camera:
        camera.steal_control()
        with pytest.raises(CameraBusy, match="a program controls it"):
            give_address("EDGED-TAKEN", NOBODY)
    with lost() as camera:
        camera.steal_control()
        with pytest.raises(CameraBusy, match=r"it does not take .*: a program controls it"):
            give_address(SERIAL, NOBODY)
        assert camera.address == LEFT


@pytest.mark.long
def test_addresses_that_do_not_fit_are_refused() -> None:
    """An address of another network, of another camera, of this host, and an invalid one are refused."""
    with lost(), gige_camera(RIGHT, "EDGED-OTHER", Sensor(2)):
        for wanted in (FOREIGN, RIGHT, "127.0.0.1", "here", "1.2.3"):
            with pytest.raises(CameraSetupError, match="expected an address of"):
                give_address(SERIAL, wanted)
        with pytest.raises(CameraUnreachable, match="hears a broadcast"):
            give_address("EDGED-NONE")


@pytest.mark.slow
def test_one_that_cannot_keep_an_address_says_so() -> None:
    """A camera without persistent registers gets the address until it is switched off."""
    with lost() as camera:
        word = camera.registers.word
        keep = camera.registers.hooks[g.PERSISTENT_IP]
        camera.registers.hooks[g.PERSISTENT_IP] = lambda _: 0x8004
        assert (NOBODY, False) == give_address(SERIAL, NOBODY)
        camera.registers.hooks[g.PERSISTENT_IP] = keep
        assert 0 == word(g.PERSISTENT_IP)


@pytest.mark.parametrize("answer", [b"", b"\0" * 7, b"\0\0\0\3\0\x08\0\x33" + b"\0" * 8, b"\xff" * 300])
def test_an_answer_that_is_none_is_no_camera(answer: bytes) -> None:
    """A broken answer counts as no camera."""
    host = ipaddress.IPv4Interface("127.0.0.1/8")
    assert addresses._heard(answer, "lo", host) is None  # noqa: SLF001  (what reads foreign bytes)


@needs_camera
@pytest.mark.long
def test_the_list_names_it_and_the_command_that_helps(capsys: pytest.CaptureFixture[str]) -> None:
    """The list and its JSON show a lost camera, and the command that helps; the command gives it an
    address."""
    with lost():
        ((info, camera),) = [both for both in with_addresses(list_cameras()) if both[0].serial == SERIAL]
        assert camera is not None
        assert (FOREIGN, True) == (info.address, camera.is_lost)

        out = io.StringIO()
        list_them(as_json=False, console=Console(file=out, width=70))
        assert f"help: edged cameras --give-address {SERIAL}\n" in out.getvalue()
        assert FOREIGN in out.getvalue().partition("help:")[0]
        list_them(as_json=True, console=Console(file=out))
        (document,) = [one for one in json.loads(capsys.readouterr().out) if one["serial"] == SERIAL]
        assert ("DHCP", False) == (document["address_by"], document["in_network"])

        out = io.StringIO()
        assert 0 == give(SERIAL, NOBODY, Console(file=out, width=250))
        assert f"{SERIAL} is at {NOBODY}, and keeps it" in out.getvalue()
        assert 1 == give("EDGED-NONE", "", Console(file=out, width=250))


@needs_camera
@pytest.mark.long
async def test_the_page_shows_it_and_moves_it_by_one_click(tmp_path: Path) -> None:
    """The page shows a lost camera and moves it by one click, except if another program controls it."""
    async with staged(tmp_path) as newcomer:
        with lost() as camera:
            found = {one["serial"]: one for one in (await newcomer.ask("GET", "cameras"))["found"]}
            told = [found[SERIAL][name] for name in ("address", "address_by", "is_lost", "trouble")]
            assert [FOREIGN, "DHCP", True, "wrong subnet"] == told
            assert [False, None] == [found[SERIALS[0]][name] for name in ("is_lost", "trouble")]

            body = {**newcomer.token, "serial": SERIAL}
            camera.steal_control()
            refused = await newcomer.ask("POST", "cameras/address", body, 503)
            assert "a program controls it" in refused["detail"]
            camera.release_control()
            given = await newcomer.ask("POST", "cameras/address", body)
            assert {"address": "127.0.0.77", "is_kept": True} == given
            found = {one["serial"]: one for one in (await newcomer.ask("GET", "cameras"))["found"]}
            assert ("127.0.0.77", False) == (found[SERIAL]["address"], found[SERIAL]["is_lost"])
            given = await newcomer.ask("POST", "cameras/address", {**body, "address": "127.0.0.78"})
            assert {"address": "127.0.0.78", "is_kept": True} == given
            refused = await newcomer.ask("POST", "cameras/address", {**body, "address": "10.9.9.9"}, 503)
            assert "10.9.9.9: expected an address of" in refused["detail"]


def test_no_socket_is_left() -> None:
    """Ports that cannot be asked are skipped, and no socket stays open."""
    before = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    number = before.fileno()
    before.close()
    discover_cameras()
    after = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        assert number == after.fileno()
    finally:
        after.close()


@needs_camera
@needs_chromium
@pytest.mark.long
async def test_a_person_moves_it_by_the_button_beside_it(tmp_path: Path) -> None:
    """In a browser the lost camera alone has the trouble and the button, and can be used as left or right
    only afterwards; the new address, or that a program controls it, is shown."""
    tile = f'[...document.querySelectorAll(".tile")].find((tile) => tile.innerText.includes("{SERIAL}"))'
    buttons = '[...document.querySelectorAll("button")].filter((b) => b.innerText.startsWith("Give it an"))'
    async with staged(tmp_path) as newcomer, browser() as page:
        with lost() as camera:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (360, 740))
            await take_over(page)
            await go(page, "cameras")
            await page.until(f'{tile}?.innerText.includes("its address is in another subnet")')
            assert 1 == await page.value(f"{buttons}.length")
            assert await page.value(f"{tile}.contains({buttons}[0])")
            assert not await page.value(f'{tile}.innerText.includes("Use as left")')
            assert f"{FOREIGN} · DHCP" in await page.value(f"{tile}.innerText")
            assert [] == await page.violations()
            assert [] == await page.value(SMALL_TARGETS)
            assert 0 == await page.value(TOO_WIDE)

            camera.steal_control()
            await press(page, "Give it an address here")
            await page.until(said("Another computer controls a camera."))
            assert 1 == await page.value(f"{buttons}.length")
            camera.release_control()
            page.complaints.clear()  # the browser's own, of the answer that refuses

            await press(page, "Give it an address here")
            await page.until(said(f"{SERIAL} is at 127.0.0.77 now, and keeps that."))
            # a look that was under way when it moved may still come, and then the last one
            await page.until(f"{tile}.innerText.includes('127.0.0.77 · persistent')")
            await page.until(f"{buttons}.length === 0 && !{tile}.querySelector('.wrong')")
            assert await page.value(f'{tile}.innerText.includes("Use as left")')
            assert number_of("127.0.0.77") == camera.registers.word(g.PERSISTENT_IP)
            assert [] == page.complaints
