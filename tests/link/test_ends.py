"""The cell's end of the link: whatever a page sends, asks or does not read, the cell measures on."""

from __future__ import annotations

import asyncio
import os
import random
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import cbor2
import pytest
from helpers.linkmessages import EXAMPLES
from helpers.mutations import mutated
from helpers.scriptedhead import Ear, Head, make_setup, running
from helpers.waiting import until

from edged.cell.cycle import Cycle
from edged.domain.cell import CellPhase
from edged.domain.events import Event
from edged.domain.exposure import CameraValues
from edged.domain.frames import FramePair
from edged.errors import CaptureError, LinkError, SetupRefused
from edged.link import cellend
from edged.link import requests as ask
from edged.link.cellend import CellEnd
from edged.link.memory import sealed, sealed_bytes
from edged.link.pageend import PageEnd
from edged.link.requests import Envelope, Greeting, encoded, envelope_of
from edged.link.stream import framed
from edged.link.summary import CellSummary, FilesInUse, PageTask

FILES = FilesInUse("{}", {"rig.json": b"1"}, "f00d")
LONG = ask.OnStage(route="PUT /stage", body={f"k{number}": [1.5] * 8 for number in range(190)})
LONG_BYTES = len(encoded(Envelope(number=1, request=LONG)))
NEVER_READ: list[socket.socket] = []
"""Ends of connections that stay open, and full."""


class View:
    """A cell as the page sees it; its lease and its pictures are a real cycle's."""

    task = PageTask(Path("/etc/edged/cell.toml"), "cell1")

    def __init__(self, cycle: Cycle) -> None:
        self.cycle = cycle
        self.asked = 0
        self.may_install, self.installed = asyncio.Event(), b""

    def summary(self) -> CellSummary:
        return CellSummary(holder=self.cycle.session.holder)

    def version(self) -> object:
        return self

    def files(self, _version: object) -> FilesInUse:
        return FILES

    async def answer(self, request: ask.Asked, memory: int | None = None) -> object:
        self.asked += 1
        session = self.cycle.session
        match request:
            case ask.EnterSetup():
                return await session.enter_setup(request.name, take_over=request.take_over)
            case ask.LeaveSetup():
                await session.leave_setup(request.token)
            case ask.RenewLease():
                await session.renew_setup(request.token)
            case ask.TakePair():
                return await session.capture(request.token)
            case ask.InstallRelease():
                await self.may_install.wait()
                assert memory is not None
                self.installed = sealed_bytes(memory, 100)
            case ask.AdjustCamera():
                return await session.adjust(request.token, request.side, CameraValues(request.exposure_us))
        return None


class Scene:
    """A measuring cell and its links."""

    def __init__(self, cycle: Cycle, head: Head, ear: Ear) -> None:
        self.cycle, self.head, self.ear = cycle, head, ear
        self.view = View(cycle)
        self.ends: list[CellEnd] = []

    @asynccontextmanager
    async def linked(self) -> AsyncIterator[tuple[socket.socket, asyncio.Task[str]]]:
        """The page's side of a link, and the task that serves it."""
        ours, theirs = socket.socketpair()
        theirs.setblocking(False)
        end = CellEnd(ours, self.view)
        self.ends.append(end)
        serving = asyncio.create_task(end.serve())
        try:
            yield theirs, serving
        finally:
            self.ends.remove(end)
            theirs.close()
            await serving

    async def goes_on(self) -> None:
        """Wait until the cell has further results."""
        seen = len(self.ear.snapshots())
        await until(lambda: len(self.ear.snapshots()) > seen + 2)

    def announce(self, event: Event) -> None:
        """Announce an event as the page's publisher does."""
        for end in self.ends:
            end.announce(event)

    async def start(self) -> None:
        """Do nothing; publishers have this method."""

    async def close(self) -> None:
        """Do nothing; publishers have this method."""


@asynccontextmanager
async def measuring() -> AsyncIterator[Scene]:
    """A running cell."""
    head, ear = Head(), Ear()
    cycle = Cycle(head, make_setup(period_s=0.002))
    scene = Scene(cycle, head, ear)
    async with running(cycle, ear, scene):
        await until(ear.snapshots)
        yield scene


@pytest.mark.long
def test_what_is_no_request_is_refused_and_never_more_than_read() -> None:
    """Of a hundred thousand random or changed messages each is read, or refused with a `LinkError`."""
    chance = random.Random(1)
    messages = [encoded(Envelope(number=7, request=request)) for request in EXAMPLES]
    assert list(EXAMPLES) == [envelope_of(message).request for message in messages]
    refused = 0
    for number in range(100_000):
        message = messages[number % len(messages)]
        data = mutated(message, chance) if number % 4 else chance.randbytes(chance.randint(0, 200))
        try:
            envelope_of(data)
        except LinkError:
            refused += 1
    assert refused > 50_000
    deep = cbor2.dumps({"number": 1, "request": {"ask": "stage", "route": "x", "body": {}}})
    for hostile in (
        deep.replace(b"dbody\xa0", b"dbody" + b"\xa1\x61a" * 5000 + b"\xa0"),
        b"\xbb" + b"\xff" * 8,
        b"\x9b\x00\x00\x00\xff\xff\xff\xff\xff",
        b"\xd9\xd9\xf7" * 1000,
    ):
        with pytest.raises(LinkError, match="no message"):
            envelope_of(hostile)


@pytest.mark.slow
async def test_a_page_that_sends_anything_costs_no_cycle(caplog: pytest.LogCaptureFixture) -> None:
    """Hundreds of links with greetings, requests and rubbish all end, and the cell measures on."""
    chance = random.Random(2)
    messages = [encoded(Envelope(number=7, request=request)) for request in EXAMPLES]
    async with measuring() as scene:
        for number in range(200):
            async with scene.linked() as (page, serving):
                said = [framed(encoded(ask.GREETING))] if number % 5 else []
                for _ in range(20):
                    wrong = mutated(chance.choice(messages), chance)
                    said.append(framed(wrong) if chance.random() < 0.9 else mutated(framed(wrong), chance))
                with suppress(OSError, BlockingIOError):
                    page.sendall(b"".join(said))
                if number % 3 == 0:
                    await asyncio.wait({serving}, timeout=0.01)
        await scene.goes_on()
        assert CellPhase.READY is scene.ear.state() or scene.cycle.session.holder == ""
    assert "bug" not in caplog.text


async def test_a_message_that_is_too_long_ends_the_link() -> None:
    """A message with a too large length ends the link at once."""
    async with measuring() as scene:
        async with scene.linked() as (page, serving):
            page.sendall((1 << 31).to_bytes(4, "big"))
            assert "at most" in await serving
        await scene.goes_on()


async def test_another_version_is_refused_by_name() -> None:
    """Another version is refused on either side, with both versions in the message."""
    async with measuring() as scene:
        async with scene.linked() as (page, serving):
            page.sendall(framed(encoded(Greeting(edged="9.9", schema_id="0"))))
            assert "the page is edged 9.9 (schema 0)" in await serving
        ours, theirs = socket.socketpair()
        link = PageEnd(theirs)
        ours.sendall(framed(encoded(Greeting(edged="0.0", schema_id="0"))))
        with pytest.raises(LinkError, match=r"the cell is edged 0\.0 .*start both anew"):
            await link.greet()
        link.close()
        ours.close()


async def test_who_says_nothing_loses_the_link_and_who_greets_keeps_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A link without a greeting ends after a time, one with a greeting stays."""
    monkeypatch.setattr(cellend, "GREET_S", 0.1)
    async with measuring() as scene, scene.linked() as (page, serving), scene.linked() as (_, silent):
        page.sendall(framed(encoded(ask.GREETING)))
        assert "not said a word" in await silent
        await asyncio.sleep(0.1)
        assert not serving.done()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("request_", "price"),
    [
        (ask.RenewLease(token="x"), 1),
        (ask.AskMetrics(), 1 + cellend.EXPENSIVE_COST),
        (LONG, 1 + LONG_BYTES // 1024),
    ],
    ids=["plain", "dear", "long"],
)
async def test_a_flood_is_read_no_faster_than_allowed(request_: ask.Asked, price: int) -> None:
    """Requests are carried out at the allowed rate, slower for expensive ones, and cycles go on.

    The sender waits.
    """
    async with measuring() as scene, scene.linked() as (page, serving):
        page.sendall(framed(encoded(ask.GREETING)))
        asked = framed(encoded(Envelope(number=1, request=request_))) * 100
        loop = asyncio.get_running_loop()
        start_s = loop.time()

        async def flood() -> None:
            while True:
                await loop.sock_sendall(page, asked)

        async def swallow() -> None:
            while await loop.sock_recv(page, 1 << 16):
                pass

        flooding = [asyncio.create_task(work) for work in (flood(), swallow())]
        await until(lambda: scene.view.asked * price > 2 * cellend.REQUESTS_AT_ONCE)
        most = cellend.REQUESTS_AT_ONCE + cellend.REQUESTS_PER_S * (loop.time() - start_s)
        assert scene.view.asked * price <= most + price
        await scene.goes_on()
        for task in flooding:
            task.cancel()
        await asyncio.gather(*flooding, return_exceptions=True)
        assert not serving.done()


@pytest.mark.slow
async def test_a_page_that_reads_nothing_loses_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that does not read loses the link, and the cell measures on."""
    monkeypatch.setattr(cellend, "WRITE_S", 0.3)
    async with measuring() as scene:
        async with scene.linked() as (page, serving):
            page.sendall(framed(encoded(ask.GREETING)))
            page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            assert "has not read" in await serving
        await scene.goes_on()


async def test_an_answer_finds_what_has_become_of_the_cell() -> None:
    """The holder is known before the token arrives, pictures arrive unchanged, and the token belongs to
    its holder."""
    async with measuring() as scene:
        async with scene.linked() as (page, _):
            link = PageEnd(page.dup())
            await link.greet()
            holders: list[str] = []

            async def hear() -> None:
                async for told in link.news():
                    holders.append(told.body.holder if told.kind == "summary" else (holders or [""])[-1])

            hearing = asyncio.create_task(hear())
            token = await link.ask(ask.EnterSetup(name="Anna"))
            assert "Anna" == holders[-1]
            pair: FramePair = await link.ask(ask.TakePair(token=token))
            assert (4, 4) == pair.left.image.shape
            with pytest.raises(SetupRefused):
                await link.ask(ask.RenewLease(token="of nobody"))
            scene.head.broken = True
            with pytest.raises(CaptureError, match="unplugged") as fault:
                await link.ask(ask.TakePair(token=token))
            assert ("left", 104) == (fault.value.camera, fault.value.code)
            scene.head.broken = False
            await link.ask(ask.LeaveSetup(token=token))
            assert "" == holders[-1]
            page.shutdown(socket.SHUT_RDWR)
            await hearing
            with pytest.raises(LinkError):
                await link.ask(ask.AskMetrics())
            link.close()
        await scene.goes_on()


async def test_what_was_asked_is_carried_out_without_the_page() -> None:
    """A release is installed although the page was killed meanwhile."""
    async with measuring() as scene:
        async with scene.linked() as (page, serving):
            page.sendall(framed(encoded(ask.GREETING)))
            asked: Any = framed(encoded(Envelope(number=1, request=EXAMPLES[8])))
            memory = sealed(b"release")
            socket.send_fds(page, [asked], [memory])
            os.close(memory)
            await until(lambda: scene.view.asked)
            page.close()
            await serving
        assert not scene.view.installed
        scene.view.may_install.set()
        await until(lambda: scene.view.installed == b"release")


async def test_a_release_has_its_archive_whatever_was_asked_just_before() -> None:
    """A release gets its archive also if it is read together with the message before it."""
    async with measuring() as scene, scene.linked() as (page, _):
        scene.view.may_install.set()
        asked = [
            Envelope(number=1, request=ask.EnterSetup(name="a")),
            Envelope(number=2, request=EXAMPLES[8]),
        ]
        memory = sealed(b"release")
        data: Any = b"".join(framed(message) for message in [encoded(ask.GREETING), *map(encoded, asked)])
        socket.send_fds(page, [data], [memory])
        os.close(memory)
        await until(lambda: scene.view.installed == b"release")


def lingering() -> socket.socket:
    """A socket whose closing takes seconds, because its data are never read."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
    ours.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            ours.send(bytes(1 << 16))
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 3))
    NEVER_READ.append(theirs)
    return ours


@pytest.mark.long
async def test_closing_what_a_page_passes_holds_nobody_up() -> None:
    """Slow closing of passed descriptors, one or several, holds up neither the loop nor the page."""
    async with measuring() as scene:
        async with scene.linked() as (page, _):
            data: Any = framed(encoded(ask.GREETING))
            for piece in (data[:3], data[3:]):
                with lingering() as first, lingering() as second:
                    socket.send_fds(page, [piece], [first.fileno(), second.fileno()])
            loop = asyncio.get_running_loop()
            longest_s, before_s = 0.0, loop.time()
            while not scene.ends[0].is_greeted:
                await asyncio.sleep(0.001)
                longest_s, before_s = max(longest_s, loop.time() - before_s), loop.time()
            assert longest_s < 1.5
        for theirs in NEVER_READ:
            theirs.close()
        NEVER_READ.clear()


async def test_descriptors_from_a_page_are_not_taken() -> None:
    """Further descriptors from a page are closed, so the cell cannot run out of them."""
    async with measuring() as scene, scene.linked() as (page, serving):
        before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208  (the kernel's, at once)
        data: Any = framed(encoded(ask.GREETING))
        socket.send_fds(page, [data], [page.fileno()] * 50)
        await until(lambda: scene.ends[0].is_greeted)
        assert len(os.listdir("/proc/self/fd")) <= before + 3  # noqa: PTH208  (likewise)
        assert not serving.done()
