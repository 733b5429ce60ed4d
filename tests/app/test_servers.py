"""A reload of the servers: those that changed are exchanged, or all stay."""

from __future__ import annotations

import asyncio
import importlib
import os
import pty
import re
import socket
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from helpers.certificates import make_certificates
from helpers.enipcell import own_address
from helpers.ports import free_port
from helpers.waiting import LIMIT_S, WHOLE_S, until
from helpers.zenohcell import ask

from edged.app.pageserver import PageServer
from edged.app.pagesource import StartedPage
from edged.app.running import Running
from edged.app.servers import Servers
from edged.app.wantedservers import WantedServer, wanted_servers
from edged.config.configuration import Config
from edged.config.reading import load
from edged.config.servers import WebSection
from edged.domain.events import Command
from edged.errors import CommandRefused, ConfigError, ListenError

HEAD = """
[cell]
name = "{name}"
rig = "rig.json"
jobs = "jobs"
job = "part"

[cameras]
source = "virtual"

"""


def config(folder: Path, sections: str, name: str = "cell1") -> Config:
    """A configuration with these sections of servers."""
    path = folder / "cell.toml"
    path.write_text(HEAD.format(name=name) + sections)
    return load(path)


class _Commander:
    session = None

    def submit(self, command: Command) -> None:
        raise NotImplementedError


class PagePort(PageServer):
    """A page whose port is opened, but whose process is not started."""

    def __init__(self, _cell: str, section: WebSection) -> None:
        super().__init__(section.host, section.port, cast(Any, None), StartedPage())

    async def _run(self) -> None:
        await asyncio.Event().wait()


def running_cell(commander: object = None) -> Running:
    """A cell without jobs."""
    loaded = SimpleNamespace(setup=SimpleNamespace(jobs={}))
    parts: tuple[Any, ...] = (loaded, commander or _Commander(), None, None)
    return Running(Path("cell.toml"), *parts)


def is_taken(port: int) -> bool:
    """Whether a server listens there; a connection as test would outlive the server's end."""
    try:
        socket.create_server(("127.0.0.1", port)).close()
    except OSError:
        return True
    return False


def exchanged(before: Config, after: Config, look: list[int]) -> tuple[list[bool], list[str], int]:
    """Which of the ports are taken after the exchange, which servers run, and how often that was
    announced."""
    told: list[None] = []

    async def main() -> tuple[list[bool], list[str]]:
        servers = Servers(running_cell(), lambda: told.append(None), PagePort)
        await servers.start(before)
        try:
            await servers.exchange(after)
        except ListenError:
            pass
        finally:
            taken = [is_taken(port) for port in look]
            running = list(servers.started)
            await servers.close()
        return taken, running

    taken, running = asyncio.run(main())
    return taken, running, len(told)


def test_a_port_that_cannot_be_opened_leaves_all_servers_as_they_were(tmp_path: Path) -> None:
    """If a port cannot be opened, all servers stay as before, also those that were exchanged already."""
    first, second = free_port(), free_port()
    with socket.create_server(("127.0.0.1", 0)) as other:
        web = f"[web]\nport = {other.getsockname()[1]}\n"
        before = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {first}\n")
        after = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {second}\n{web}")

        taken, running, _ = exchanged(before, after, [first, second])

    assert ([True, False], ["modbus"]) == (taken, running)


def test_only_what_changed_is_exchanged(tmp_path: Path) -> None:
    """A new page leaves the PLC's server as it is, and the change is announced once."""
    modbus, web = free_port(), free_port()
    before = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n")
    after = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n[web]\nport = {web}\n")

    assert ([True, True], ["modbus", "web"], 1) == exchanged(before, after, [modbus, web])


def test_the_socket_of_robots_is_exchanged_with_the_registers_that_it_shows(tmp_path: Path) -> None:
    """A reload to another brand and another Modbus port exchanges both servers."""
    first, second, lines = free_port(), free_port(), free_port()
    socket_ = f"[modbus.socket]\nport = {lines}\nbrand = "
    before = config(tmp_path, f'[zenoh]\nenabled = false\n[modbus]\nport = {first}\n{socket_}"kuka"\n')
    after = config(tmp_path, f'[zenoh]\nenabled = false\n[modbus]\nport = {second}\n{socket_}"abb"\n')

    assert ([False, True, True], ["modbus"], 1) == exchanged(before, after, [first, second, lines])


def test_a_port_of_robots_that_cannot_be_opened_leaves_the_registers_as_they_were(tmp_path: Path) -> None:
    """If the robots' port cannot be opened, the Modbus server listens at its former port."""
    modbus = free_port()
    before = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n")
    with socket.create_server(("127.0.0.1", 0)) as other:
        lines = f'[modbus.socket]\nport = {other.getsockname()[1]}\nbrand = "ur"\n'
        after = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n{lines}")

        taken, running, _ = exchanged(before, after, [modbus])

    assert ([True], ["modbus"]) == (taken, running)


def test_a_server_that_is_switched_off_is_closed(tmp_path: Path) -> None:
    """A server that is switched off frees its port."""
    modbus, web = free_port(), free_port()
    off = "[zenoh]\nenabled = false\n[modbus]\nenabled = false\n"
    before = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n[web]\nport = {web}\n")
    after = config(tmp_path, f"{off}[web]\nport = {web}\n")

    assert ([False, True], ["web"], 1) == exchanged(before, after, [modbus, web])


@pytest.mark.parametrize(
    ("change", "name", "expected"),
    [
        ("", "cell2", {"zenoh", "web"}),
        ("[drift]\nmin_cycles = 30\n", "cell1", set()),
        ("[recorder]\nfolder = 'kept'\n", "cell1", {"recorder"}),
    ],
)
def test_what_a_server_depends_on(change: str, name: str, expected: set[str], tmp_path: Path) -> None:
    """A server is exchanged for its own section, and for the cell's name if it shows that."""
    sections = "[web]\nport = 8080\n"
    before = wanted_servers(config(tmp_path, sections))
    after = wanted_servers(config(tmp_path, sections + change, name))

    assert expected == {one for one in {*before, *after} if before.get(one) != after.get(one)}


def test_a_history_depends_on_where_recordings_are_if_it_keeps_some(tmp_path: Path) -> None:
    """A recorder that moves takes the history along."""

    def wanted(folder: str, mib: int) -> WantedServer:
        text = f"[recorder]\nfolder = '{folder}'\n[history]\nfolder = 'history'\nrecordings_mib = {mib}\n"
        return wanted_servers(config(tmp_path, text))["history"]

    assert wanted("here", 1) != wanted("there", 1)
    assert wanted("here", 0) == wanted("there", 0)


def test_zenoh_depends_on_the_shared_key(tmp_path: Path) -> None:
    """Another shared key in its file changes Zenoh's server."""
    key = tmp_path / "zenoh.key"
    key.write_bytes(b"a" * 32)
    cell = config(tmp_path, "[zenoh]\nshared_key = 'zenoh.key'\n")
    before = wanted_servers(cell)["zenoh"]
    assert before == wanted_servers(cell)["zenoh"]
    key.write_bytes(b"b" * 32)

    assert before != wanted_servers(cell)["zenoh"]


def test_opcua_depends_on_its_files_the_cells_name_and_who_triggers(tmp_path: Path) -> None:
    """Another trusted client certificate, cell name or cycle mode changes the OPC UA server."""
    make_certificates(tmp_path)
    trusted = tmp_path / "trusted"
    trusted.mkdir()
    files = "certificate = 'server.pem'\nkey = 'server.key'\ntrusted = 'trusted'\n"
    sections = f"[opcua]\nanonymous = true\n{files}"

    def wanted(name: str = "cell1", more: str = "") -> object:
        return wanted_servers(config(tmp_path, sections + more, name))["opcua"]

    before = wanted()
    (trusted / "client.der").write_bytes(b"a client")
    after = wanted()

    assert before != after
    assert after == wanted()
    assert after != wanted("cell2")
    assert after != wanted(more='[cycle]\nmode = "free"\n')


async def test_opcua_without_its_package_is_a_mistake_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OPC UA without its package is refused with the package's name, before any server is changed."""
    monkeypatch.setitem(sys.modules, "edged.adapters.opcua", None)
    wanted = config(
        tmp_path, "[opcua]\nanonymous = true\n[zenoh]\nenabled = false\n[modbus]\nenabled = true\n"
    )
    servers = Servers(running_cell(), lambda: None, PagePort)
    with pytest.raises(ListenError, match=r"edged\[opcua\]"):
        await servers.exchange(wanted)
    assert {} == servers.started


@pytest.mark.parametrize(("family", "keys"), [("s7", "db = 100"), ("melsec", "port = 5007\ncpu = 'iq-r'")])
async def test_a_plc_without_its_package_is_a_mistake_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, family: str, keys: str
) -> None:
    """A PLC family without its package is refused with the package's name."""
    monkeypatch.setitem(sys.modules, f"edged.adapters.plcmemory.{family}", None)
    wanted = config(
        tmp_path, f"[plc]\nhost = '127.0.0.1'\n[plc.{family}]\n{keys}\n[zenoh]\nenabled = false\n"
    )
    servers = Servers(running_cell(), lambda: None, PagePort)
    with pytest.raises(ListenError, match=rf"edged\[{family}\]"):
        await servers.exchange(wanted)
    await servers.close()


async def test_an_ethernetip_adapter_starts_beside_modbus_and_says_who_has_its_port(tmp_path: Path) -> None:
    """The EtherNet/IP adapter starts beside Modbus; a second one at the same address is refused with the
    reason."""
    host = own_address()
    sections = f"[zenoh]\nenabled = false\n[modbus]\nport = {free_port()}\n[ethernetip]\nhost = '{host}'\n"
    wanted = config(tmp_path, sections)
    running = running_cell()
    servers = Servers(running, lambda: None, PagePort)
    await servers.start(wanted)
    try:
        assert ["modbus", "ethernetip"] == list(servers.started)
        adapter = running.ethernetip()
        assert adapter is not None
        assert ("", False) == (adapter.scanner, adapter.is_running)
        other = config(tmp_path, sections.replace("port =", f"port = {free_port()} #"))
        second = Servers(running_cell(), lambda: None, PagePort)
        with pytest.raises(ListenError, match=r"ethernetip: cannot listen on .*:44818"):
            await second.start(other)
        await second.close()
    finally:
        await servers.close()


def exchange_after(folder: Path, sections: str, change: Callable[[], None], port: int) -> tuple[bool, bool]:
    """Whether an exchange for the same configuration made the server anew, and whether it listens."""
    wanted = config(folder, sections)

    async def main() -> tuple[bool, bool]:
        servers = Servers(running_cell(), lambda: None, PagePort)
        await servers.start(wanted)
        before = dict(servers.started)
        change()
        try:
            await servers.exchange(wanted)
        except (ListenError, ConfigError):
            pass
        finally:
            answers = is_taken(port)
            made_anew = dict(servers.started) != before
            await servers.close()
        return made_anew, answers

    return asyncio.run(main())


def tls_sections(folder: Path, port: int) -> str:
    """Modbus over TLS with certificates in the folder."""
    make_certificates(folder)
    files = "\n".join(
        f'{name} = "{folder / file}"'
        for name, file in (("certificate", "server.pem"), ("key", "server.key"), ("authority", "ca.pem"))
    )
    return f"[zenoh]\nenabled = false\n[modbus]\nport = {port}\n[modbus.tls]\n{files}\n"


def test_renewed_certificates_are_taken_by_a_reload_and_untouched_ones_leave_the_plc_alone(
    tmp_path: Path,
) -> None:
    """Renewed certificates in the same files exchange the server; unchanged ones leave it."""
    port = free_port()
    sections = tls_sections(tmp_path, port)

    assert (True, True) == exchange_after(tmp_path, sections, lambda: make_certificates(tmp_path), port)
    assert (False, True) == exchange_after(tmp_path, sections, lambda: None, port)


def test_a_damaged_certificate_is_refused_before_the_server_is_touched(tmp_path: Path) -> None:
    """A damaged certificate is refused, and the running server is left."""
    port = free_port()
    sections = tls_sections(tmp_path, port)

    def damage() -> None:
        (tmp_path / "server.pem").write_text("-----BEGIN CERTIFICATE-----\n")

    assert (False, True) == exchange_after(tmp_path, sections, damage, port)


def test_a_port_that_is_taken_leaves_the_running_server_alone(tmp_path: Path) -> None:
    """If the new port is taken, the running server is never closed."""
    first = free_port()
    off = "[zenoh]\nenabled = false\n"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        before = config(tmp_path, f"{off}[modbus]\nport = {first}\n")
        after = config(tmp_path, f"{off}[modbus]\nport = {taken.getsockname()[1]}\n")

        async def main() -> bool:
            servers = Servers(running_cell(), lambda: None, PagePort)
            await servers.start(before)
            running = servers.started["modbus"]
            try:
                with pytest.raises(ListenError):
                    await servers.exchange(after)
                return servers.started["modbus"] is running
            finally:
                await servers.close()

        assert asyncio.run(main())


def test_a_changed_access_control_of_zenoh_is_taken_by_a_reload(tmp_path: Path) -> None:
    """Changed access control in Zenoh's own file takes effect by a reload; invalid content leaves the
    running server."""
    port = free_port()
    own = tmp_path / "zenoh.json5"
    own.write_text("{}")
    sections = (
        f'[modbus]\nenabled = false\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\nconfig_file = "{own}"\n'
    )
    half = '{access_control: {enabled: true, default_permission: "deny"}}'  # Zenoh refuses it when it opens
    denied = half.replace("}}", ", rules: [], subjects: [], policies: []}}")

    for content in (denied, half):
        assert (True, True) == exchange_after(tmp_path, sections, writes(own, content), port)
        own.write_text("{}")
    assert (False, True) == exchange_after(tmp_path, sections, writes(own, "{}"), port)
    assert (False, True) == exchange_after(tmp_path, sections, writes(own, "{"), port)


@pytest.mark.parametrize(("commands", "expected"), [("refused", 0), ("guarded", 1), ("anyone", 1)])
async def test_a_cell_that_refuses_commands_over_zenoh_is_read_only_there(
    commands: str, expected: int, tmp_path: Path
) -> None:
    """A trigger at a cell that refuses commands over Zenoh gets that reason, and nothing is measured."""
    port, taken = free_port(), list[Command]()

    class Taking:
        def submit(self, command: Command) -> None:
            taken.append(command)
            raise CommandRefused("taken down")

    section = f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\ncommands = "{commands}"\n'
    servers = Servers(running_cell(Taking()), lambda: None, PagePort)
    await servers.start(config(tmp_path, f"[modbus]\nenabled = false\n{section}"))
    try:
        (reply,) = await ask(port, "edged/cell1/trigger?kind=change_job;job=2")
    finally:
        await servers.close()
    refusals = ("this cell takes no commands over Zenoh", "taken down")
    assert refusals[expected] == reply["document"]["error"]
    assert expected == len(taken)


def writes(file: Path, content: str) -> Callable[[], None]:
    """A function that writes this content to a file."""

    def write() -> None:
        file.write_text(content)

    return write


# --- servers that take their time ----------------------------------------------------------------------


class Hanging:
    """A start that waits until `may_go`, in a task or in a thread, for every kind of server."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, start_s: float = 0.4) -> None:
        self.may_go = threading.Event()
        self._patch = monkeypatch
        for name, value in (("START_S", start_s), ("RETRY_S", 0.1), ("CLOSE_S", 1.0)):
            monkeypatch.setattr(f"edged.app.servers.{name}", value, raising=False)

    def hold_task(self, place: str) -> None:
        """Delay an async function."""
        real = cast(Callable[..., Awaitable[object]], derive(place))

        async def late(*args: object) -> object:
            await until(self.may_go.is_set)
            return await real(*args)

        self._patch.setattr(place, late)

    def hold_thread(self, place: str) -> None:
        """Delay a function, whose thread waits."""
        real = cast(Callable[..., object], derive(place))

        def late(*args: object, **options: object) -> object:
            self.may_go.wait(LIMIT_S)
            return real(*args, **options)

        self._patch.setattr(place, late)


def derive(place: str) -> object:
    """The object of a dotted name, of a class's method or of a module."""
    parts = place.split(".")
    for end in range(len(parts) - 1, 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:end]))
        except ImportError:
            continue
        for part in parts[end:]:
            found = getattr(found, part)
        return found
    raise ImportError(place)


TASKS = {
    "tcp": "edged.adapters.modbus.tcp.TcpServer.start",
    "tls": "edged.adapters.modbus.tcp.TcpServer.start",
    "socket": "edged.adapters.modbus.lineserver.LineServer.start",
    "web": "edged.app.pageserver.PageServer.start",
    "opcua": "edged.adapters.opcua.server.ServerThread._prepare",
    "recorder": "edged.adapters.recorder.Recorder.start",
}
THREADS = {
    "rtu": "edged.adapters.modbus.rtu.serial.Serial",
    "zenoh": "edged.adapters.zenoh.publisher.open_session",
}
KINDS = [*TASKS, *THREADS]


@dataclass(frozen=True, slots=True)
class Slow:
    """A configuration with one server that hangs and another that does not; before has the other only.

    section, place : of the one that hangs, as messages name them. well : a port that is served meanwhile.
    """

    before: str
    sections: str
    section: str
    place: str
    well: int


def slow_cell(kind: str, folder: Path, line: str) -> Slow:
    """A configuration with a hanging server of this kind, and the page or Modbus beside it."""
    port, well, robots = free_port(), free_port(), free_port()
    off, page = "[zenoh]\nenabled = false\n", f"[web]\nport = {well}\n"
    no_plc, plc = "[modbus]\nenabled = false\n", f"[modbus]\nport = {well}\n"
    tcp = f"[modbus]\nport = {port}\n"
    if kind in ("tcp", "tls", "socket", "rtu"):
        more = {
            "tcp": "",
            "tls": tls_sections(folder, port).partition(tcp)[2] if kind == "tls" else "",
            "socket": f'[modbus.socket]\nport = {robots}\nbrand = "ur"\n',
            "rtu": f'[modbus.serial]\ndevice = "{line}"\nparity = "none"\n',
        }[kind]
        place = {"socket": f":{robots}", "rtu": line}.get(kind, f":{port}")
        return Slow(f"{off}{no_plc}{page}", f"{off}{tcp}{more}{page}", "modbus", place, well)
    if kind == "zenoh":
        own = f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n'
        return Slow(f"{off}{plc}", f"{plc}{own}", "zenoh", f":{port}", well)
    own = {
        "web": f"[web]\nport = {port}\n",
        "opcua": f"[opcua]\nport = {port}\nanonymous = true\n",
        "recorder": f"[recorder]\nfolder = '{folder / 'kept'}'\n",
    }[kind]
    place = str(folder / "kept") if kind == "recorder" else f":{port}"
    return Slow(f"{off}{plc}", f"{off}{plc}{own}", kind, place, well)


@pytest.fixture
def line() -> Iterator[str]:
    """The device name of a serial line."""
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def held(kind: str, monkeypatch: pytest.MonkeyPatch) -> Hanging:
    """A start of that kind that hangs."""
    hanging = Hanging(monkeypatch)
    if kind in TASKS:
        hanging.hold_task(TASKS[kind])
    else:
        hanging.hold_thread(THREADS[kind])
    return hanging


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
async def test_a_server_that_starts_slowly_is_named_and_started_later(
    kind: str, tmp_path: Path, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow server is named with section, address and reason until it has started, while the others run."""
    slow = slow_cell(kind, tmp_path, line)
    hanging = held(kind, monkeypatch)
    told: list[None] = []
    servers = Servers(running_cell(), lambda: told.append(None), PagePort)
    try:
        async with asyncio.timeout(WHOLE_S):
            await servers.start(config(tmp_path, slow.sections))
        assert is_taken(slow.well)
        ((section, why),) = servers.problems.items()
        assert slow.section == section
        assert slow.place in why
        assert re.search(r"within|longer", why)
        hanging.may_go.set()
        await until(lambda: not servers.problems)
        assert slow.section in servers.started
        assert told
    finally:
        hanging.may_go.set()
        await servers.close()


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
async def test_a_reload_for_a_server_that_starts_slowly_is_refused_by_name(
    kind: str, tmp_path: Path, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reload with a slow server is refused in time with address and reason, and the running servers go
    on."""
    slow = slow_cell(kind, tmp_path, line)
    hanging = held(kind, monkeypatch)
    servers = Servers(running_cell(), lambda: None, PagePort)
    try:
        await servers.start(config(tmp_path, slow.before))
        running = dict(servers.started)
        async with asyncio.timeout(WHOLE_S):
            with pytest.raises(ListenError, match=re.escape(slow.place)) as refused:
                await servers.exchange(config(tmp_path, slow.sections))
        assert re.search(r"within|longer", str(refused.value))
        assert running == servers.started
        assert {} == servers.problems
        assert is_taken(slow.well)
    finally:
        hanging.may_go.set()
        await servers.close()


@pytest.mark.long
async def test_a_reload_does_not_wait_for_what_could_not_start_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reload does not wait for a server that hung before; without it in the configuration it is not
    tried again."""
    slow, port = slow_cell("opcua", tmp_path, ""), free_port()
    hanging = held("opcua", monkeypatch)
    servers = Servers(running_cell(), lambda: None, PagePort)
    try:
        await servers.start(config(tmp_path, slow.sections))
        await servers.exchange(config(tmp_path, f"{slow.sections}[web]\nport = {port}\n"))
        assert (True, {"opcua"}) == (is_taken(port), set(servers.problems))
        await servers.exchange(config(tmp_path, slow.before))
        assert {} == servers.problems
    finally:
        hanging.may_go.set()
        await servers.close()


@pytest.mark.slow
async def test_a_server_that_does_not_close_is_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A server that does not close in time is left and logged, and the others close."""
    port, page = free_port(), free_port()
    hanging = Hanging(monkeypatch)
    real = derive("edged.app.pageserver.PageServer.close")
    hanging.hold_task("edged.app.pageserver.PageServer.close")
    servers = Servers(running_cell(), lambda: None, PagePort)
    sections = f"[zenoh]\nenabled = false\n[modbus]\nport = {port}\n[web]\nport = {page}\n"
    await servers.start(config(tmp_path, sections))
    web = servers.started["web"]
    async with asyncio.timeout(WHOLE_S):
        await servers.close()
    assert not is_taken(port)
    await cast(Callable[..., Awaitable[object]], real)(web)
    assert "web: it has not closed within 1 s" in caplog.text
