"""A reload that fails is refused, whatever the reason, and systemd gets its end."""

from __future__ import annotations

import asyncio
import re
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.cells import small_rig
from helpers.plcmemories import S7Controller
from helpers.ports import free_port
from helpers.smallcell import SmallCell, SmallWorld, pictures
from helpers.snapshots import make_transform
from helpers.waiting import until

from edged.app import daemon as module
from edged.app.cell import LoadedCell, load_cell
from edged.app.daemon import Daemon
from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.events import Event, Snapshot
from edged.errors import ConfigError
from edged.files.rig import load_rig, save_rig
from edged.plc.registers import Number, ResultCode, StatusBit
from edged.sim.cell import VirtualCell, demo_part
from edged.sim.world import VirtualWorld


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LoadedCell]:
    """The configuration of a cell, and the loaded cell."""
    path = prepare_cell(
        tmp_path_factory.mktemp("cell"), VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False
    )
    return path, load_cell(path)


class Notes:
    """The messages to systemd."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def reloading(self) -> None:
        self.told.append("RELOADING")

    def reloaded(self, refused: str = "") -> None:
        self.told.append(f"READY {refused}")


def reloaded(cell: tuple[Path, LoadedCell], error: Exception, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The messages to systemd of a reload during which this error occurs."""

    def fail(path: Path) -> LoadedCell:
        raise error

    notes = Notes()

    async def main() -> None:
        with VirtualWorld(gige=False, rig=small_rig()) as world:
            daemon = Daemon(*cell, world=world)
            monkeypatch.setattr(daemon, "_notifier", notes)
            monkeypatch.setattr(module, "load_cell", fail)
            assert not await daemon.reload()

    asyncio.run(main())
    return notes.told


@pytest.mark.slow
@pytest.mark.parametrize(
    "error",
    [
        ConfigError("cell.toml", ["cycle.period: unknown key"]),
        OSError(5, "Input/output error"),
        PermissionError(13, "Permission denied"),
        RuntimeError("Could not determine home directory."),
        RecursionError("maximum recursion depth exceeded"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_whatever_cannot_be_read_is_a_refused_reload(
    cell: tuple[Path, LoadedCell], error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An unreadable file ends the reload with READY and the reason."""
    begun, ended = reloaded(cell, error, monkeypatch)
    assert "RELOADING" == begun
    assert str(error) in ended


@pytest.mark.slow
def test_a_bug_in_a_reload_shows_and_systemd_hears_that_it_is_over(
    cell: tuple[Path, LoadedCell], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bug in a reload is raised, and systemd gets the end of the reload."""
    told: list[str] = []
    monkeypatch.setattr(Notes, "reloaded", lambda _, refused="": told.append(refused))
    with pytest.raises(ZeroDivisionError):
        reloaded(cell, ZeroDivisionError("a bug"), monkeypatch)
    assert ["a bug, see the log"] == told


@pytest.mark.slow
def test_an_error_without_words_is_named(
    cell: tuple[Path, LoadedCell], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """An error without text is named by its class to systemd and in the log."""
    _, ended = reloaded(cell, TimeoutError(), monkeypatch)
    assert "READY TimeoutError" == ended
    assert "the running configuration stays: TimeoutError" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "content", "problem"),
    [
        ("cell.toml", '[cell]\nrig = "~nobody-of-this-name/rig.json"\n', "cell.rig"),
        ("rig.json", "[" * 100_000, "not JSON"),
    ],
)
def test_a_file_that_breaks_its_reader_is_a_mistake_in_it(
    tmp_path: Path, file: str, content: str, problem: str
) -> None:
    """An unknown home directory and a file of nothing but brackets are named as mistakes in that file."""
    path = prepare_cell(tmp_path, VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False)
    (tmp_path / file).write_text(content)
    with pytest.raises(ConfigError, match=problem):
        load_cell(path)


def _register(folder: Path) -> None:
    """Register the rig to another place of the robot."""
    path = folder / "rig.json"
    moved = make_transform((0.0, 0.0, 0.0), (100.0, 0.0, 0.0))
    save_rig(path, replace(load_rig(path), robot_from_rig=moved))


def _edit(file: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new))

    return edit


EXCHANGES: dict[str, Callable[[Path], None]] = {
    "registration": _register,
    "a limit of the job": _edit("jobs/flange/job.toml", "min_support = 0.3", "min_support = 0.35"),
    "the job's number": _edit("jobs/flange/job.toml", "number = 1", "number = 2"),
    "a keep-out zone": _edit(
        "cell.toml",
        "[zenoh]",
        '[[limits.keep_out]]\nname = "post"\nmin_mm = [900, 0, 0]\nmax_mm = [950, 9, 9]\n\n[zenoh]',
    ),
    "cameras": _edit("cell.toml", "timeout_s = 2.0", "timeout_s = 1.9"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", [*EXCHANGES, "nothing"])
async def test_a_valid_result_does_not_outlive_a_reload_that_exchanges_what_it_stands_on(
    what: str, cell: tuple[Path, LoadedCell], tmp_path: Path
) -> None:
    """A valid result ends with a reload that exchanges its basis, and stays without a change."""
    shutil.copytree(cell[0].parent, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "cell.toml"
    text = path.read_text().replace('mode = "free"\nperiod_s = 0.25', 'mode = "command"')
    path.write_text(
        text.replace("port = 1502", f"port = {free_port()}\nvalidity_s = 3600.0").split("[zenoh]")[0]
        + "[zenoh]\n"
    )
    with VirtualWorld(gige=False, rig=small_rig()) as world:
        daemon = Daemon(path, load_cell(path), world=world)
        running, servers = asyncio.create_task(daemon.run()), vars(daemon)["_servers"]
        await until(lambda: "modbus" in servers.started)
        modbus = servers.started["modbus"]

        def values() -> dict[str, Number]:
            return {register.name: value for register, value in modbus.values()}

        await until(lambda: values()["STATE"] == 1)
        modbus.write(
            7, {"COMMAND": 1, "JOB": 0, "CMD_SEQ": 5, "ACK_SEQ": 0, "CLIENT_HEARTBEAT": 0, "OPTIONS": 2}
        )
        await until(lambda: values()["DONE_SEQ"] == 5)
        before = values()
        assert before["STATUS_BITS"] & StatusBit.RESULT_VALID
        EXCHANGES.get(what, lambda _folder: None)(tmp_path)
        assert await daemon.reload()
        if what != "nothing":
            await until(lambda: values()["START_EPOCH"] != before["START_EPOCH"])
        after = values()
        is_kept = what == "nothing"
        assert is_kept == bool(after["STATUS_BITS"] & StatusBit.RESULT_VALID)
        assert is_kept == (before["CONFIG_CRC"] == after["CONFIG_CRC"])
        assert (ResultCode.OK if is_kept else ResultCode.RELOADED) == after["RESULT"]
        daemon.stop()
        await running


# --- a start in which a server hangs -------------------------------------------------------------------


class Seen:
    """Keeps the cycles."""

    def __init__(self) -> None:
        self.cycles = 0

    async def start(self) -> None: ...

    def announce(self, event: Event) -> None:
        self.cycles += isinstance(event, Snapshot)

    async def close(self) -> None: ...


@pytest.fixture
def hanging_opcua(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SmallCell:
    """A cell whose OPC UA server never starts."""
    small = SmallCell(tmp_path, source="virtual-inprocess")
    small.config.write_text(f"{small.config.read_text()}\n[opcua]\nport = {free_port()}\nanonymous = true\n")

    async def never(_self: object, _server: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr("edged.adapters.opcua.server.ServerThread._prepare", never)
    return small


@pytest.mark.long
async def test_a_cell_measures_whose_opcua_server_does_not_start(
    hanging_opcua: SmallCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cell measures though its OPC UA server does not start; page and metrics say so, and a reload
    works."""
    monkeypatch.setattr("edged.app.servers.START_S", 0.5)
    path, seen = hanging_opcua.config, Seen()
    with SmallWorld(pictures(hanging_opcua.virtual, 1)) as world:
        daemon = Daemon(path, load_cell(path), world=world, observers=[seen])
        running = asyncio.create_task(daemon.run())
        await until(lambda: seen.cycles > 2)
        parts = daemon._running  # noqa: SLF001  (what page and metrics ask)
        assert re.search("opcua on .*has not started within", str(parts.facts()["OPC UA"]["problem"]))
        assert 1 == parts.figures()["servers_failing"][1]
        assert await daemon.reload()
        daemon.stop()
        await running


@pytest.mark.long
def test_a_stop_does_not_wait_for_a_server_that_hangs(hanging_opcua: SmallCell) -> None:
    """A stop does not wait for a server that hangs."""
    path = hanging_opcua.config

    async def main() -> float:
        with SmallWorld(pictures(hanging_opcua.virtual, 1)) as world:
            daemon = Daemon(path, load_cell(path), world=world)
            running = asyncio.create_task(daemon.run())
            await asyncio.sleep(1.0)
            begun_s = time.monotonic()
            daemon.stop()
            await running
            return time.monotonic() - begun_s

    assert asyncio.run(main()) < 8.0


@pytest.mark.long
async def test_a_cell_measures_whose_plc_is_off_and_serves_it_when_it_comes(tmp_path: Path) -> None:
    """The cell measures while its PLC is off, says so, and writes to it, or after a reload to another one,
    once it is on."""
    small, seen, ports = SmallCell(tmp_path, source="virtual-inprocess"), Seen(), [free_port(), free_port()]
    path, text = small.config, small.config.read_text()

    def write(port: int) -> None:
        path.write_text(f'{text}\n[plc]\nhost = "127.0.0.1"\n[plc.s7]\nport = {port}\ndb = 100\n')

    write(ports[0])
    with SmallWorld(pictures(small.virtual, 1)) as world:
        daemon = Daemon(path, load_cell(path), world=world, observers=[seen])
        running = asyncio.create_task(daemon.run())
        await until(lambda: seen.cycles > 2)
        parts = daemon._running  # noqa: SLF001  (what page and metrics ask)
        await until(lambda: "refused" in str(parts.facts()["PLC"]["problem"]))
        assert (f"127.0.0.1:{ports[0]}", 0) == (
            parts.facts()["PLC"]["address"],
            parts.figures()["plc_reached"][1],
        )
        for port in ports:
            controller = S7Controller(port=port)
            try:
                write(port)
                assert await daemon.reload()
                await until(lambda: parts.figures()["plc_reached"][1])
                assert "problem" not in parts.facts()["PLC"]
                await until(lambda memory=controller: any(memory.get(64, 128)))
            finally:
                controller.stop()
        daemon.stop()
        await running
