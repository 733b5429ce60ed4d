#!/usr/bin/env python3
"""A hostile page at the cell's end of their link, and its effect on the cell's results.

Run it with the project's Python: `.venv/bin/python tools/fuzz_page.py --messages 1000000`. Three cells show
the same pictures in turn: one without a page, one with a hostile page under the limits that hold for every
page, and one without those limits, so that a million messages fit into minutes. The hostile page connects to
the cell's socket as the page's service does. It sends requests of every kind with any values, changed bytes,
random bytes, half messages, greetings of other versions, floods and any descriptors, and some pages take
neither messages nor pictures. A PLC reads the result all the time, and forbids SETUP (AUTO_LOCK): with SETUP
a page may stop a cell, as people may.

It prints what the PLC read. Exit code 1 if a result differed from those without a page, or was not VALID, or
memory, descriptors or the log have grown.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import pwd
import random
import re
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
from helpers.footprint import footprint
from helpers.linkmessages import EXAMPLES
from helpers.mutations import mutated
from helpers.smallcell import SmallCell
from pymodbus.client import ModbusTcpClient

from edged.errors import LinkError
from edged.link.memory import sealed
from edged.link.requests import GREETING, Envelope, Greeting, encoded, envelope_of
from edged.link.stream import framed
from edged.plc.registers import ADDRESS, RESULT, Flag, decode

PERIOD_S, PAIRS = 0.1, 3
READ_S = 0.01
POOL = 5000
"""Requests made in advance: making one takes longer than the cell takes to refuse it."""
FLAT = 48 << 20, 6, 4 << 20
"""Growth that counts as none: bytes in memory, open files, bytes of the log."""
TIMED = {"EXPOSURE_NS", "LATENCY", "CYCLE", "SEQ_HEAD", "SEQ_TAIL", "CRC16", "START_EPOCH"}
CELL = """
import sys
from edged.app import pageserver, pagesource
from edged.link import cellend
if sys.argv.pop(1) == "unlimited":
    cellend.REQUESTS_PER_S = cellend.REQUESTS_AT_ONCE = 1e12
    pageserver.PAUSE_S = pageserver.MOST_PAUSE_S = pagesource.LEFT_S = 0.0
from edged.__main__ import main
sys.exit(main())
"""


class Cell:
    """A cell's process. page : "none", "limited" or "unlimited"."""

    def __init__(self, folder: Path, page: str) -> None:
        self.files = SmallCell(folder / "cell", period_s=PERIOD_S)
        if page == "none":
            text = self.files.config.read_text()
            self.files.config.write_text(re.sub(r"\[web\][^\[]*", "", text))
        self.socket = folder / "page"
        self.log = folder / "log.txt"
        me = pwd.getpwuid(os.getuid()).pw_name
        options = [] if page == "none" else ["--page-user", me]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", CELL, page, "run", str(self.files.config), *options],
                stderr=log,
                env={**os.environ, "RUNTIME_DIRECTORY": str(folder)},
            )

    def stop(self) -> None:
        """End it."""
        self.process.terminate()
        assert self.process.wait(60) == 0, self.log.read_text()[-2000:]


@dataclass
class Reads:
    """Reads of a PLC. results : by place in the round of pictures; took_ms : of each read."""

    results: dict[int, Counter[tuple[Any, ...]]] = field(default_factory=dict)
    cycles: set[int] = field(default_factory=set)
    took_ms: list[float] = field(default_factory=list)
    wrong: Counter[str] = field(default_factory=Counter)

    def take(self, words: list[int]) -> None:
        """Record a result."""
        result = decode(RESULT, words)
        is_valid = bool(int(result["FLAGS"]) & Flag.VALID)
        if not result["SEQ_HEAD"]:
            return
        if result["SEQ_HEAD"] != result["SEQ_TAIL"] and is_valid:
            self.wrong["half of two results"] += 1
            return
        cycle = int(result["CYCLE"])
        if not is_valid:
            self.wrong["not VALID"] += cycle not in self.cycles
            return
        if cycle not in self.cycles:
            self.cycles.add(cycle)
            told = tuple((name, value) for name, value in sorted(result.items()) if name not in TIMED)
            self.results.setdefault(cycle % PAIRS, Counter())[told] += 1

    def missing(self) -> int:
        """Number of cycles between the first and the last that no read has shown."""
        return max(self.cycles) - min(self.cycles) + 1 - len(self.cycles)


class Plc(threading.Thread):
    """Reads until it is stopped, and forbids SETUP."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self._port, self._over = port, threading.Event()
        self.reads = Reads()

    def run(self) -> None:
        """Read, connecting as soon as there is a cell."""
        client = ModbusTcpClient("127.0.0.1", port=self._port, timeout=5)
        while not client.connect():
            time.sleep(0.1)
        client.write_register(ADDRESS["AUTO_LOCK"], 1)
        while not self._over.wait(READ_S):
            began_s = time.perf_counter()
            answer = client.read_input_registers(RESULT.address, count=RESULT.words)
            self.reads.took_ms.append(1e3 * (time.perf_counter() - began_s))
            if answer.isError():
                self.reads.wrong["no answer"] += 1
            else:
                self.reads.take(answer.registers)
        client.close()

    def stop(self) -> Reads:
        """Stop, and return the reads."""
        self._over.set()
        self.join()
        return self.reads


class HostilePage:
    """Connects to the socket again and again. sent : messages, by what was wrong with them."""

    def __init__(self, place: Path, seed: int) -> None:
        self._place = place
        self._chance = random.Random(seed)
        self._requests = [self._request() for _ in range(POOL)]
        self.sent: Counter[str] = Counter()

    def attack(self, messages: int, seconds: float) -> None:
        """Attack until `messages` were sent, or `seconds` have passed."""
        end_s = time.monotonic() + seconds
        while self.sent.total() < messages and time.monotonic() < end_s:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link, contextlib.suppress(OSError):
                link.settimeout(5.0)
                link.connect(str(self._place))
                self._misbehave(link, end_s)

    def _misbehave(self, link: socket.socket, end_s: float) -> None:
        """Misbehave on one link until the cell ends it."""
        chance = self._chance
        greeting = GREETING if chance.random() < 0.95 else Greeting(edged="9.9", schema_id="f00d")
        first = framed(encoded(greeting)) if chance.random() < 0.95 else framed(self._message())
        link.sendall(first)
        self.sent["greetings"] += 1
        reads_nothing = chance.random() < 0.02
        gone_s = time.monotonic() + (2.0 if reads_nothing else 60.0)
        while time.monotonic() < min(end_s, gone_s):
            batch = b"".join(framed(self._message()) for _ in range(chance.randint(1, 50)))
            if chance.random() < 0.02:
                batch = mutated(batch, chance)  # including lengths
            handles = [self._handle()] if chance.random() < 0.1 else []
            try:
                self._send(link, batch, handles, reads_nothing)
            finally:
                for handle in handles:
                    os.close(handle)

    def _send(self, link: socket.socket, data: bytes, handles: list[int], reads_nothing: bool) -> None:
        """Send everything, receiving meanwhile; pictures are never looked at."""
        view = memoryview(data)
        while view:
            readable, writable, _ = select.select([] if reads_nothing else [link], [link], [], 2.0)
            if readable and not link.recv(1 << 20):  # which closes the pictures' descriptors
                raise ConnectionError
            if not writable and not readable:
                raise ConnectionError
            if writable:
                link.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    sent = socket.send_fds(link, [view], handles)
                    view, handles = view[sent:], []

    def _handle(self) -> int:
        """A random kind of descriptor."""
        match self._chance.randrange(3):
            case 0:
                return sealed(self._chance.randbytes(1000))
            case 1:
                return os.open("/dev/null", os.O_RDONLY)
        return os.memfd_create("not sealed")

    def _message(self) -> bytes:
        """A message of a random kind; one of two hundred ends the link."""
        chance = self._chance
        data = chance.choice(self._requests)
        kind = chance.random()
        if kind < 0.003:
            self.sent["changed bytes"] += 1
            return mutated(data, chance)
        if kind < 0.005:
            self.sent["random bytes"] += 1
            return chance.randbytes(chance.randint(0, 300))
        self.sent["requests"] += 1
        return data

    def _request(self) -> bytes:
        """A request with random values of the right types."""
        chance = self._chance
        request = chance.choice(EXAMPLES)
        values = {name: self._value(name) for name in type(request).model_fields if name != "ask"}
        if chance.random() < 0.5:
            request = request.model_copy(update=values)
        return encoded(Envelope.model_construct(number=chance.randint(1, 2**40), request=request))

    def _value(self, name: str) -> Any:
        chance = self._chance
        match name:
            case "token" | "name" | "author" | "route":
                return "x" * chance.randint(1, 64)
            case "note":
                return "y" * chance.randint(0, 2500)
            case "side":
                return chance.choice(("left", "right"))
            case "number":
                return chance.randint(1, 65535)
            case "take_over":
                return chance.random() < 0.5
            case "exposure_us" | "gain_db":
                return chance.choice((None, 0.0, -1.0, 1e300, 500.0))
            case "changes":
                return {}
        return {"k" * chance.randint(1, 50): [chance.random()] * chance.randint(0, 50)}


def parsed(messages: int) -> tuple[int, float]:
    """Parse changed and random bytes as the cell does; return the number refused, and the longest ms."""
    chance = random.Random(1)
    whole = [encoded(Envelope(number=7, request=request)) for request in EXAMPLES]
    refused, longest_ms = 0, 0.0
    for number in range(messages):
        data = (
            mutated(chance.choice(whole), chance) if number % 4 else chance.randbytes(chance.randint(0, 300))
        )
        began_s = time.process_time()
        try:
            envelope_of(data)
        except LinkError:
            refused += 1
        longest_ms = max(longest_ms, 1e3 * (time.process_time() - began_s))
    return refused, longest_ms


def tried(page: str, messages: int, seconds: float) -> tuple[Reads, Counter[str], tuple[int, ...], float]:
    """Run a cell beside such a page; return reads, messages sent, growth, and seconds."""
    with tempfile.TemporaryDirectory() as name:
        cell = Cell(Path(name), page)
        plc = Plc(cell.files.modbus_port)
        plc.start()
        try:
            while len(plc.reads.cycles) < 2 * PAIRS:
                assert cell.process.poll() is None, cell.log.read_text()[-2000:]
                time.sleep(0.1)
            hostile = HostilePage(cell.socket, 1)
            if page != "none":
                hostile.attack(50, 20.0)  # one-time allocations for a first page count as no growth
            before, began_s = footprint(cell.process.pid, cell.log), time.monotonic()
            if page == "none":
                time.sleep(seconds)
            else:
                hostile.attack(messages, seconds)
            took_s = time.monotonic() - began_s
            time.sleep(1.0)
            growth = tuple(
                after - first
                for after, first in zip(footprint(cell.process.pid, cell.log), before, strict=True)
            )
        finally:
            reads = plc.stop()
            cell.stop()
    return reads, hostile.sent, growth, took_s


def main() -> int:
    """Attack and report."""
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # the cell is still starting
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--messages", type=int, default=20_000, help="in all, without limits")
    parser.add_argument("--most-seconds", type=float, default=3600.0, help="of the messages without limits")
    parser.add_argument("--seconds", type=float, default=20.0, help="without a page, and under limits")
    options = parser.parse_args()
    refused, longest_ms = parsed(options.messages)
    print(f"{options.messages} changed and random messages: {refused} refused, longest {longest_ms:.1f} ms")
    print("\n| page | messages | s | cycles | missing | not VALID | others | read p50, p99, max ms | grown |")
    print("|---|---:|---:|---:|---:|---:|---:|---|---|")
    expected: dict[int, set[tuple[Any, ...]]] = {}
    usual: Counter[str] = Counter()
    bad: list[str] = []
    for page, messages, seconds in (
        ("none", 0, options.seconds),
        ("limited", 10**9, options.seconds),
        ("unlimited", options.messages, options.most_seconds),
    ):
        reads, sent, growth, took_s = tried(page, messages, seconds)
        if page == "none":
            expected = {place: set(told) for place, told in reads.results.items()}
            usual = reads.wrong
        other = sum(
            count
            for place, told in reads.results.items()
            for what, count in told.items()
            if what not in expected.get(place, ())
        )
        p50, p99 = np.percentile(reads.took_ms, (50, 99))
        print(
            f"| {page} | {sent.total()} | {took_s:.0f} | {len(reads.cycles)} | {reads.missing()} | "
            f"{reads.wrong['not VALID']} | {other} | "
            f"{p50:.1f}, {p99:.1f}, {max(reads.took_ms):.0f} | "
            f"{growth[0] / 2**20:.1f} MB, {growth[1]} files, {growth[2] / 1024:.1f} kB of log |",
            flush=True,
        )
        print(f"<!-- {dict(sent)} {dict(reads.wrong)} -->", file=sys.stderr, flush=True)
        grown = any(now > most for now, most in zip(growth, FLAT, strict=True))
        bad += [f"{page}: {what}" for what, is_so in (("other results", other), ("grown", grown)) if is_so]
        fell = {what: count for what, count in reads.wrong.items() if count and page != "none"}
        # on a busy machine a cell without a page loses cycles, too
        bad += [f"{page}: {what} {count} times" for what, count in fell.items() if not usual[what]]
        if len(expected) != PAIRS or any(len(told) != 1 for told in expected.values()):
            bad.append(f"{page}: {[len(told) for told in expected.values()]} results for {PAIRS} pairs")
    for line in bad:
        print(line)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
