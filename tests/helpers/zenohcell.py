"""A cell with a real Zenoh session, and peers in other processes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from edged.adapters.zenoh import ZenohPublisher, ZenohSettings
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Command
from helpers.ports import free_port
from helpers.waiting import LIMIT_S

PEER = Path(__file__).parents[1] / "wire" / "zenoh_peer.py"


READY = CellState(CellPhase.READY, True, True, "flange", 1, 0)


class Peer:
    """`zenoh_peer.py` in a process of its own."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(PEER), *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.lines: queue.Queue[dict[str, Any]] = queue.Queue()
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.put(json.loads(line))

    def line(self, wanted: Callable[[dict[str, Any]], bool], timeout_s: float = LIMIT_S) -> dict[str, Any]:
        """Next line that fulfils the condition."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            line = self.lines.get(timeout=max(0.01, deadline_s - time.monotonic()))
            if wanted(line):
                return line

    async def until(
        self, wanted: Callable[[dict[str, Any]], bool], timeout_s: float = LIMIT_S
    ) -> dict[str, Any]:
        """`line` without blocking the loop."""
        return await asyncio.to_thread(self.line, wanted, timeout_s)

    def close(self, *, kill: bool = False) -> None:
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        if kill:
            self.process.kill()
        self.process.wait(LIMIT_S)
        self.reader.join()
        self.process.stdout.close()


@contextlib.contextmanager
def peer(what: str, *more: str, **config: object) -> Iterator[Peer]:
    """A running peer; keys of config: "mode", "listen__endpoints", ..."""
    text = json.dumps({key.replace("__", "/"): value for key, value in config.items()})
    process = Peer(what, text, *more)
    try:
        if what != "get":
            process.line(lambda line: "up" in line)
        yield process
    finally:
        process.close()


async def ask(port: int, *selectors: str) -> list[dict[str, Any]]:
    """Replies to queries made from another process."""
    config = {"mode": "client", "connect__endpoints": [f"tcp/127.0.0.1:{port}"]}

    def run() -> list[dict[str, Any]]:
        replies: list[dict[str, Any]] = []
        with peer("get", *selectors, **config) as process:
            process.line(lambda line: replies.append(line) is None and "done" in line)
        return replies[:-1]

    return await asyncio.to_thread(run)


def is_message(kind: str, **fields: object) -> Callable[[dict[str, Any]], bool]:
    """Condition: a line is a message of this kind with these fields."""

    def check(line: dict[str, Any]) -> bool:
        document = line.get("document") or {}
        wanted = {"schema": f"edged/{kind}/1", **fields}
        return all(document.get(name) == value for name, value in wanted.items())

    return check


def ignore(command: Command) -> None:
    """Never carry out a command."""


class Commander:
    """Accepts commands; the test decides what happens with them."""

    def __init__(self) -> None:
        self.react: Callable[[Command], None] = ignore
        self.commands: list[Command] = []
        self.came = asyncio.Event()

    def submit(self, command: Command) -> None:
        self.commands.append(command)
        self.came.set()
        self.react(command)


class Cell:
    """A publisher with its commander, on a port of its own."""

    def __init__(self, **settings: Any) -> None:
        self.port = free_port()
        self.commander = Commander()
        given = {"cell": "cell1", "listen": (f"tcp/127.0.0.1:{self.port}",), **settings}
        self.publisher = ZenohPublisher(
            ZenohSettings(**given),
            self.commander,
            jobs=lambda: [(1, "flange"), (2, "cover")],
            config=lambda: {"calibration": "cal"},
        )

    async def __aenter__(self) -> Cell:
        await self.publisher.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.publisher.close()
