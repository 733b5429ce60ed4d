"""What a reload does to the servers: those that changed are exchanged, or all stay."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path
from typing import cast

import pytest
from smallcell import free_port

from edged.app.servers import Servers, wanted_servers
from edged.app.status import Running
from edged.config import Config, load
from edged.domain import Command
from edged.errors import ListenError

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
    def submit(self, command: Command) -> None:
        raise NotImplementedError


def _nothing_runs() -> Running:
    return cast(Running, None)


def is_taken(port: int) -> bool:
    """Whether somebody listens there; a connection to find out would outlive the server's end."""
    try:
        socket.create_server(("127.0.0.1", port)).close()
    except OSError:
        return True
    return False


def exchanged(before: Config, after: Config, look: list[int]) -> tuple[list[bool], list[str], int]:
    """Which of the ports are taken after the exchange, what runs, and how often that was told."""
    told: list[None] = []

    async def main() -> tuple[list[bool], list[str]]:
        servers = Servers(_Commander(), _nothing_runs, lambda: b"", lambda: told.append(None))
        await servers.start(before)
        try:
            await servers.exchange(before, after)
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
    """Also those that had been exchanged already: the PLC finds its port again."""
    first, second = free_port(), free_port()
    with socket.create_server(("127.0.0.1", 0)) as other:
        web = f"[web]\nport = {other.getsockname()[1]}\n"
        before = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {first}\n")
        after = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {second}\n{web}")

        taken, running, _ = exchanged(before, after, [first, second])

    assert ([True, False], ["modbus"]) == (taken, running)


def test_only_what_changed_is_exchanged(tmp_path: Path) -> None:
    """A page more, and the connections of the PLC live on; who publishes is told once."""
    modbus, web = free_port(), free_port()
    before = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n")
    after = config(tmp_path, f"[zenoh]\nenabled = false\n[modbus]\nport = {modbus}\n[web]\nport = {web}\n")

    assert ([True, True], ["modbus", "web"], 1) == exchanged(before, after, [modbus, web])


def test_a_server_that_is_switched_off_is_closed(tmp_path: Path) -> None:
    """Its port is free."""
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
    """Its own section, and the name of the cell where it says it: in Zenoh's keys and on the page."""
    sections = "[web]\nport = 8080\n"
    before = wanted_servers(config(tmp_path, sections))
    after = wanted_servers(config(tmp_path, sections + change, name))

    assert expected == {one for one in {*before, *after} if before.get(one) != after.get(one)}
