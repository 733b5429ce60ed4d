"""The cell's side of the page: keeps a page process running, and replaces it whenever it ends.

The cell opens the port and passes it on, so a browser that connects while the process starts waits a moment,
and no other program can take the port meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import time
from collections.abc import Callable

import numpy as np

from edged.app.pagesource import PageSource
from edged.cell.tasks import cancel_and_await
from edged.connections import listening_on
from edged.domain.arrays import FloatArray
from edged.domain.cell import CellState
from edged.domain.events import Event, ExposureDone, Snapshot
from edged.domain.frames import FramePair
from edged.link.cellend import CellEnd, ServedCell
from edged.link.summary import ProgramStep

log = logging.getLogger(__name__)

PAUSE_S, MOST_PAUSE_S = 0.2, 5.0
"""Backoff before the next page: doubles each time, unless the last page ran for `GOOD_S`."""
GOOD_S = 30.0


class RegistrationReporter:
    """Reports a robot's registration to the page, from any thread.

    Implements `edged.setup.registration.registrar.RegistrationListener`. tell : called on the event loop.
    """

    def __init__(self, tell: Callable[[ProgramStep], None], loop: asyncio.AbstractEventLoop) -> None:
        self._tell = tell
        self._loop = loop

    def begun(self, mount: str, kind: str, board: str, limit_mm: float) -> None:
        """Report that a registration has begun."""
        self._say(ProgramStep("begun", mount=mount, kind=kind, board=board, limit_mm=limit_mm))

    def posed(self, pair: FramePair, robot_from_flange: FloatArray) -> None:
        """Report that a pose was taken."""
        self._say(ProgramStep("posed", pair=pair, pose=robot_from_flange))

    def touched(self, pair: FramePair, job: str, rig_mm: FloatArray, robot_from_tip: FloatArray) -> None:
        """Report that a point (3,) was taken on the part of a job."""
        point_mm = np.asarray(rig_mm)
        self._say(ProgramStep("touched", pair=pair, job=job, point_mm=point_mm, pose=robot_from_tip))

    def activated(self) -> None:
        """Report that the cell measures with the result."""
        self._say(ProgramStep("activated"))

    def _say(self, step: ProgramStep) -> None:
        with contextlib.suppress(RuntimeError):  # the loop may have ended
            self._loop.call_soon_threadsafe(self._tell, step)


class PageServer:
    """Publisher that runs the page (`edged.ports.Publisher`). host, port : where it is served."""

    def __init__(self, host: str, port: int, view: ServedCell, source: PageSource) -> None:
        self._host, self._port = host, port
        self._view = view
        self._source = source
        self._listening: list[socket.socket] = []
        self._end: CellEnd | None = None
        self._running: asyncio.Task[None] | None = None
        self._state: CellState | None = None
        self._exposed: ExposureDone | None = None
        self._snapshot: Snapshot | None = None

    @property
    def pid(self) -> int | None:
        """Id of the page's process; None while there is none."""
        return self._source.pid

    async def start(self) -> None:
        """Open the port and start the task that keeps a page running. Raises `ListenError`."""
        self._listening = await listening_on("status page", self._host, self._port)
        self._running = asyncio.create_task(self._run(), name="page")
        self._running.add_done_callback(_show_bug)

    def announce(self, event: Event) -> None:
        """Pass an event on, and remember those that a page started later needs."""
        match event:
            case CellState():
                self._state = event
            case ExposureDone():
                self._exposed = event
            case Snapshot():
                self._snapshot = event
        if self._end is not None:
            self._end.announce(event)

    def tell_step(self, step: ProgramStep) -> None:
        """Pass on a step of a robot's registration."""
        if self._end is not None:
            self._end.tell_step(step)

    async def close(self) -> None:
        """End the process and close the port."""
        if self._running is not None:
            await cancel_and_await(self._running)
            self._running = None
        for opened in self._listening:
            with contextlib.suppress(OSError):
                opened.shutdown(socket.SHUT_RDWR)  # even if a page that has not ended still holds it
            opened.close()
        self._listening.clear()

    async def _run(self) -> None:
        pause_s = PAUSE_S
        while True:
            started_s = time.monotonic()
            why = await self._serve_once()
            pause_s = PAUSE_S if time.monotonic() - started_s > GOOD_S else min(2 * pause_s, MOST_PAUSE_S)
            log.error("the page has ended%s; another is had in %.1f s", why and f": {why}", pause_s)
            await asyncio.sleep(pause_s)

    async def _serve_once(self) -> str:
        """Get a page and serve it until it or the link ends; return the reason in words."""
        try:
            ours = await self._source.connection()
        except OSError as error:
            return f"it cannot be had: {error.strerror or error}"
        end = CellEnd(ours, self._view, self._listening)
        exposed, last = self._exposed, self._snapshot
        if exposed is not None and (last is None or exposed.cycle != last.cycle):
            exposed = None
        for event in (self._state, exposed, last):
            if event is not None:
                end.announce(event)
        self._end = end
        why = ""
        try:
            why = await end.serve()
        finally:
            self._end = None
            how = await self._source.ended(is_good=not why)
        return why or how


def _show_bug(running: asyncio.Task[None]) -> None:
    """Log a bug at once rather than when the daemon ends; the cell continues without its page."""
    if not running.cancelled() and (bug := running.exception()) is not None:
        log.error("the cell runs without its page, because of a bug", exc_info=bug)
