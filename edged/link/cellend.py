"""The cell's end of the link: it never blocks, keeps the newest data, and does not trust what arrives.

A thread of its own encodes and sends; the event loop only fills queues of bounded length. Another thread
reads what arrives, at a bounded rate: a page that floods fills only its own socket's buffer. A page that
sends an invalid message, or does not read, loses the link.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Protocol

from edged.codec.plainerrors import plain_error
from edged.connections import Rate
from edged.domain.arrays import Image
from edged.domain.events import Event, ExposureDone
from edged.domain.frames import FramePair
from edged.errors import EdgedError, LinkError, SetupRefused
from edged.link.pictures import PictureRing
from edged.link.receiver import Receiver
from edged.link.requests import (
    GREETING,
    MAX_BYTES,
    Asked,
    AskExchanges,
    AskMetrics,
    AskRegisters,
    Envelope,
    InstallRelease,
    KeepBeside,
    TakePair,
    encoded,
    envelope_of,
    greeting_of,
)
from edged.link.stream import Frames, send_within
from edged.link.summary import CellSummary, FilesInUse, PageTask, ProgramStep
from edged.link.values import CODEC

log = logging.getLogger(__name__)

EVENTS, PAIRS, STEPS = 256, 2, 20
"""Maximum events waiting to be sent; of these with pictures; steps of a robot's registration."""
UNDERWAY, CAPTURES = 16, 4
"""Maximum requests under way plus unsent answers, beyond which no more are read; of these with pictures."""
REQUESTS_PER_S, REQUESTS_AT_ONCE = 200.0, 400.0
EXPENSIVE_REQUESTS, EXPENSIVE_COST = (AskExchanges, AskMetrics, AskRegisters), 20
"""Requests that take milliseconds of the event loop, and the number of others that each counts for."""
COUNTED_BYTES = 1024
"""Bytes of a message that count as one further request: to check 15 kB of numbers takes 3 ms of the loop."""
REST_S = 0.05
"""Pause before a page that has exceeded its rate is read again."""
WRITE_S = 15.0
"""Time without reading after which a page loses the link: a page that starts on a busy PC first imports."""
BEAT_S = 1.0
"""Longest interval between summaries: a page that gets none knows that the cell's event loop hangs."""
GREET_S = 60.0
"""Time for a process to start on a busy PC and send its version."""


class ServedCell(Protocol):
    """The cell as served to a page: state to send, and requests to carry out; called on the event loop."""

    @property
    def task(self) -> PageTask:
        """Description of what the page is to serve."""

    def summary(self) -> CellSummary:
        """State of the cell at this moment."""

    def version(self) -> object:
        """Identity of the files in use: another object whenever the cell uses other files."""

    def files(self, version: object) -> FilesInUse:
        """The files of a version; called on any thread."""

    async def answer(self, request: Asked, memory: int | None = None) -> object:
        """Carry out a request of a page. memory : sealed, that came with it; open until this returns.

        Raises `EdgedError`, `OSError`.
        """


class CellEnd:
    """Link to one page.

    connection : a Unix stream socket, owned from now on. listening : sockets for the page to serve.
    """

    def __init__(
        self, connection: socket.socket, view: ServedCell, listening: Sequence[socket.socket] = ()
    ) -> None:
        connection.setblocking(False)
        self._connection = connection
        self._view = view
        self._listening = listening
        self._has_task = False
        self._frames = Frames(MAX_BYTES)
        self._rate = Rate(REQUESTS_PER_S, burst=REQUESTS_AT_ONCE)
        self._rest: asyncio.TimerHandle | None = None
        self._beats: asyncio.TimerHandle
        self._receiver: Receiver | None = None
        self._memory: int | None = None
        self.is_greeted = False
        self._sender = ThreadPoolExecutor(1, thread_name_prefix="page-link")
        self._ring = PictureRing()
        self._wake = asyncio.Event()
        self._answers: deque[dict[str, Any]] = deque()
        self._events: deque[Event] = deque(maxlen=EVENTS)
        self._steps: deque[ProgramStep] = deque(maxlen=STEPS)
        self._is_summary_due = True
        self._sent_version: object = None
        self._captures = 0
        self._underway: set[asyncio.Task[None]] = set()
        self._failed: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def serve(self) -> str:
        """Serve the page until the link ends; return the reason, "" if the page closed it."""
        loop = asyncio.get_running_loop()
        telling = loop.create_task(self._tell(), name="page link")
        greeting = loop.call_later(GREET_S, self._miss_greeting)
        self._beat()
        receiver = self._receiver = Receiver(self._connection, self._arrived)
        receiver.allow()
        try:
            ends: set[asyncio.Future[Any]] = {telling, self._failed}
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if telling.done() and (bug := telling.exception()) is not None:
                log.error("the page cannot be told because of a bug", exc_info=bug)
                return "a bug, see the log"
            return self._failed.result()
        finally:
            greeting.cancel()
            self._beats.cancel()
            if self._rest is not None:
                self._rest.cancel()
            telling.cancel()  # but requests under way are carried out: half a reload would be worse
            await asyncio.gather(telling, return_exceptions=True)
            with contextlib.suppress(OSError):
                self._connection.shutdown(socket.SHUT_RDWR)  # a write under way ends, too
            await loop.run_in_executor(self._sender, receiver.end)
            self._keep(None)
            self._ring.close()
            self._sender.shutdown()
            self._connection.close()

    # --- sent to the page ------------------------------------------------------------------------

    def announce(self, event: Event) -> None:
        """Queue an event to be sent; the oldest are dropped if the page is too slow."""
        self._events.append(event)
        if isinstance(event, ExposureDone):
            self._drop_pairs()
        self._is_summary_due = True
        self._wake.set()

    def tell_step(self, step: ProgramStep) -> None:
        """Queue a step of a robot's registration to be sent."""
        self._steps.append(step)
        self._wake.set()

    def _drop_pairs(self) -> None:
        """Drop the pictures of all queued exposures but the newest `PAIRS`."""
        kept = 0
        for index in range(len(self._events) - 1, -1, -1):
            event = self._events[index]
            if isinstance(event, ExposureDone) and event.pair is not None:
                kept += 1
                if kept > PAIRS:
                    self._events[index] = replace(event, pair=None)

    async def _tell(self) -> None:
        """Send what is new, until the link fails."""
        loop = asyncio.get_running_loop()
        try:
            await loop.run_in_executor(self._sender, self._send, encoded(GREETING), [])
            while True:
                await self._wake.wait()
                self._wake.clear()
                if self.is_greeted:
                    await self._tell_all()
        except (LinkError, OSError) as error:
            self._fail("" if isinstance(error, ConnectionError) else str(error))

    async def _tell_all(self) -> None:
        """Send files before the summary, and both before the answers: a requester then sees the new state."""
        if not self._has_task:
            self._has_task = True
            await self._post("task", self._view.task, sockets=len(self._listening))
        version = self._view.version()
        if version is not self._sent_version:
            files = await asyncio.get_running_loop().run_in_executor(self._sender, self._view.files, version)
            await self._post("files", files)
            self._sent_version = version
        answers, events, steps = list(self._answers), list(self._events), list(self._steps)
        self._events.clear()
        self._steps.clear()
        if self._is_summary_due:
            self._is_summary_due = False
            await self._post("summary", self._view.summary())
        for event in events:
            await self._post("event", event)
        for step in steps:
            await self._post("step", step)
        for answer in answers:
            await self._post("answer", **answer)
            self._answers.popleft()
        if answers and self._rest is None:
            self._hear()

    async def _post(self, kind: str, body: object = None, **more: object) -> None:
        await asyncio.get_running_loop().run_in_executor(self._sender, self._write, kind, body, more)

    def _write(self, kind: str, body: object, more: dict[str, object]) -> None:
        """Encode and send a message, in the sender's thread."""
        images: list[Image] = []
        data = CODEC.encode(body, images)
        message: dict[str, object] = {"kind": kind, "body": data, **more}
        if kind == "task":
            self._send(CODEC.encode(message), [opened.fileno() for opened in self._listening])
            return
        memory = None
        if images:
            placed, memory = self._ring.place(images)
            message |= {"pictures": list(placed), "memory": memory is not None}
        try:
            self._send(CODEC.encode(message), [] if memory is None else [memory])
        finally:
            if memory is not None:
                os.close(memory)

    def _send(self, data: bytes, handles: list[int]) -> None:
        send_within(self._connection, data, handles, WRITE_S)

    # --- requests from the page --------------------------------------------------------------------

    def _arrived(self, data: bytes, memory: int | None) -> None:
        if memory is not None:
            self._keep(memory)
        if not data:
            self._fail("")
            return
        self._frames.feed(data)
        if self._rest is None:
            self._hear()

    def _keep(self, memory: int | None) -> None:
        """Hold only the memory that came last, and close the one before."""
        if self._memory is not None:
            os.close(self._memory)
        self._memory = memory

    def _hear(self) -> None:
        """Carry out the complete messages, within the rate that a page may use."""
        try:
            while not self._is_full and self._frames.has_next():
                if not self._rate.take():
                    self._rest = asyncio.get_running_loop().call_later(REST_S, self._go_on)
                    return
                message = self._frames.next()
                self._rate.owe(len(message) // COUNTED_BYTES)
                if self.is_greeted:
                    envelope = envelope_of(message)
                    self._rate.owe(EXPENSIVE_COST if isinstance(envelope.request, EXPENSIVE_REQUESTS) else 0)
                    self._carry_out(envelope)
                else:
                    self._greet(message)
        except LinkError as error:
            self._fail(str(error))
            return
        if not self._is_full and not self._failed.done() and self._receiver is not None:
            self._receiver.allow()

    @property
    def _is_full(self) -> bool:
        """Whether the maximum of requests is under way, or answered but not sent."""
        return len(self._underway) + len(self._answers) >= UNDERWAY

    def _go_on(self) -> None:
        self._rest = None
        self._hear()

    def _beat(self) -> None:
        """Mark the summary as due now, and again after each `BEAT_S`."""
        self._is_summary_due = True
        self._wake.set()
        self._beats = asyncio.get_running_loop().call_later(BEAT_S, self._beat)

    def _miss_greeting(self) -> None:
        if not self.is_greeted:
            self._fail(f"the page has not said a word within {GREET_S:g} s")

    def _greet(self, message: bytes) -> None:
        greeting_of(message).check("the page")
        self.is_greeted = True
        self._wake.set()

    def _carry_out(self, envelope: Envelope) -> None:
        memory = None
        # only these requests take the memory: it may have been received together with earlier messages
        if isinstance(envelope.request, InstallRelease | KeepBeside):
            memory, self._memory = self._memory, None
        task = asyncio.get_running_loop().create_task(self._answer(envelope, memory), name="page's request")
        self._underway.add(task)
        task.add_done_callback(self._carried_out)

    def _carried_out(self, task: asyncio.Task[None]) -> None:
        self._underway.discard(task)
        if not task.cancelled() and (bug := task.exception()) is not None:
            log.error("a request of the page ended in a bug", exc_info=bug)
            self._fail("a bug, see the log")

    async def _answer(self, envelope: Envelope, memory: int | None) -> None:
        try:
            answer: dict[str, Any] = {"body": await self._done(envelope.request, memory), "error": None}
        except (EdgedError, OSError) as error:
            answer = {"body": None, "error": plain_error(error)}
        finally:
            if memory is not None:
                os.close(memory)
        self._answers.append({"number": envelope.number, **answer})
        self._is_summary_due = True
        self._wake.set()

    async def _done(self, request: Asked, memory: int | None) -> object:
        if isinstance(request, InstallRelease | KeepBeside) and memory is None:
            raise LinkError("a release without its archive, or a file without its text")
        if not isinstance(request, TakePair):
            return await self._view.answer(request, memory)
        waiting = sum(isinstance(answer["body"], FramePair) for answer in self._answers)
        if self._captures + waiting >= CAPTURES:
            raise SetupRefused("too many pictures were asked for at once")
        self._captures += 1
        try:
            return await self._view.answer(request)
        finally:
            self._captures -= 1

    def _fail(self, why: str) -> None:
        """Note that the link has failed. why : "" if the other end closed it."""
        if not self._failed.done():
            self._failed.set_result(why)
