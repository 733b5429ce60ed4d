#!/usr/bin/env python3
"""Throw hostile frames at a cell's EtherNet/IP adapter, and check what they do to it.

Run it with the project's Python: `.venv/bin/python tools/fuzz_ethernetip.py --frames 1000000`. The cell runs
in a process of its own. It receives random bytes and mutated messages over TCP and over both UDP ports: every
command of the encapsulation, every service, Forward_Open and Forward_Close, outputs with guessed ids, from
the scanner's own address and from others; sessions that are silent, torn down or never read. Meanwhile a good
scanner by other authors exchanges inputs and outputs every 20 ms and locates parts. Exit code 1 if it ever
lost its connection or saw a wrong part, or if memory, log or descriptors have grown.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from helpers import plcmemories as at
from helpers.enipcell import DATA, MESSAGES, Scanner, own_address
from helpers.footprint import footprint

HOSTILE = ("127.0.0.1", "127.0.0.66", "127.0.0.67")
"""Addresses of hostile clients; the first is also the good scanner's."""
FLAT_BYTES, FLAT_LOG_BYTES, FLAT_FILES = 6 << 20, 64 << 10, 2
SERVER = """
import contextlib, logging, sys
logging.basicConfig(level=logging.INFO)
from helpers.enipcell import adapter_of
from helpers.livecell import LiveCell
from helpers.snapshots import make_target
cell = LiveCell()
cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
with cell, adapter_of(cell, sys.argv[1]):
    print("ready", flush=True)
    sys.stdin.read()
"""


class GoodScanner(threading.Thread):
    """Locates one part after the other, and checks each image."""

    def __init__(self, host: str) -> None:
        super().__init__()
        self._scanner = Scanner(host, multiplier=4)  # 64 times 20 ms: this machine's processors are shared
        self._program = self._scanner.run()
        self.located = 0
        self.problems: list[str] = []
        self.done = threading.Event()

    def run(self) -> None:
        """Run until `done`, or until it is not served."""
        try:
            while not self.done.is_set():
                self._program.locate()
                _, _, x_mm = self._program.scan()
                if x_mm != 10.0:
                    self.problems.append(f"a part at {x_mm} mm")
                self._program.write(at.CONTROL, 0)
                self._program.until(lambda bits: not bits & at.DONE)
                self.located += 1
        except AssertionError as error:
            self.problems.append(f"not served: {error!r}")
        finally:
            self._scanner.stop()


def requests() -> list[bytes]:
    """Valid requests of objects, including the Connection Manager."""
    paths = [
        bytes((0x20, number, 0x24, one)) for number in (1, 2, 4, 6, 0xF5, 0xF6) for one in (0, 1, 100, 150)
    ]
    found = [bytes((service, 2)) + path for service in (1, 14, 5) for path in paths]
    found += [bytes((14, 3)) + path + bytes((0x30, i)) for path in paths for i in (1, 3, 5, 7)]
    manager = bytes((2, 0x20, 6, 0x24, 1))
    for consumer, there, back, transport in ((150, 70, 130, 1), (152, 2, 130, 1), (150, 66, 130, 0x81)):
        path = bytes((0x20, 4, 0x24, 151, 0x2C, consumer, 0x2C, 100))
        head = struct.pack("<BBIIHHIB3x", 10, 240, 0, 77, consumer, 4242, 99, 0)
        small = struct.pack("<IHIHBB", 20000, there | 0x4800, 20000, back | 0x4800, transport, 4)
        large = struct.pack("<IIIIBB", 20000, there | 2 << 29, 20000, back | 2 << 29, transport, 4)
        found += [b"\x54" + manager + head + small + path, b"\x5b" + manager + head + large + path]
        found.append(b"\x4e" + manager + struct.pack("<BBHHIBB", 10, 240, consumer, 4242, 99, 4, 0) + path)
    explicit = struct.pack(
        "<BBIIHHIB3xIHIHBB", 10, 240, 0, 78, 5, 4242, 99, 0, 9**6, 0x43F4, 9**6, 0x43F4, 0xA3, 2
    )
    return [*found, b"\x54" + manager + explicit + b"\x20\x02\x24\x01"]


class EnipFuzzer:
    """Sends everything hostile; counts frames by kind."""

    def __init__(self, host: str, dice: random.Random) -> None:
        self.host, self.dice = host, dice
        self.requests = requests()
        self.sent: Counter[str] = Counter()
        self.silent: list[socket.socket] = []
        self.udp = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in HOSTILE]
        for line, source in zip(self.udp, HOSTILE, strict=True):
            line.bind((source, 0))
            line.setblocking(False)

    def mutated(self, data: bytes) -> bytes:
        """Message with up to three wrong bytes; one in ten has another length."""
        found, dice = bytearray(data), self.dice
        for _ in range(dice.randrange(4)):
            found[dice.randrange(len(found))] = dice.randrange(256)
        if dice.random() < 0.1:
            found = found[: dice.randrange(1, len(found) + 1)] + dice.randbytes(dice.randrange(20))
        return bytes(found)

    def frame(self, session: int) -> bytes:
        """Message of the encapsulation; one header in fifty is wrong, too."""
        dice = self.dice
        request = self.mutated(dice.choice(self.requests))
        command = dice.choice((0x6F,) * 12 + (0x70, 0x70, 0, 4, 0x63, 0x64, 0x65, 0x72))
        if command == 0x6F:
            data = struct.pack("<IHHHHHH", 0, 0, 2, 0, 0, 0xB2, len(request)) + request
            data = self.mutated(data) if dice.random() < 0.2 else data
        elif command == 0x70:
            number = dice.randrange(1 << 32)
            data = struct.pack("<IHHHHIHHH", 0, 0, 2, 0xA1, 4, number, 0xB1, len(request) + 2, 1) + request
        else:
            data = bytes((1, 0, 0, 0)) if command == 0x65 else b""
        head = bytearray(struct.pack("<HHII8sI", command, len(data), session, 0, bytes(8), 0))
        if dice.random() < 0.02:
            head[dice.randrange(24)] = dice.randrange(256)
        return bytes(head) + data

    def session(self, frames: int) -> None:
        """One TCP connection, in bursts, until it is closed; one in ten never reads its answers."""
        reads = self.dice.random() > 0.1
        with contextlib.suppress(OSError), self._connected() as line:
            line.sendall(struct.pack("<HHII8sI", 0x65, 4, 0, 0, bytes(8), 0) + bytes((1, 0, 0, 0)))
            number = struct.unpack("<HHI", line.recv(64)[:8])[2]
            while frames > 0:
                burst = self.dice.randrange(1, 40)
                self.sent["over TCP"] += burst
                frames -= burst
                line.sendall(b"".join(self.frame(number) for _ in range(burst)))
                if reads and not line.recv(65536):
                    return

    def torn(self, count: int) -> None:
        """Sessions that are reset within a message, and random bytes."""
        for _ in range(count):
            self.sent["torn"] += 1
            with contextlib.suppress(OSError), self._connected() as line:
                line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                data = self.frame(1)
                line.sendall(data[: self.dice.randrange(1, len(data))] or self.dice.randbytes(100))

    def quiet(self, count: int) -> None:
        """Silent sessions."""
        for line in self.silent:
            line.close()
        self.silent = []
        for _ in range(count):
            with contextlib.suppress(OSError):
                self.silent.append(socket.create_connection((self.host, MESSAGES), 2.0, (HOSTILE[1], 0)))

    def datagrams(self, count: int) -> None:
        """Datagrams to both UDP ports: outputs with guessed ids, requests, noise."""
        dice = self.dice
        for _ in range(count):
            line = dice.choice(self.udp)
            port = dice.choice((DATA, DATA, MESSAGES))
            if port == DATA:
                body = dice.choice(
                    (bytes(70), b"\1\0\1\0\0\0" + b"\xff" * 64, dice.randbytes(dice.randrange(90)))
                )
                head = (2, 0x8002, 8, dice.randrange(1 << 32), dice.randrange(1 << 32), 0xB1, len(body))
                data = struct.pack("<HHHIIHH", *head) + body
            else:
                data = struct.pack("<HHII8sI", dice.choice((0x63, 4, 0x64, 0x65)), 0, 0, 0, bytes(8), 0)
            data = self.mutated(data) if dice.random() < 0.7 else dice.randbytes(dice.randrange(1, 200))
            self.sent["over UDP"] += 1
            with contextlib.suppress(OSError):
                line.sendto(data, (self.host, port))
            with contextlib.suppress(OSError):
                line.recv(65536)

    def attack(self, frames: int) -> None:
        """Send `frames` frames of all kinds."""
        end = self.sent.total() + frames
        while self.sent.total() < end:
            self.quiet(self.dice.randrange(12) if self.dice.random() < 0.2 else 0)
            for _ in range(5):
                self.session(400)
                self.datagrams(400)
            self.torn(10)
        self.quiet(0)

    def close(self) -> None:
        """Close all connections."""
        self.quiet(0)
        for line in self.udp:
            line.close()

    def _connected(self) -> socket.socket:
        # keep none from the good scanner's address: its own session would then be the longest silent one
        return socket.create_connection((self.host, MESSAGES), 2.0, (self.dice.choice(HOSTILE), 0))


def main(frames: int, seed: int) -> int:
    """Attack, then judge."""
    host = own_address()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.txt"
        with log.open("wb") as written:
            process = subprocess.Popen(
                [sys.executable, "-c", SERVER, host],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=written,
                env={**os.environ, "PYTHONPATH": sys.path[0]},
            )
        assert process.stdout is not None and process.stdin is not None
        process.stdout.readline()
        good, fuzzer = GoodScanner(host), EnipFuzzer(host, random.Random(seed))
        good.start()
        start_s = time.monotonic()
        fuzzer.attack(frames // 10)  # allocators and buffers reach their size
        before = footprint(process.pid, log)
        fuzzer.attack(frames - frames // 10)
        duration_s = time.monotonic() - start_s
        time.sleep(12.0)  # a connection without data ends after ten seconds
        after = footprint(process.pid, log)
        good.done.set()
        good.join()
        fuzzer.close()
        problems = list(good.problems)
        process.stdin.close()
        process.stdout.close()
        if code := process.wait(30):
            problems.append(f"the cell ended with code {code}")
        said = log.read_text()
    if "Traceback" in said:
        problems.append(said[said.index("Traceback") :][:2000])
    names = ("bytes of memory", "open files", "bytes of log")
    for name, one, other, limit in zip(
        names, before, after, (FLAT_BYTES, FLAT_FILES, FLAT_LOG_BYTES), strict=True
    ):
        print(f"{name:16} {one:12,d} -> {other:12,d}")
        if other - one > limit:
            problems.append(f"{name} grew by {other - one}")
    print(f"{fuzzer.sent.total():,d} frames in {duration_s:.0f} s: {dict(fuzzer.sent)}")
    print(f"good scanner: {good.located:,d} parts located")
    if not good.located:
        problems.append("the good scanner located nothing")
    print("\n".join(problems) or "no crash, no lost connection, nothing grew, every part was good")
    return 1 if problems else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    sys.exit(main(given.frames, given.seed))
