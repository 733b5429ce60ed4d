"""Authenticity of a cell's messages: false, changed and repeated ones are detected, over real sessions."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import io
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from helpers.schema_check import load_schema, violations
from helpers.snapshots import make_snapshot
from helpers.waiting import LIMIT_S, WHOLE_S, until
from helpers.zenohcell import READY, Cell
from rich.console import Console

from edged.adapters.zenoh import open_session, session_config
from edged.adapters.zenoh.listener import subscribed
from edged.commands.watch import WatchOptions, watch
from edged.domain.measurement import Status
from edged.errors import UserError

SCHEMA = load_schema()
KEY = b"0123456789abcdef0123456789abcdef"
OTHER = b"fedcba9876543210fedcba9876543210"
HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "zenoh.md"
Message = tuple[str, bytes, bytes | None]


class Stranger:
    """A client with access that publishes whatever it likes, and records what the cell publishes."""

    def __init__(self, port: int) -> None:
        self.session = open_session(session_config("client", [], [f"tcp/127.0.0.1:{port}"]))
        self.heard: list[Message] = []
        self._subscriber = self.session.declare_subscriber("edged/*/*", self._note)

    def _note(self, sample: zenoh.Sample) -> None:
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        self.heard.append((str(sample.key_expr), sample.payload.to_bytes(), attachment))

    def says(self, key: str, payload: bytes, attachment: bytes | None) -> None:
        """Publish under a cell's key."""
        self.session.put(key, payload, attachment=attachment, encoding=zenoh.Encoding.APPLICATION_JSON)

    def targets(self) -> list[Message]:
        """Target messages of the cell."""
        return [message for message in self.heard if message[0].endswith("/target")]


@contextlib.contextmanager
def stranger_at(port: int) -> Iterator[Stranger]:
    """A connected stranger."""
    stranger = Stranger(port)
    try:
        yield stranger
    finally:
        stranger.session.close()


class Subscriber:
    """Records what is received from cell1."""

    def __init__(self, port: int, key: bytes | None, stack: contextlib.ExitStack) -> None:
        self.cycles: list[int] = []
        self.kinds: set[str] = set()
        self.lock = threading.Lock()
        self.listening = stack.enter_context(
            subscribed([f"tcp/127.0.0.1:{port}"], "*", self._hear, shared_key=key)
        )

    def _hear(self, _cell: str, kind: str, document: dict[str, Any]) -> None:
        with self.lock:
            self.kinds.add(kind)
            if kind == "target":
                self.cycles.append(document["cycle"])


def changed(message: Message, **fields: object) -> Message:
    """The message with a changed payload."""
    key, payload, attachment = message
    return key, json.dumps({**json.loads(payload), **fields}).encode(), attachment


def resealed(message: Message, **fields: object) -> Message:
    """The message with a changed attachment."""
    key, payload, attachment = message
    return key, payload, json.dumps({**json.loads(attachment or b"{}"), **fields}).encode()


def signed_with(key: bytes, message: Message) -> Message:
    """The message signed with another key, with the layout of the manual."""
    name, payload, attachment = message
    seal = json.loads(attachment or b"{}")
    head = f"edged/1\n{name}\n{seal['session']}\n{seal['counter']}\n0\n\n".encode()
    return resealed(message, mac=hmac.new(key, head + payload, hashlib.sha256).hexdigest())


FALSE: dict[str, Callable[[Message], Message]] = {
    "another part": lambda true: changed(true, cycle=99),
    "no attachment": lambda true: (true[0], changed(true, cycle=99)[1], None),
    "not JSON": lambda true: (true[0], true[1], b"\xff{"),
    "a list": lambda true: (true[0], true[1], b"[]"),
    "no mac": lambda true: resealed(true, mac=""),
    "mac is no text": lambda true: resealed(true, mac=7),
    "a later counter": lambda true: resealed(true, counter=json.loads(true[2] or b"")["counter"] + 1),
    "a counter that is no number": lambda true: resealed(true, counter="9"),
    "an enormous counter": lambda true: resealed(true, counter=10**300),
    "another session": lambda true: resealed(true, session="0badf00d"),
    "another key": lambda true: signed_with(OTHER, resealed(true, counter=2**62)),
    "under another cell's name": lambda true: ("edged/cell2/target", true[1], true[2]),
    "under another kind": lambda true: ("edged/cell1/health", true[1], true[2]),
    "again": lambda true: true,
}


@pytest.mark.slow
async def test_who_has_the_key_hears_the_cell_alone():
    """With the shared key, a subscriber gets only the cell's own messages, and each false one is counted."""
    async with Cell(mode="router", shared_key=KEY) as cell:
        with contextlib.ExitStack() as stack:
            stranger = stack.enter_context(stranger_at(cell.port))
            subscriber = Subscriber(cell.port, KEY, stack)
            await until(lambda: "health" in subscriber.kinds and stranger.heard)
            cell.publisher.announce(make_snapshot(1))
            await until(lambda: subscriber.cycles == [1] and stranger.targets())
            for count, forge in enumerate(FALSE.values(), 1):
                stranger.says(*forge(stranger.targets()[0]))
                await until(lambda count=count: dropped(subscriber) == count)
            cell.publisher.announce(make_snapshot(2))
            await until(lambda: subscriber.cycles == [1, 2])
            old = stranger.targets()[0]
            stranger.says(*old)  # a message that was valid before
            await until(lambda: dropped(subscriber) == len(FALSE) + 1)
            assert [1, 2] == subscriber.cycles


def dropped(subscriber: Subscriber) -> int:
    """Number of messages dropped, of all cells."""
    return sum(int(re.search(r": (\d+) messages?", text)[1]) for text in subscriber.listening.doubts())


@pytest.mark.slow
async def test_who_comes_late_or_meets_a_restart_hears_the_cell():
    """The last result is signed, too, and after a restart the counter continues in another session."""
    async with Cell(mode="router", shared_key=KEY) as cell:
        cell.publisher.announce(READY)
        cell.publisher.announce(make_snapshot(1))
        with contextlib.ExitStack() as stack:
            subscriber = Subscriber(cell.port, KEY, stack)
            await until(lambda: subscriber.cycles == [1] and "state" in subscriber.kinds)
            await cell.publisher.close()
            here = (f"tcp/127.0.0.1:{cell.port}",)
            async with Cell(mode="router", shared_key=KEY, listen=here) as again:
                again.publisher.announce(make_snapshot(2))
                await until(lambda: subscriber.cycles == [1, 2])
            assert [] == subscriber.listening.doubts()


@pytest.mark.long
async def test_without_a_key_two_sessions_of_a_name_are_named():
    """A peer that publishes under the cell's name is reported once the cell continues, but a restart is
    not."""
    async with Cell(mode="router") as cell:
        with contextlib.ExitStack() as stack:
            stranger = stack.enter_context(stranger_at(cell.port))
            subscriber = Subscriber(cell.port, None, stack)
            await until(lambda: "health" in subscriber.kinds and stranger.heard)
            assert [] == subscriber.listening.doubts()
            true = stranger.heard[-1]
            session = json.loads(true[2])["session"]
            stranger.says(*resealed(true, session="0badf00d"))
            await until(lambda: subscriber.listening.doubts())
            (doubt,) = subscriber.listening.doubts()
            assert doubt.startswith("cell1: two Zenoh sessions publish for it, ")
            assert session in doubt
            assert "0badf00d" in doubt


@pytest.mark.parametrize("key", [KEY, None])
async def test_an_answer_is_bound_to_what_was_asked(key: bytes | None):
    """The MAC covers the parameters with their nonce, so that an earlier answer is invalid; the cell is
    named."""
    async with Cell(mode="router", shared_key=key) as cell:
        cell.publisher.announce(make_snapshot(4))
        cell.commander.react = lambda command: cell.publisher.announce(make_snapshot(5, command=command))
        with stranger_at(cell.port) as asker:
            for name in ("last", "jobs", "config", "trigger"):
                parameters = f"nonce={os.urandom(8).hex()}"
                (reply,) = await asyncio.to_thread(
                    lambda name=name, asked=parameters: list(
                        asker.session.get(f"edged/cell1/{name}?{asked}", timeout=WHOLE_S)
                    )
                )
                payload, seal = reply.ok.payload.to_bytes(), json.loads(reply.ok.attachment.to_bytes())
                head = f"edged/1\nedged/cell1/{name}\n{seal['session']}\n{seal['counter']}\n"
                text = f"{head}{len(parameters)}\n{parameters}\n".encode()
                mac = None if key is None else hmac.new(key, text + payload, hashlib.sha256).hexdigest()
                assert mac == seal.get("mac")
                assert [] == violations(seal, SCHEMA["$defs"]["attachment"], SCHEMA)
            (reply,) = await asyncio.to_thread(
                lambda: list(asker.session.get("edged/cell1/trigger?kind=x", timeout=WHOLE_S))
            )
            assert seal["session"] == json.loads(reply.err.payload.to_bytes())["session"]


async def watched(
    cell: Cell, stranger: Stranger, key: Path | None, capsys: pytest.CaptureFixture[str]
) -> tuple[str, str]:
    """Output of `edged watch` for two results of a cell with a false one between them."""
    shown = io.StringIO()
    options = WatchOptions(
        connect=(f"tcp/127.0.0.1:{cell.port}",), count=2 if key else 3, timeout_s=30.0, shared_key=key
    )
    await until(lambda: stranger.heard)
    watching = asyncio.create_task(asyncio.to_thread(watch, options, Console(file=shown, width=200)))
    try:
        cell.publisher.announce(make_snapshot(1))
        await until(lambda: "cycle      1" in shown.getvalue() and stranger.targets())
        stranger.says(*changed(resealed(stranger.targets()[0], session="0badf00d"), cycle=99))
        await asyncio.sleep(0.5)
        cell.publisher.announce(make_snapshot(2))
        assert 0 == await watching
    finally:
        await watching
    return shown.getvalue(), capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("has_key", [True, False])
async def test_watch_shows_what_is_the_cells_own_and_says_what_is_not(
    has_key: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """With the key the false result is dropped and counted; without it, it is shown with a warning."""
    file = tmp_path / "zenoh.key"
    file.write_bytes(KEY + b"\n")
    file.chmod(0o600)
    async with Cell(mode="router", shared_key=KEY) as cell:
        with stranger_at(cell.port) as stranger:
            shown, said = await watched(cell, stranger, file if has_key else None, capsys)
    assert has_key == ("cycle     99" not in shown)
    assert ("cell1: 1 message dropped: false, repeated, or signed with another key" in said) == has_key
    assert ("cell1: two Zenoh sessions publish for it" in said) != has_key


@pytest.mark.parametrize(
    ("content", "mode", "words"),
    [
        (KEY, 0o644, "every user of this machine may read it: .*chmod"),
        (KEY[:-1], 0o600, "31 bytes: expected a shared key of 32 at least"),
        (KEY * 200, 0o600, "6400 bytes are too many for a shared key"),
    ],
)
def test_a_key_that_is_none_is_refused(content: bytes, mode: int, words: str, tmp_path: Path):
    """A key that others may read, or that is too short or long, is refused."""
    file = tmp_path / "zenoh.key"
    file.write_bytes(content)
    file.chmod(mode)
    with pytest.raises(UserError, match=f"{file}: {words}"):
        watch(WatchOptions(shared_key=file), Console(file=io.StringIO()))


class Program:
    """A running Python program, and the lines it prints."""

    def __init__(self, text: str, folder: Path) -> None:
        self.lines: list[str] = []
        self._process = subprocess.Popen(
            [sys.executable, "-u", "-c", text], cwd=folder, stdout=subprocess.PIPE, text=True
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        self.lines.extend(iter(self._process.stdout.readline, ""))

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(LIMIT_S)
        self._reader.join()
        self._process.stdout.close()


@pytest.mark.slow
async def test_the_manuals_subscriber_prints_what_comes(tmp_path: Path):
    """The manual's first program, run as printed, prints each result."""
    block = re.findall(r"```python\n(.*?)```", HOW_TO.read_text("utf-8"), re.DOTALL)[0]
    async with Cell(mode="router") as cell:
        with Program(block.replace("7447", str(cell.port)), tmp_path) as running:
            while not running.lines:  # wait until it is connected
                cell.publisher.announce(make_snapshot(1))
                await asyncio.sleep(0.1)
            cell.publisher.announce(make_snapshot(2, Status.NO_TARGET))
            await until(lambda: "NO_TARGET\n" in running.lines)
            lines = running.lines
    assert {"OK\n"} == set(lines[:-1])


@pytest.mark.slow
async def test_the_manuals_subscriber_tells_false_messages_apart(tmp_path: Path):
    """The manual's program, run as printed beside a stranger, prints each of the cell's own results once."""
    blocks = re.findall(r"```python\n(.*?)```", HOW_TO.read_text("utf-8"), re.DOTALL)
    (block,) = [block for block in blocks if "hmac" in block]
    (tmp_path / "zenoh.key").write_bytes(KEY + b"\n")
    async with Cell(mode="router", shared_key=KEY) as cell:
        program = block.replace("7447", str(cell.port))
        with stranger_at(cell.port) as stranger, Program(program, tmp_path) as running:
            cell.publisher.announce(make_snapshot(0))
            while not running.lines:  # wait until it is connected
                cell.publisher.announce(make_snapshot(1))
                await asyncio.sleep(0.1)
            await until(stranger.targets)
            for forge in FALSE.values():
                stranger.says(*forge(stranger.targets()[0]))
            cell.publisher.announce(make_snapshot(2))
            await until(lambda: "2 OK\n" in running.lines)
            lines = running.lines
    assert {"1 OK\n"} == set(lines[:-1])
    assert "2 OK\n" == lines[-1]
