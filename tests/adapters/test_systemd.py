"""The notify protocol on a real datagram socket, and the unit file."""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import subprocess
from pathlib import Path

import pytest
from annotated_types import Le
from helpers.snapshots import make_snapshot
from helpers.waiting import WHOLE_S

from edged.adapters.modbus import lineserver
from edged.adapters.systemd import SystemdNotifier
from edged.adapters.web import places
from edged.adapters.zenoh import session
from edged.app.process import DESCRIPTORS
from edged.config.servers import ModbusSection
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import Event, Idle

UNIT = Path(__file__).parents[2] / "systemd" / "edged.service"
READY = CellState(CellPhase.READY, True, True, "flange", 1, 0)
BUSY = CellState(CellPhase.BUSY, True, True, "flange", 1, 0)
FAULT = CellState(CellPhase.FAULT, False, False, "flange", 1, 0, "camera left:\nunplugged", 101)
STOPPING = CellState(CellPhase.STOPPING, False, False, "flange", 1, 0)


class Manager:
    """systemd's end of the socket."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.setblocking(False)

    def messages(self) -> list[list[str]]:
        """The messages so far, one list of assignments per datagram."""
        found = []
        while True:
            try:
                found.append(self.socket.recv(4096).decode().split("\n"))
            except BlockingIOError:
                return found

    def told(self) -> list[str]:
        """All assignments in one list."""
        return [line for message in self.messages() for line in message]


class Bench:
    """A notifier with a clock that the test moves."""

    def __init__(self, address: str, watchdog_us: str = "") -> None:
        self.now_s = 100.0
        environment = {"NOTIFY_SOCKET": address} | ({"WATCHDOG_USEC": watchdog_us} if watchdog_us else {})
        self.notifier = SystemdNotifier(environment, lambda: self.now_s)
        asyncio.run(self.notifier.start())

    def announce(self, *events: Event, after_s: float = 1.0) -> None:
        for event in events:
            self.now_s += after_s
            self.notifier.announce(event)

    def close(self) -> None:
        asyncio.run(self.notifier.close())


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A manager with a socket path or an abstract name."""
    address = f"@edged-test-{os.getpid()}" if request.param == "abstract" else str(tmp_path / "notify")
    end = Manager(address)
    end.address = address
    yield end
    end.socket.close()


def test_ready_comes_with_the_cameras_and_only_once(manager):
    """READY=1 is sent once, when the first state is ready, and not while cameras are missing."""
    bench = Bench(manager.address)
    bench.announce(FAULT, Idle(), FAULT)
    before = manager.told()
    assert "READY=1" not in before
    assert any(line.startswith("EXTEND_TIMEOUT_USEC=") for line in before), "waiting extends the start"
    bench.announce(READY, READY, BUSY, READY)
    assert 1 == manager.told().count("READY=1")
    bench.close()


def test_a_cell_in_setup_has_started(manager):
    """A cell in SETUP sends READY=1 with the reason as status."""
    setup = CellState(CellPhase.SETUP, False, False, "", 0, 0, setup=SetupSource.NO_CALIBRATION)
    bench = Bench(manager.address)
    bench.announce(setup, Idle())
    told = manager.told()
    assert 1 == told.count("READY=1")
    assert "STATUS=setup: no calibration yet; 0 cycles" in told
    assert not any(line.startswith("EXTEND_TIMEOUT_USEC=") for line in told)
    bench.close()


def test_only_events_of_the_loop_feed_the_watchdog(manager):
    """Cycles and idle turns feed the watchdog; without them nothing does."""
    bench = Bench(manager.address, watchdog_us="3000000")
    bench.announce(READY)
    manager.messages()
    bench.announce(make_snapshot(), Idle(), make_snapshot(2))
    assert 3 == manager.told().count("WATCHDOG=1")
    bench.now_s += 3600
    assert [] == manager.messages()
    bench.close()
    assert "WATCHDOG=1" not in manager.told()


@pytest.mark.slow
def test_a_fast_cell_does_not_flood_the_manager(manager):
    """1000 cycles in a second send few watchdog messages, but more than two per period."""
    bench = Bench(manager.address, watchdog_us="1000000")
    bench.announce(READY)
    manager.messages()
    bench.announce(*(make_snapshot(cycle) for cycle in range(1000)), after_s=0.001)
    assert 2 < manager.told().count("WATCHDOG=1") < 10
    bench.close()


def test_status_is_one_line(manager):
    """The status is the fault on one line, also if its text has a newline."""
    bench = Bench(manager.address)
    bench.announce(READY, FAULT)
    last = manager.messages()[-1]
    assert "STATUS=FAULT: camera left: unplugged; 0 cycles" in last
    assert all("=" in line for line in last)
    bench.close()


def test_a_reload_during_the_start_is_not_the_end_of_the_start(manager):
    """A reload during the start does not send READY=1, only its refusal as status."""
    bench = Bench(manager.address)
    bench.announce(FAULT)
    manager.messages()
    bench.notifier.reloading()
    bench.notifier.reloaded(refused="cell.toml: a mistake")
    assert ["STATUS=reload refused: cell.toml: a mistake"] == manager.told()
    bench.announce(READY)
    assert 1 == manager.told().count("READY=1")
    bench.close()


def test_reload_begins_with_a_time_stamp_and_ends_with_ready(manager):
    """A reload sends RELOADING=1 with MONOTONIC_USEC, then READY=1 with a refusal as status."""
    bench = Bench(manager.address)
    bench.announce(READY)
    manager.messages()
    bench.notifier.reloading()
    bench.notifier.reloaded("cell.toml: 1 problem\n  modbus.port: 0")
    begun, ended = manager.messages()
    assert "RELOADING=1" == begun[0]
    assert int(begun[1].removeprefix("MONOTONIC_USEC=")) > 0
    assert ["READY=1", "STATUS=reload refused: cell.toml: 1 problem modbus.port: 0"] == ended
    bench.close()


def test_stopping_is_told_once(manager):
    """STOPPING=1 is sent once."""
    bench = Bench(manager.address)
    bench.announce(READY, STOPPING, make_snapshot())
    bench.close()
    assert 1 == manager.told().count("STOPPING=1")


def test_a_datagram_that_was_lost_is_sent_with_the_next_event(manager):
    """A READY=1 that the full socket refused is sent with the next event."""
    bench = Bench(manager.address)
    filler = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    filler.setblocking(False)
    with pytest.raises(BlockingIOError):
        while True:
            filler.sendto(b"X=1", manager.socket.getsockname())
    filler.close()
    bench.announce(READY)
    assert "READY=1" not in manager.told()
    bench.announce(Idle())
    assert "READY=1" in manager.told()
    bench.close()


@pytest.mark.parametrize("address", ["", "vsock:2:1234", "relative", "/nowhere/notify"])
def test_without_a_manager_nothing_happens(address, caplog):
    """Without a manager, or with one that is gone, events raise nothing and log at most one line."""
    bench = Bench(address)
    bench.announce(READY, make_snapshot(), STOPPING)
    bench.close()
    assert len(caplog.records) <= 1, "a missing manager is one line in the log, not one per event"


@pytest.mark.parametrize("watchdog_us", ["0", "-5", "abc", "1e6", "²"])
def test_a_strange_watchdog_time_is_ignored(manager, watchdog_us):
    """A WATCHDOG_USEC that is no positive number leaves the default period."""
    bench = Bench(manager.address, watchdog_us)
    bench.announce(READY, Idle())
    assert 2 == manager.told().count("WATCHDOG=1")
    bench.close()


needs_analyze = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing"
)


CELLS = ["edged.service", "edged@.service"]
PAGES = ["edged-page.service", "edged-page@.service"]


@pytest.fixture(params=CELLS)
def unit_file(request):
    """Each of the cell's units: that of a single cell, and the template for several."""
    return UNIT.with_name(request.param)


@pytest.fixture(params=[*CELLS, *PAGES])
def any_unit(request):
    """Each of the cell's and the page's units."""
    return UNIT.with_name(request.param)


def analyze(unit_file: Path, tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run systemd-analyze on a unit whose program is replaced by one that exists."""
    # all of them are there, as each names another
    units = [
        place.joinpath(name.replace("@", at))
        for place, at in ((tmp_path, "@cell1"), (tmp_path, "@"))
        for name in (*CELLS, *PAGES)
    ]
    for unit in units:
        text = UNIT.with_name(unit.name.replace("@cell1", "@")).read_text()
        text = text.replace("/opt/edged/current/bin/edged", "/bin/true")
        unit.write_text(text.replace("/opt/edged/current/bin/python", "/bin/true"))
    unit = tmp_path / unit_file.name.replace("@", "@cell1")
    command = ["systemd-analyze", *arguments, str(unit)]
    return subprocess.run(command, capture_output=True, text=True, timeout=WHOLE_S, check=False)


@needs_analyze
def test_the_unit_is_understood_completely(any_unit, tmp_path):
    """`systemd-analyze verify` has no output (it returns 0 for unknown keys, too)."""
    result = analyze(any_unit, tmp_path, "verify", "--man=no")
    assert (0, "", "") == (result.returncode, result.stdout, result.stderr)


@needs_analyze
def test_the_unit_is_hardened(unit_file, tmp_path):
    """The exposure that systemd computes is at most 2.5 of 10, and 1.9 for the page."""
    result = analyze(unit_file, tmp_path, "security", "--offline=true", "--threshold=25", "--no-pager")
    assert 0 == result.returncode, result.stdout[-300:]
    page = UNIT.with_name(unit_file.name.replace("edged", "edged-page"))
    result = analyze(page, tmp_path, "security", "--offline=true", "--threshold=19", "--no-pager")
    assert 0 == result.returncode, result.stdout[-300:]


@pytest.mark.parametrize("names", [CELLS, PAGES], ids=["cell", "page"])
def test_the_template_is_the_unit_with_names(names: list[str]) -> None:
    """The single unit and the template differ in the cell's name only."""
    single, template = (UNIT.with_name(name).read_text() for name in names)
    for named, plain in (
        ("edged_page-%i", "edged_page"),
        ("edged-page@%i", "edged-page"),
        ("page of the cell %i", "page of the cell"),
        ("edged-%i", "edged"),
        ("edged@%i", "edged"),
        ("/%i.toml", "/cell.toml"),
        (", cell %i", ""),
    ):
        template = template.replace(named, plain)
    assert single[single.index("[Unit]") :] == template[template.index("[Unit]") :]


def test_the_page_gives_way_and_has_no_rights() -> None:
    """The page's unit has no capability, a user of its own, and less memory and weight than its cell."""
    cell, page = (
        dict(line.split("=", 1) for line in UNIT.with_name(name).read_text().splitlines() if "=" in line)
        for name in ("edged.service", "edged-page.service")
    )
    assert "" == page["CapabilityBoundingSet"]
    assert "AmbientCapabilities" not in page
    assert cell["User"] != page["User"]
    assert cell["StateDirectory"] != page["StateDirectory"]
    assert "--page-user " + page["User"] in cell["ExecStart"]
    assert "/var/lib/private/" + cell["StateDirectory"] == page["BindReadOnlyPaths"]
    assert page["ExecStart"].endswith(f"/run/{cell['RuntimeDirectory']}/page")
    for what in ("CPUWeight", "IOWeight"):
        assert int(page[what]) < int(cell[what])
    assert int(page["MemoryMax"].rstrip("%")) < int(cell["MemoryMax"].rstrip("%"))
    assert int(page["OOMScoreAdjust"]) > int(cell["OOMScoreAdjust"])


def test_strangers_cannot_take_every_descriptor(unit_file):
    """The unit grants the daemon's file descriptors; all servers at their limits leave 400 of a shell's
    1024."""
    assert f"LimitNOFILE={DESCRIPTORS}" in unit_file.read_text().splitlines()
    modbus = next(
        limit.le for limit in ModbusSection.model_fields["max_clients"].metadata if isinstance(limit, Le)
    )
    zenoh = 3 * session.MAX_SESSIONS + session.ACCEPT_PENDING
    assert modbus + lineserver.MAX_CLIENTS + places.MAX_CONNECTIONS + zenoh + 400 <= 1024


def test_the_unit_asks_for_what_the_notifier_tells(unit_file):
    """The unit has Type=notify, a watchdog, and a reload by SIGHUP."""
    lines = unit_file.read_text().splitlines()
    assert {
        "Type=notify",
        "NotifyAccess=main",
        "ExecReload=/bin/kill -HUP $MAINPID",
        "WatchdogSec=30",
    } <= set(lines)
