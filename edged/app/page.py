"""The page's process: HTTP, people, set-up, drafts, audit, manual and the worker, for the cell at the link.

`python -m edged.app.page LEVEL LINK` with the level of the log, and the number of an inherited socket where
the cell starts it, or the path of the cell's socket where it is a service (`edged.app.pagesource`).
"""

from __future__ import annotations

import gc

if __name__ == "__main__":
    gc.disable()  # until all is imported, which leaves no garbage: a tenth of the start was searches for it

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
from edged.app.garbage import keep_what_is_loaded
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
"""A cell that says nothing for so long hangs: it says something every second (`link.cellend.BEAT_S`)."""
REACH_S, AGAIN_S = 10.0, 0.2
"""A service without a cell tries for so long, so often, before it ends and is started again."""
GONE_S = 1.0
"""A page that has not ended by itself so long after its cell is cut off."""


class Page:
    """The page of one cell, from the first that the link tells to its end."""

    def __init__(self, link: PageEnd, task: PageTask) -> None:
        self._link = link
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
        """Serve; files and summary have come. Raises `EdgedError`."""
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
                from edged.setup.stage.forwarding import ForwardedStage  # with the simulation

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
        """Say so when the cell says nothing, and take it back when it does again."""
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
        """Take note of what the cell tells."""
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
        """Now, or once the page serves."""
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
        """Leave nothing behind."""
        if self._web is not None:
            await self._web.close()
        if self._live is not None:
            await self._live.close()
        if self.setup is not None:
            await self.setup.close()


def tell_of(step: ProgramStep, program: RobotProgram) -> None:
    """A step of a robot's registration becomes part of its draft; one whose pictures are lost does not."""
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
    """Serve the page until the link ends; returns the exit code.

    named : called with the name of the cell. served : called once requests are answered.
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
            # services ask as they start
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
    except LinkError as error:  # the cell has gone, and has its own words for it
        log.info("the page has stopped: %s", error)
        return 1
    except (EdgedError, OSError) as error:
        # the message says what and why: a traceback says no more
        log.error("the page has stopped: %s", error)  # noqa: TRY400
        return 1
    finally:
        link.close()
    return 0


async def _hear(arriving: AsyncIterator[LinkNews], page: Page) -> None:
    async for news in arriving:
        await page.hear(news)


async def _first(arriving: AsyncIterator[LinkNews], kind: str) -> Any:
    """The next of a kind, before which nothing else counts. Raises `LinkError`."""
    async for news in arriving:
        if news.kind == kind:
            return news.body
    raise LinkError("the cell has stopped")


def _end_with(link: socket.socket) -> None:
    """End this process soon after the link, whatever it does: it holds the port that the next cell needs."""
    poll = select.poll()
    poll.register(link, select.POLLRDHUP)
    poll.poll()
    time.sleep(GONE_S)
    os._exit(1)


def main(arguments: Sequence[str]) -> int:
    """Run the process. arguments : level of the cell's log, descriptors of the link and of what listens."""
    level, place = arguments
    start_log = partial(set_up_logging, level=int(level))
    start_log()
    faulthandler.enable()
    try:
        link = _reached(place)
    except OSError as error:
        log.error("no cell at %s: %s", place, error.strerror or error)  # noqa: TRY400  (it says all)
        return 1
    link.set_inheritable(False)
    link.setblocking(False)
    threading.Thread(target=_end_with, args=(link.dup(),), name="link", daemon=True).start()
    return asyncio.run(serve(link, start_log, keep_what_is_loaded))


def _reached(place: str) -> socket.socket:
    """The link by an inherited socket's number, or by the path of the cell's socket. Raises `OSError`."""
    if is_whole(place):
        return socket.socket(fileno=whole(place))
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    deadline_s = time.monotonic() + REACH_S
    while True:
        try:
            link.connect(place)
        except OSError:  # the cell is just being started, or another page of it is just ending
            if time.monotonic() > deadline_s:
                link.close()
                raise
            time.sleep(AGAIN_S)
        else:
            return link


if __name__ == "__main__":
    code = main(sys.argv[1:])
    logging.shutdown()
    os._exit(code)  # threads of a library that still draw must not keep its port
