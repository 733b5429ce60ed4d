#!/usr/bin/env python3
"""What a PLC's read costs beside others: nobody, two viewers, one who asks, floods, an OPC UA subscriber.

Run it with `tools/bench beside`; it prints Markdown. The cell is `edged run` with its page, in processes of
their own; the PLC reads the status every 5 ms from this one. The phases are repeated in turn, so that other
load on the machine affects all of them. Clients run on this machine, too, with the least priority.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator, Sequence
from http.cookiejar import CookieJar
from pathlib import Path

import numpy as np
from benching import TESTS, bench_parser, finish
from helpers.browsersession import PASSWORD
from helpers.ports import free_port
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.webcell import HASH

from edged.files.statefolder import state_folder
from edged.identity.users import User, UserFile
from edged.plc.registers import ADDRESS

PERIOD_S = 0.005
ROUNDS = 3
PHASES = "nobody", "two viewers", "one who asks all the time", "viewers and floods", "an OPC UA subscriber"
VIEWERS, TABS, LINES = 2, 8, 16
"""Numbers of viewers; of connections per flood over a tab's sockets; of those that flood refused requests."""

ASKING = """
import http.client, sys
while True:
    line = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1]))
    try:
        while True:
            line.request("GET", "/status.json", headers={"Cookie": sys.argv[2]})
            line.getresponse().read()
    except (OSError, http.client.HTTPException):
        pass
"""
"""Requests within the rate that a session may have."""

SUBSCRIBING = """
import asyncio, sys
from asyncua import Client

class Notes:
    def datachange_notification(self, node, value, data):
        pass

async def main():
    async with Client(f"opc.tcp://127.0.0.1:{sys.argv[1]}") as client:
        registers = await client.nodes.objects.get_child(["3:Registers"])
        variables = [one for block in await registers.get_children() for one in await block.get_children()]
        subscription = await client.create_subscription(100, Notes())
        await subscription.subscribe_data_change(variables)
        await asyncio.sleep(1e6)

asyncio.run(main())
"""
"""Subscribes to every register, at ten updates a second."""


class Reads:
    """A PLC's connection, and the durations of its reads, ms."""

    def __init__(self, port: int) -> None:
        self._line = socket.create_connection(("127.0.0.1", port))
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self) -> float:
        """Read the status once; return the duration."""
        start_s = time.perf_counter()
        self._line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, ADDRESS["STATE"], 16))
        left = 9 + 32
        while left:
            left -= len(self._line.recv(left))
        return 1e3 * (time.perf_counter() - start_s)

    def during(self, seconds: float) -> list[float]:
        """Read for some seconds; return all durations."""
        found = []
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            found.append(self.read())
            time.sleep(PERIOD_S)
        return found


def measure(seconds: float, wanted: Sequence[str]) -> None:
    """Print the figures. seconds : of each phase, per round. wanted : phases beside the one with nobody."""
    with tempfile.TemporaryDirectory() as folder:
        cell = SmallCell(Path(folder))
        page = f'[web]\npassword_hash = "{HASH}"\ncommissioning = true'
        opcua_port = free_port()
        text = cell.config.read_text().replace("[web]", page, 1)
        cell.config.write_text(f"{text}\n[opcua]\nport = {opcua_port}\nanonymous = true\n")
        vera = User(name="Vera", role="viewer", password_hash=HASH)
        UserFile(state_folder(cell.config) / "users.json").put(vera)
        daemon = DaemonProcess(cell.config)
        try:
            daemon.wait_ready()
            is_page = any("OPC UA" not in name for name in wanted)
            cookie = logged_in(cell.web_port) if is_page else ""
            reads = Reads(cell.modbus_port)
            reads.during(2.0)
            phases: dict[str, list[float]] = {name: [] for name in PHASES if name in ("nobody", *wanted)}
            for name in ROUNDS * tuple(phases):
                with others(cell.web_port, opcua_port, cookie, name):
                    phases[name] += reads.during(seconds)
        finally:
            daemon.stop()
    alone = np.percentile(phases["nobody"], (50, 99))
    print("\n| beside | reads | p50 ms | p99 ms | longest ms | p50, p99 to nobody |")
    print("|---|---:|---:|---:|---:|---:|")
    for name, found in phases.items():
        p50, p99 = np.percentile(found, (50, 99))
        print(
            f"| {name} | {len(found)} | {p50:.2f} | {p99:.2f} | {max(found):.1f} | "
            f"{p50 / alone[0]:.2f}, {p99 / alone[1]:.2f} |"
        )


def logged_in(port: int) -> str:
    """Log a viewer in, and return the cookies."""
    jar = CookieJar()
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
    origin = f"http://127.0.0.1:{port}"
    form = urllib.parse.urlencode({"name": "Vera", "password": PASSWORD}).encode()
    opener.open(urllib.request.Request(f"{origin}/login", form, {"Origin": origin}))
    return "; ".join(f"{cookie.name}={cookie.value}" for cookie in jar)


@contextlib.contextmanager
def others(port: int, opcua_port: int, cookie: str, phase: str) -> Iterator[None]:
    """Run the clients of a phase; those that are turned away come again."""
    over = threading.Event()
    threads = []
    if phase == "one who asks all the time":
        threads.append(threading.Thread(target=_again, args=(["-c", ASKING, str(port), cookie], over)))
    elif phase == "an OPC UA subscriber":
        threads.append(threading.Thread(target=_again, args=(["-c", SUBSCRIBING, str(opcua_port)], over)))
    elif phase != "nobody":
        viewer = [str(Path(__file__).with_name("pageviewer.py")), str(port), "Vera", PASSWORD]
        threads += [threading.Thread(target=_again, args=(viewer, over)) for _ in range(VIEWERS)]
    if phase == "viewers and floods":
        for kind, count in (("pings", TABS), ("messages", TABS), ("requests", LINES)):
            flooder = [str(TESTS / "helpers" / "flooder.py"), str(port), kind, str(count), cookie]
            threads.append(threading.Thread(target=_again, args=(flooder, over)))
    for thread in threads:
        thread.start()
    time.sleep(3.0 if threads else 0.5)  # time for them to connect
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


def _again(command: list[str], over: threading.Event) -> None:
    """Restart a command whenever it ends, until it is over."""
    while not over.is_set():
        process = subprocess.Popen(
            [sys.executable, *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: os.nice(19),
        )
        turned_away_s = time.monotonic() + 3.0
        while process.poll() is None and not over.wait(0.05):
            if "flooder" in command[0] and time.monotonic() > turned_away_s:
                break  # its connections are closed by now
        process.kill()
        process.wait()


def main() -> int:
    """Measure."""
    parser = bench_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each phase, in each of three rounds")
    parser.add_argument("--only", choices=PHASES[1:], help="one phase, and nobody")
    options = parser.parse_args()
    measure(options.seconds, PHASES[1:] if options.only is None else [options.only])
    finish(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
