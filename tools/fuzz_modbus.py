#!/usr/bin/env python3
"""Throw hostile frames of Modbus clients and robots at a cell, and check what they do to it.

Run it with the project's Python: `.venv/bin/python tools/fuzz_modbus.py --frames 1000000`. The cell runs in a
process of its own with a serial line on a pseudo terminal. It receives random bytes, mutated requests of
every function, thousands of pipelined ones; connections that dribble, are silent, are torn down or never
read; a thousand connects at once. The robots' socket receives requests in lines and in binary frames, whole,
mutated, torn and without an end. Meanwhile a good client reads the result block and a good robot asks; both
check every answer. Exit code 1 if one was ever not served, or memory, log or descriptors have grown.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pty
import random
import select
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from helpers.footprint import footprint

GOOD_CLIENT = "127.0.0.9"  # has reserved connections, as a PLC should
IDLE_S = 3.0
MAX_CLIENTS = 32
RTU_SHARE = 0.01  # share of the frames; a serial line needs a silence after each
ROBOTS = 6  # silent ones at a time: with the good and the flooding one they use all connections
FLAT_BYTES, FLAT_LOG_BYTES, FLAT_FILES = 6 << 20, 64 << 10, 2
SERVER = """
import logging, sys, time
from ipaddress import ip_address
logging.basicConfig(level=logging.INFO)
from edged.adapters.modbus import LineSettings, ModbusSettings, SerialSettings
from edged.robot.orientations import Brand
from helpers.livecell import LiveCell
serial = SerialSettings(sys.argv[1], parity="none", gap_s=0.004)
from helpers.snapshots import make_target
from helpers.livecell import GRASPS
settings = ModbusSettings(port=0, serial=serial, idle_s=float(sys.argv[2]), max_clients=int(sys.argv[3]),
                          line=LineSettings(0, Brand.KUKA), reserved={ip_address(sys.argv[4]): 2})
cell = LiveCell(settings, period_s=0.05).pick(GRASPS)
from helpers.hostileregistrar import registrar_of
cell.registrar = registrar_of(cell)
cell.targets = tuple(make_target(x_mm=x_mm) for x_mm in (10.0, 20.0, 30.0))
with cell:
    print(cell.port, cell.server.line_port, flush=True)
    sys.stdin.read()
"""


class Server:
    """The cell in its own process."""

    def __init__(self, folder: Path) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self._slave = slave
        self.log = folder / "log.txt"
        arguments = [os.ttyname(slave), str(IDLE_S), str(MAX_CLIENTS), GOOD_CLIENT]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVER, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env={**os.environ, "PYTHONPATH": sys.path[0]},
            )
        assert self.process.stdout is not None
        self.port, self.robots_port = map(int, self.process.stdout.readline().split())

    def connect(self, source: str = "127.0.0.1", port: int | None = None) -> socket.socket:
        """Connect a client."""
        place = ("127.0.0.1", port or self.port)
        line = socket.create_connection(place, timeout=10, source_address=(source, 0))
        line.setblocking(False)
        return line

    def stop(self) -> int:
        """Stop it cleanly; return its exit code."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        os.close(self.master)
        os.close(self._slave)
        return self.process.wait(30)


class GoodClient(threading.Thread):
    """Reads the result block every 20 ms and checks head, tail and CRC."""

    def __init__(self, server: Server) -> None:
        super().__init__()
        self._line = server.connect(GOOD_CLIENT)
        self._line.settimeout(10)
        self.times_ms: list[float] = []
        self.problems: list[str] = []
        self.done = threading.Event()

    def run(self) -> None:
        """Run until `done`, or until it is not served."""
        from edged.plc.registers import crc16

        with self._line:
            while not self.done.wait(0.02):
                start_s = time.monotonic()
                try:
                    self._line.sendall(struct.pack(">HHHBBHH", 7, 0, 6, 1, 3, 300, 48))
                    answer = b""
                    while len(answer) < 105:
                        part = self._line.recv(105 - len(answer))
                        if not part:
                            raise ConnectionError("closed")
                        answer += part
                except OSError as error:
                    self.problems.append(f"not served: {error!r}")
                    return
                words = answer[9:]
                if crc16(words[:92]) != int.from_bytes(words[92:94], "big") or words[:2] != words[94:]:
                    self.problems.append(f"half of two results: {words.hex()}")
                self.times_ms.append((time.monotonic() - start_s) * 1e3)


class GoodRobot(threading.Thread):
    """Asks every 20 ms where the tool takes the part, alternately in lines and in frames."""

    def __init__(self, server: Server) -> None:
        super().__init__()
        self._line = server.connect(GOOD_CLIENT, server.robots_port)
        self._line.settimeout(10)
        self.answers = 0
        self.problems: list[str] = []
        self.done = threading.Event()

    def run(self) -> None:
        """Run until `done`, or until it is not served."""
        from edged.plc.frames import ANSWER, FrameRequest, read_answer
        from edged.robot.orientations import Brand

        with self._line, self._line.makefile("rb") as file:
            while not self.done.wait(0.02):
                sequence = self.answers % 65535 + 1
                try:
                    if sequence % 2:
                        self._line.sendall(f"{sequence},GRASP\n".encode())
                        fields = file.readline().split(b",")
                        if len(fields) != 13 or int(fields[0]) != sequence:
                            raise ValueError(f"an answer of {len(fields)} fields")
                    else:
                        self._line.sendall(FrameRequest(sequence, "GRASP").frame())
                        read_answer(file.read(ANSWER.size), Brand.KUKA, sequence)
                except (OSError, ValueError) as error:
                    self.problems.append(f"the robot was not served: {error!r}")
                    return
                self.answers += 1


def robots_requests() -> list[bytes]:
    """Valid requests of robots, in lines and in frames."""
    from edged.plc.frames import COMMANDS, FrameRequest

    said = [FrameRequest(i, name, i % 3) for i, name in enumerate(COMMANDS, 1)]
    flange = (512.0, -88.0, 611.0, 12.4, 3.0, 178.3)
    lines = [f"{one.sequence},{one.command},{one.job}" for one in said]
    lines += [f"7,LOCATE,0,{','.join(map(str, flange))}", "8,LOCATE,*", "9,NEXT"]
    frames = [one.frame() for one in (*said, FrameRequest(90, "LOCATE", 0, flange, tries_all=True))]
    return [*(line.encode() + b"\n" for line in lines), *frames]


def requests() -> list[bytes]:
    """Valid request PDUs of every function, including the handshake."""
    return [
        *(struct.pack(">BHH", function, 300, 48) for function in (1, 2, 3, 4)),
        struct.pack(">BHH", 3, 600, 120),
        struct.pack(">BHH", 5, 16 * 105, 0xFF00),
        struct.pack(">BHH", 6, 103, 7),
        struct.pack(">BHHBB", 15, 16 * 105, 1, 1, 1),
        struct.pack(">BHHB3H", 16, 100, 3, 6, 1, 0, 7),
        struct.pack(">BHHB3H", 16, 100, 3, 6, 2, 2, 8),
        struct.pack(">BHHHHB3H", 23, 200, 16, 100, 3, 6, 3, 0, 9),
        *(struct.pack(">BHHB6H", 16, 100, 6, 12, 5, 0, 10 + i, 0, 0, i) for i in range(8)),
        *(
            struct.pack(">BHHB18H", 16, 100, 18, 36, kind, 0, kind, 0, 0, 2, *range(12))
            for kind in (6, 7, 8, 8, 8, 9)
        ),
        *(struct.pack(">BHH", 3, address, words) for address, words in ((400, 52), (540, 35), (1000, 125))),
        bytes((0x2B, 0x0E, 1, 0)),
        bytes((8, 0, 0, 0, 0)),
    ]


class Fuzzer:
    """Sends everything hostile; counts frames by kind."""

    def __init__(self, server: Server, dice: random.Random) -> None:
        self.server, self.dice = server, dice
        self.requests = requests()
        self.robots_requests = robots_requests()
        self.sent: Counter[str] = Counter()
        self.idle: list[socket.socket] = []

    def mutated(self) -> bytes:
        """Request with wrong bytes, mostly after a correct header."""
        dice, pdu = self.dice, bytearray(self.dice.choice(self.requests))
        for _ in range(dice.randrange(4)):
            pdu[dice.randrange(len(pdu))] = dice.randrange(256)
        if dice.random() < 0.1:
            pdu = pdu[: dice.randrange(1, len(pdu) + 1)] + dice.randbytes(dice.randrange(20))
        return bytes(pdu)

    def frame(self) -> bytes:
        """Modbus/TCP frame with a mutated request; one header in 500 is wrong, too."""
        dice, pdu = self.dice, self.mutated()
        header = bytearray(
            struct.pack(">HHHB", dice.randrange(65536), 0, len(pdu) + 1, dice.choice((1, 1, 1, 0, 9)))
        )
        if dice.random() < 0.002:
            header[dice.randrange(7)] = dice.randrange(256)
        return bytes(header) + pdu

    def flood(self, frames: int) -> None:
        """Pipelined frames on one connection until it is closed; one in ten never reads its answers."""
        reads = self.dice.random() > 0.1
        with self._connected() as line:
            for _ in range(frames // 100):
                data = b"".join(self.frame() for _ in range(100))
                self.sent["pipelined"] += 100
                if line is None or not self._push(line, data, reads):
                    return

    def noise(self) -> None:
        """Send random bytes."""
        with self._connected() as line:
            self.sent["random"] += 1
            if line is not None:
                self._push(line, self.dice.randbytes(self.dice.randrange(1, 600)), reads=True)

    def robots(self, messages: int) -> None:
        """Attack the robots' socket with messages whole, mutated, torn, endless, one connection at a time."""
        dice, end = self.dice, self.sent["robots"] + messages
        while self.sent["robots"] < end:
            with self._connected(self.server.robots_port) as line:
                self.sent["robots"] += 1
                reads = dice.random() > 0.1
                for _ in range(dice.randrange(1, 20)):
                    data = bytearray(dice.choice(self.robots_requests))
                    for _ in range(dice.choice((0, 0, 1, 3))):
                        data[dice.randrange(len(data))] = dice.randrange(256)
                    if dice.random() < 0.1:
                        data = data[: dice.randrange(len(data))] + dice.randbytes(dice.randrange(300))
                    self.sent["robots"] += 1
                    if line is None or not self._push(line, bytes(data), reads):
                        break

    def torn(self, count: int) -> None:
        """Reset connections in the middle of a frame."""
        for _ in range(count):
            with self._connected() as line:
                self.sent["torn"] += 1
                if line is not None:
                    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                    self._push(line, self.frame()[: self.dice.randrange(1, 8)], reads=False)

    def silent(self, count: int) -> None:
        """Open silent connections that stay until the cell closes them."""
        for line in self.idle:
            line.close()
        self.idle = []
        for _ in range(count):
            self.sent["silent"] += 1
            with contextlib.suppress(OSError):
                self.idle.append(self.server.connect())
        for _ in range(min(count, ROBOTS)):
            self.sent["silent"] += 1
            with contextlib.suppress(OSError):
                self.idle.append(self.server.connect(port=self.server.robots_port))

    def dribble(self) -> None:
        """Send one more byte on every connection that is still open."""
        for line in self.idle:
            self.sent["dribbled"] += 1
            with contextlib.suppress(OSError):
                line.send(b"\0")

    def serial(self, frames: int) -> None:
        """Frames on the serial line: damaged, for others, broadcast, noise, without pauses."""
        for _ in range(frames):
            self.sent["serial"] += 1
            body = bytes((self.dice.choice((1, 1, 0, 9)),)) + self.mutated()
            data = (
                body + struct.pack("<H", _crc(body)) if self.dice.random() < 0.8 else self.dice.randbytes(200)
            )
            with contextlib.suppress(BlockingIOError):
                os.write(self.server.master, data)
            if self.dice.random() < 0.8:
                time.sleep(0.006)
            with contextlib.suppress(BlockingIOError):
                os.read(self.server.master, 65536)

    @contextlib.contextmanager
    def _connected(self, port: int | None = None):
        try:
            line = self.server.connect(port=port)
        except OSError:  # the backlog is full, or it was closed while we connected
            yield None
            return
        with line:
            yield line

    def _push(self, line: socket.socket, data: bytes, reads: bool) -> bool:
        """Send, reading what comes; return False once the cell has closed the connection or takes no more."""
        while data:
            readable, writable, _ = select.select(
                [line] if reads else [], [line], [], 0.5 if not reads else 5.0
            )
            try:
                if readable and not line.recv(65536):
                    return False
                if writable:
                    data = data[line.send(data) :]
            except BlockingIOError:
                continue
            except OSError:
                return False
            if not readable and not writable:
                return False
        return True


def _crc(data: bytes) -> int:
    from edged.plc.registers import crc16

    return crc16(data)


def attack(fuzzer: Fuzzer, frames: int) -> None:
    """Send `frames` frames of all kinds."""
    end = fuzzer.sent.total() + frames
    fuzzer.torn(min(1000, frames // 20))
    while fuzzer.sent.total() < end:
        fuzzer.silent(fuzzer.dice.randrange(2 * MAX_CLIENTS) if fuzzer.dice.random() < 0.2 else 0)
        for _ in range(5):
            fuzzer.flood(2000)
            fuzzer.noise()
            fuzzer.dribble()
        fuzzer.torn(5)
        fuzzer.robots(2000)
        fuzzer.serial(int(10_000 * RTU_SHARE))
    fuzzer.silent(0)


def line_answers(server: Server) -> bool:
    """Whether the serial line still gives a correct answer to a valid request."""
    request = bytes((1, 3, 0, 0, 0, 1))
    request += struct.pack("<H", _crc(request))
    for _ in range(10):
        time.sleep(0.05)
        with contextlib.suppress(BlockingIOError):
            os.read(server.master, 65536)
        os.write(server.master, request)
        ready, _, _ = select.select([server.master], [], [], 1.0)
        if ready:
            time.sleep(0.02)
            if os.read(server.master, 100).startswith(bytes((1, 3, 2, 0x45, 0x44))):
                return True
    return False


def main(frames: int, seed: int) -> int:
    """Attack, then judge."""
    with tempfile.TemporaryDirectory() as folder:
        server = Server(Path(folder))
        good = GoodClient(server)
        robot = GoodRobot(server)
        good.start()
        robot.start()
        fuzzer = Fuzzer(server, random.Random(seed))
        start_s = time.monotonic()
        attack(fuzzer, frames // 10)  # allocators and buffers reach their size
        before = footprint(server.process.pid, server.log)
        attack(fuzzer, frames - frames // 10)
        duration_s = time.monotonic() - start_s
        time.sleep(IDLE_S + 1.5)
        after = footprint(server.process.pid, server.log)
        for one in (good, robot):
            one.done.set()
            one.join()
        problems = [*good.problems, *robot.problems]
        if not line_answers(server):
            problems.append("the serial line does not answer any more")
        code = server.stop()
    names = ("bytes of memory", "open files", "bytes of log")
    limits = (FLAT_BYTES, FLAT_FILES, FLAT_LOG_BYTES)
    for name, one, other, limit in zip(names, before, after, limits, strict=True):
        print(f"{name:16} {one:12,d} -> {other:12,d}")
        if other - one > limit:
            problems.append(f"{name} grew by {other - one}")
    if code:
        problems.append(f"the cell ended with code {code}")
    times_ms = sorted(good.times_ms) or [float("nan")]
    print(f"{fuzzer.sent.total():,d} frames in {duration_s:.0f} s: {dict(fuzzer.sent)}")
    print(
        f"good client: {len(times_ms):,d} reads, p50 {times_ms[len(times_ms) // 2]:.1f} ms, "
        f"p99 {times_ms[len(times_ms) * 99 // 100]:.1f} ms, worst {times_ms[-1]:.1f} ms"
    )
    print(f"good robot: {robot.answers:,d} answers")
    print("\n".join(problems) or "no crash, no stuck connection, nothing grew, every read was good")
    return 1 if problems else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    sys.exit(main(given.frames, given.seed))
