"""The page's process: HTTP, people, set-up, drafts, audit, manual and the worker, for the cell at the link.

`python -m edged.app.page LEVEL LINK`, where LEVEL is the log level, and LINK is the number of an inherited
socket if the cell starts it, or the path of the cell's socket if it is a service (`edged.app.pagesource`).
"""

from __future__ import annotations

import gc

if __name__ == "__main__":
    gc.disable()  # until all is imported, which leaves no garbage; collections took a tenth of the start

import asyncio
import contextlib
import faulthandler
import logging
import os
import select
import socket
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from edged.adapters.journal import set_up_logging
from edged.adapters.web import SettingUp, WebPublisher
from edged.app.garbage import freeze_garbage
from edged.app.remotecell import RemoteCell
from edged.app.setup import SetupServices
from edged.app.wantedservers import web_settings
from edged.cell.lease.live import LivePictures
from edged.cell.lease.notices import Notices
from edged.domain.cell import CellPhase, SetupSource
from edged.domain.events import Event
from edged.domain.numerals import is_whole, whole
from edged.errors import EdgedError, LinkError
from edged.files.statefolder import page_folder
from edged.link.pageend import LinkNews, PageEnd
from edged.link.summary import PageTask, ProgramStep
from edged.setup.registration.program import RobotProgram

log = logging.getLogger(__name__)

CLOSE_S = 5.0
SILENT_S = 5.0
"""A cell that is silent for this long hangs; it sends a heartbeat every second (`link.cellend.BEAT_S`)."""
REACH_S, AGAIN_S = 10.0, 0.2
"""A page service without a cell tries to connect every `AGAIN_S` for `REACH_S`, then ends to be restarted."""
GONE_S = 1.0
"""Grace period of a page after its cell has gone; then its process is ended."""


class Page:
    """The page of one cell, from the first message of the link until its end."""

    def __init__(self, link: PageEnd, task: PageTask) -> None:
        self._task = task
        self.cell = RemoteCell(link, task.path)
        self.notices = Notices()
        self._web: WebPublisher | None = None
        self.setup: SetupServices | None = None
        self._live: LivePictures | None = None
        self._heard_s = time.monotonic()
        self._is_silent = False
        self._waiting: list[Callable[[], None]] | None = []

    async def start(self, listening: Sequence[socket.socket]) -> None:
        """Start serving, after files and summary have arrived. Raises `EdgedError`."""
        section = self.cell.files.config.web
        if section is None:
            raise LinkError("the cell runs without a page")
        notices = self.notices
        self._live = live = LivePictures(self.cell.session, notices)
        settings = web_settings(section, page_folder(self._task.path))
        routes: list[object] = []
        if section.commissioning:
            self.setup = SetupServices(self.cell, notices, live, self._task.addresses)
            routes += self.setup.routes()
            if self._task.is_staged:
                from edged.setup.stage.forwarding import ForwardedStage  # imported only with the simulation

                routes.append(ForwardedStage(self.cell.on_stage))
        self._web = WebPublisher(
            self._task.cell,
            settings,
            self.cell,
            self.cell.metrics,
            setup=SettingUp(self.cell.session, notices, live, routes),
        )
        await self._web.start(listening)
        waiting, self._waiting = self._waiting, None
        for what in waiting or ():
            what()

    async def watch(self) -> None:
        """Announce a fault when the cell has become silent; `hear` withdraws it."""
        while True:
            heard_s = self._heard_s
            await asyncio.sleep(SILENT_S)
            before = self.cell.state
            if heard_s == self._heard_s and before is not None and not self._is_silent:
                self._is_silent = True
                log.error("the cell has said nothing for %g s", SILENT_S)
                error = "the cell does not answer its page"
                self._announce(
                    replace(before, state=CellPhase.FAULT, ready=False, error=error, setup=SetupSource.NONE)
                )

    def _speaks_again(self) -> None:
        self._heard_s = time.monotonic()
        if self._is_silent and self.cell.state is not None:
            self._is_silent = False
            self._announce(self.cell.state)

    async def hear(self, news: LinkNews) -> None:
        """Process one message from the cell."""
        self._speaks_again()
        match news.kind:
            case "files":
                await self.cell.take_files(news.body)
            case "summary":
                self.cell.take_summary(news.body)
            case "event":
                event = self.cell.take_event(news.body)
                self._do(lambda: self._announce(event))
            case "step":
                self._do(lambda: self._tell_of(news.body))

    def _do(self, what: Callable[[], None]) -> None:
        """Call it now, or once the page serves."""
        if self._waiting is None:
            what()
        else:
            self._waiting.append(what)

    def _announce(self, event: Event) -> None:
        if self._web is not None:
            self._web.announce(event)

    def _tell_of(self, step: ProgramStep) -> None:
        if self.setup is not None:
            tell_of(step, self.setup.program)

    async def close(self) -> None:
        """Release all resources."""
        if self._web is not None:
            await self._web.close()
        if self._live is not None:
            await self._live.close()
        if self.setup is not None:
            await self.setup.close()


def tell_of(step: ProgramStep, program: RobotProgram) -> None:
    """Add a step of a robot's registration to its draft; a step whose pictures are lost is skipped."""
    match step.step:
        case "begun":
            mount: Any = step.mount
            kind: Any = step.kind
            program.begun(mount, kind, step.board, step.limit_mm)
        case "posed" if step.pair is not None and step.pose is not None:
            program.posed(step.pair, step.pose)
        case "touched" if step.pair is not None and step.pose is not None and step.point_mm is not None:
            program.touched(step.pair, step.job, step.point_mm, step.pose)
        case "activated":
            program.activated()


async def serve(
    connection: socket.socket,
    named: Callable[[str], None] = lambda _cell: None,
    served: Callable[[], None] = lambda: None,
) -> int:
    """Serve the page until the link ends; return the exit code.

    named : called with the name of the cell. served : called once requests are being answered.
    """
    link = PageEnd(connection)
    try:
        await link.greet()
        arriving = link.news()
        task = await _first(arriving, "task")
        named(task.cell)
        page = Page(link, task)
        hearing: asyncio.Task[None] | None = None
        try:
            for kind in ("files", "summary"):
                await page.hear(LinkNews(kind, await _first(arriving, kind)))
            # listen already, because services send requests as they start
            hearing = asyncio.create_task(_hear(arriving, page), name="link")
            listening = [*link.listening]
            link.listening.clear()
            await page.start(listening)
            served()
            watching = asyncio.create_task(page.watch(), name="watch")
            try:
                await hearing
            finally:
                watching.cancel()
        finally:
            async with asyncio.timeout(CLOSE_S):
                await page.close()
            if hearing is not None:
                hearing.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await hearing
    except LinkError as error:  # the cell has gone, and logs the reason itself
        log.info("the page has stopped: %s", error)
        return 1
    except (EdgedError, OSError) as error:
        # the message says what and why; a traceback would add nothing
        log.error("the page has stopped: %s", error)  # noqa: TRY400
        return 1
    finally:
        link.close()
    return 0


async def _hear(arriving: AsyncIterator[LinkNews], page: Page) -> None:
    async for news in arriving:
        await page.hear(news)


async def _first(arriving: AsyncIterator[LinkNews], kind: str) -> Any:
    """Return the next message of a kind, ignoring others before it. Raises `LinkError`."""
    async for news in arriving:
        if news.kind == kind:
            return news.body
    raise LinkError("the cell has stopped")


def _end_with(link: socket.socket) -> None:
    """End this process soon after the link closes, as it holds the port that the next cell needs."""
    poll = select.poll()
    poll.register(link, select.POLLRDHUP)
    poll.poll()
    time.sleep(GONE_S)
    os._exit(1)


def main(arguments: Sequence[str]) -> int:
    """Run the process. arguments : level of the cell's log; socket number or path of the link."""
    level, place = arguments
    start_log = partial(set_up_logging, level=int(level))
    start_log()
    faulthandler.enable()
    try:
        link = _reached(place)
    except OSError as error:
        log.error("no cell at %s: %s", place, error.strerror or error)  # noqa: TRY400  (the message says all)
        return 1
    link.set_inheritable(False)
    link.setblocking(False)
    threading.Thread(target=_end_with, args=(link.dup(),), name="link", daemon=True).start()
    return asyncio.run(serve(link, start_log, freeze_garbage))


def _reached(place: str) -> socket.socket:
    """Return the link. place : number of an inherited socket, or path of the cell's. Raises `OSError`."""
    if is_whole(place):
        return socket.socket(fileno=whole(place))
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    deadline_s = time.monotonic() + REACH_S
    while True:
        try:
            link.connect(place)
        except OSError:  # the cell is still starting, or its previous page is still ending
            if time.monotonic() > deadline_s:
                link.close()
                raise
            time.sleep(AGAIN_S)
        else:
            return link


if __name__ == "__main__":
    code = main(sys.argv[1:])
    logging.shutdown()
    os._exit(code)  # library threads that are still drawing must not hold its port
