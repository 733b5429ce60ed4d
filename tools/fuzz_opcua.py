#!/usr/bin/env python3
"""Throw hostile OPC UA at a cell, and check what it does to it.

Run it with the project's Python: `.venv/bin/python tools/fuzz_opcua.py --frames 1000000`. The cell runs in a
process of its own and allows anonymous reading, so that hostile clients get as far as possible: random bytes,
frames with a good header followed by noise, whole dialogues up to a session with modified requests, invalid
certificates, announcements of huge frames; connections that dribble; a hundred connects at once. Meanwhile a
good client at another address reads, and the cell measures.
Exit code 1 if the good client was ever not served, the cell measured less, or memory, log or descriptors have
grown.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import random
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from asyncua import Client, ua
from helpers.footprint import footprint

from edged.adapters.opcua.structures import ProductIdDataType, RecipeIdExternalDataType

HOSTILE = "127.0.0.2"
WORKERS, LORISES = 4, 2
FLAT_BYTES, FLAT_LOG_BYTES, FLAT_FILES = 8 << 20, 128 << 10, 2
SLOWEST_S = 5.0
HEADER = struct.Struct("<3scI")
TOKEN = b"\x05\x00\x00\x20\x00\x00\x00"  # a NodeId of 32 bytes, as sessions have
SERVER = """
import logging, sys
from pathlib import Path
from dataclasses import replace
logging.basicConfig(level=logging.INFO)
from helpers.opcuacell import OpcUaCell, secure_settings
with OpcUaCell(secure_settings(Path(sys.argv[1]), anonymous=True), period_s=0.05) as cell:
    print(cell.publisher.port, flush=True)
    sys.stdin.read()
"""


class Server:
    """The cell in its own process."""

    def __init__(self, folder: Path) -> None:
        self.log = folder / "log.txt"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVER, str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env={**os.environ, "PYTHONPATH": sys.path[0] + os.pathsep + str(Path(sys.path[0]).parent)},
            )
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    @property
    def url(self) -> str:
        """URL for clients."""
        return f"opc.tcp://127.0.0.1:{self.port}"

    async def connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect a hostile client."""
        return await asyncio.open_connection("127.0.0.1", self.port, local_addr=(HOSTILE, 0))

    def stop(self) -> int:
        """Stop it; return its exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        return self.process.wait(30)


async def recorded(server: Server) -> list[bytes]:
    """Frames of a client that browses, reads, calls and subscribes."""
    frames: list[bytes] = []

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", server.port)

        async def copy(
            source: asyncio.StreamReader, sink: asyncio.StreamWriter, keep: list[bytes] | None
        ) -> None:
            with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
                while True:
                    head = await source.readexactly(HEADER.size)
                    frame = head + await source.readexactly(HEADER.unpack(head)[2] - HEADER.size)
                    if keep is not None:
                        keep.append(frame)
                    sink.write(frame)
            sink.close()

        await asyncio.gather(copy(reader, back, frames), copy(there, writer, None))

    proxy = await asyncio.start_server(pass_on, "127.0.0.1", 0)
    port = proxy.sockets[0].getsockname()[1]

    class Notes:
        def datachange_notification(self, node: object, value: object, data: object) -> None:
            pass

    async with Client(f"opc.tcp://127.0.0.1:{port}") as client:
        node = client.get_node("ns=3;s=VisionSystem")
        await node.get_children()
        await node.get_child(["2:VisionStateMachine"])
        await client.get_node("ns=3;s=Registers.result.X").read_data_value(raise_on_bad_status=False)
        recipes = client.get_node("ns=3;s=VisionSystem.RecipeManagement")
        numbers = [
            ua.Variant(0, kind)
            for kind in (ua.VariantType.UInt32, ua.VariantType.UInt32, ua.VariantType.Int32)
        ]
        await recipes.call_method(
            "2:GetRecipeListFiltered",
            RecipeIdExternalDataType(),
            ProductIdDataType(),
            ua.Variant(2, ua.VariantType.Int32),
            *numbers,
        )
        subscription = await client.create_subscription(100, Notes())
        await subscription.subscribe_data_change(client.get_node("ns=3;s=Registers.status.HEARTBEAT"))
        await subscription.delete()
    proxy.close()
    await proxy.wait_closed()
    return frames


def mutated(frame: bytes, dice: random.Random, start: int) -> bytes:
    """Frame changed after `start`: bits, bytes, numbers, length; the header's length is mostly correct."""
    body = bytearray(frame[start:])
    for _ in range(dice.randint(1, 4)):
        kind, at = dice.randrange(6), dice.randrange(len(body) or 1)
        if kind == 0 and body:
            body[at] ^= 1 << dice.randrange(8)
        elif kind == 1 and body:
            body[at] = dice.randrange(256)
        elif kind == 2:
            body[at : at + 4] = struct.pack("<I", dice.choice([0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x10000, 255]))
        elif kind == 3:
            del body[at:]
        elif kind == 4:
            body[at:at] = dice.randbytes(dice.randint(1, 64))
        else:
            body[at : at + 8] = body[: dice.randint(1, 64)]
    size = start + len(body) if dice.random() < 0.95 else dice.randrange(2**32)
    return frame[:4] + struct.pack("<I", size) + frame[8:start] + bytes(body)


class Hostile:
    """Sends frames until there are enough."""

    def __init__(self, server: Server, dialogue: list[bytes], frames: int, seed: int) -> None:
        self.server, self.dialogue, self.left = server, dialogue, frames
        self.dice = random.Random(seed)
        self.sent: Counter[str] = Counter()

    async def work(self) -> None:
        """Attack on one connection after another."""
        kinds = {"noise": self.noise, "headers": self.headers, "certificates": self.certificates}
        while self.left > 0:
            name = self.dice.choice([*kinds, *["dialogues"] * 4])
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, TimeoutError, struct.error):
                async with asyncio.timeout(10):
                    reader, writer = await self.server.connect()
                    try:
                        await (kinds[name](writer) if name in kinds else self.talk(reader, writer))
                    finally:
                        writer.transport.abort()

    def count(self, kind: str, number: int = 1) -> None:
        """Count frames sent."""
        self.sent[kind] += number
        self.left -= number

    async def noise(self, writer: asyncio.StreamWriter) -> None:
        """Send random bytes."""
        for _ in range(5):
            writer.write(self.dice.randbytes(self.dice.randint(1, 3000)))
            await writer.drain()
            self.count("noise")

    async def headers(self, writer: asyncio.StreamWriter) -> None:
        """Send a good header followed by noise."""
        writer.write(self.dialogue[0])
        for _ in range(5):
            body = self.dice.randbytes(self.dice.randint(0, 2000))
            kind = self.dice.choice([b"OPN", b"MSG", b"CLO", b"HEL", b"ERR", b"ACK"])
            size = len(body) + 8 if self.dice.random() < 0.8 else self.dice.randrange(2**32)
            writer.write(HEADER.pack(kind, self.dice.choice([b"F", b"C", b"A"]), size) + body)
            await writer.drain()
            self.count("headers")

    async def certificates(self, writer: asyncio.StreamWriter) -> None:
        """Open a channel with an invalid or unknown certificate."""
        uri = b"http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256"
        writer.write(self.dialogue[0])
        der = b"0\x82" + self.dice.randbytes(self.dice.randint(2, 1500))
        fields = (uri, der, self.dice.randbytes(20))
        body = struct.pack("<I", 0) + b"".join(struct.pack("<i", len(one)) + one for one in fields)
        body += self.dice.randbytes(256)
        writer.write(HEADER.pack(b"OPN", b"F", len(body) + 8) + body)
        await writer.drain()
        self.count("certificates", 2)

    async def talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Replay the dialogue with its channel's and session's numbers; from a random step on modify it."""
        begin = self.dice.randrange(1, len(self.dialogue))
        channel, token = b"\0\0\0\0", b""
        for number, frame in enumerate(self.dialogue):
            said = frame
            if number >= 2:
                said = frame[:8] + channel + frame[12:]
                at = said.find(TOKEN)
                if token and at >= 0:
                    said = said[: at + len(TOKEN)] + token + said[at + len(TOKEN) + 32 :]
            if number >= begin:
                for _ in range(4):
                    writer.write(
                        mutated(said, self.dice, self.dice.choice([8, 12, 24, 24, 24]) if number > 1 else 8)
                    )
                    self.count("changed requests")
                await writer.drain()
                continue
            writer.write(said)
            self.count("dialogues")
            await writer.drain()
            if number < 4:
                head = await reader.readexactly(HEADER.size)
                answer = await reader.readexactly(HEADER.unpack(head)[2] - HEADER.size)
                if number == 1:
                    channel = answer[:4]
                at = answer.find(TOKEN)
                if at >= 0:
                    token = answer[at + len(TOKEN) :][:32]
        await asyncio.sleep(0.05)


async def loris(server: Server, stop: asyncio.Event) -> None:
    """Send a byte now and then of an endless frame, or nothing at all."""
    while not stop.is_set():
        with contextlib.suppress(OSError, TimeoutError):
            _, writer = await server.connect()
            writer.write(HEADER.pack(b"HEL", b"F", 60000))
            for _ in range(40):
                writer.write(b"\0")
                await writer.drain()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stop.wait(), 0.5)
            writer.transport.abort()


async def flood(server: Server) -> None:
    """Connect a hundred times at once."""
    opened = await asyncio.gather(*(server.connect() for _ in range(100)), return_exceptions=True)
    for one in opened:
        if not isinstance(one, BaseException):
            one[1].transport.abort()


async def good(server: Server, stop: asyncio.Event, slowest_s: list[float], cycles: list[int]) -> int:
    """Read the registers repeatedly; return how often. Raises for a wrong or missing answer."""
    names = ("SEQ_HEAD", "SEQ_TAIL", "CYCLE")
    reads = 0
    async with Client(server.url, timeout=20) as client:
        nodes = [client.get_node(f"ns=3;s=Registers.result.{name}") for name in names]
        while not stop.is_set():
            start_s = time.monotonic()
            head, tail, cycle = await client.read_values(nodes)
            slowest_s.append(time.monotonic() - start_s)
            if head != tail or (cycles and cycle < cycles[-1]):
                raise ValueError(f"halves of two results: {head}, {tail}, cycle {cycle}")
            cycles.append(cycle)
            reads += 1
            await asyncio.sleep(0.02)
    return reads


async def attack(server: Server, frames: int, seed: int) -> tuple[Counter[str], int, float, float]:
    """Attack; return frames sent by kind, good reads, the slowest of them, and cycles a second meanwhile."""
    dialogue = await recorded(server)
    stop, slow, cycles = asyncio.Event(), list[float](), list[int]()
    client = asyncio.create_task(good(server, stop, slow, cycles))
    others = [asyncio.create_task(loris(server, stop)) for _ in range(LORISES)]
    hostile = Hostile(server, dialogue, frames, seed)
    await asyncio.sleep(0.5)
    start_s, first = time.monotonic(), cycles[-1]
    working = [asyncio.create_task(hostile.work()) for _ in range(WORKERS)]
    while not all(task.done() for task in working):
        await asyncio.wait([*working, client], timeout=5, return_when=asyncio.FIRST_COMPLETED)
        if client.done():
            break
        await flood(server)
    rate = (cycles[-1] - first) / (time.monotonic() - start_s)
    stop.set()
    reads = await client
    for task in (*working, *others):
        task.cancel()
    await asyncio.gather(*working, *others, return_exceptions=True)
    return hostile.sent, reads, max(slow), rate


def main() -> int:
    """Attack, check and report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=10_000, help="how many hostile frames")
    parser.add_argument("--seed", type=int, default=1, help="of the dice")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        server = Server(Path(folder))
        asyncio.run(
            attack(server, max(options.frames // 5, 2000), options.seed + 1)
        )  # one-time allocations are made now
        time.sleep(1.0)
        before = footprint(server.process.pid, server.log)
        start_s = time.monotonic()
        sent, reads, slowest_s, rate = asyncio.run(attack(server, options.frames, options.seed))
        took_s = time.monotonic() - start_s
        time.sleep(1.5)
        after = footprint(server.process.pid, server.log)
        code = server.stop()
        log = server.log.read_text()
    grown = [late - early for early, late in zip(before, after, strict=True)]
    print(
        f"{sum(sent.values())} frames in {took_s:.0f} s:",
        ", ".join(f"{n} {kind}" for kind, n in sent.items()),
    )
    print(f"good client: {reads} reads, the slowest {slowest_s * 1e3:.0f} ms; {rate:.1f} cycles a second")
    print(
        f"memory {before[0] / 1e6:.1f} to {after[0] / 1e6:.1f} MB, log +{grown[2]} B, "
        f"files {before[1]} to {after[1]}"
    )
    bad = [
        what
        for what, is_bad in (
            ("memory has grown", grown[0] > FLAT_BYTES),
            ("the log has grown", grown[2] > FLAT_LOG_BYTES),
            ("descriptors were left", grown[1] > FLAT_FILES),
            ("the good client had to wait", slowest_s > SLOWEST_S),
            ("the cell measured less than half as often", rate < 5.0),
            ("the cell has not ended in order", code != 0),
            ("there is a trace in the log", "Traceback" in log),
        )
        if is_bad
    ]
    print("; ".join(bad) if bad else "every read was good, nothing has grown")
    if bad:
        print(log[-3000:])
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
