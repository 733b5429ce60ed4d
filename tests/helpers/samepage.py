"""The page in the process of its cell, over a real link."""

from __future__ import annotations

import asyncio
import atexit
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from subprocess import Popen
from typing import ClassVar

import pytest

from edged.app import daemon
from edged.app import page as page_process
from edged.app import setup as setup_of_pages
from edged.app.page import Page
from edged.app.pageserver import PageServer
from edged.link.cellend import CellEnd
from edged.link.pageend import PageEnd
from edged.link.summary import PageTask
from edged.setup.jobs.worker import Worker


class SamePage(PageServer):
    """A page server whose page runs as a task. pages : all pages made, for tests to inspect."""

    pages: list[Page]

    async def _run(self) -> None:
        ours, theirs = socket.socketpair()
        end = self._end = CellEnd(ours, self._view, self._listening)
        for event in (self._state, self._exposed, self._snapshot):
            if event is not None:
                end.announce(event)
        serving = asyncio.create_task(page_process.serve(theirs))
        try:
            await end.serve()
        finally:
            self._end = None
            await serving


class PassedOn(Worker):
    """A worker that passes its idle process on to the next page: a start takes longer than most tasks."""

    idle: ClassVar[list[tuple[Popen[bytes], Connection]]] = []

    def _start(self) -> Connection:
        while self.idle:
            self._process, connection = self.idle.pop()
            if self._process.poll() is None:
                self._connection = connection
                return connection
            connection.close()
        return super()._start()

    async def close(self) -> None:
        """Keep the process for the next page, unless it is busy."""
        process, connection = self._process, self._connection
        if process is not None and connection is not None and not self.is_busy and process.poll() is None:
            self.idle.append((process, connection))
            self._process = self._connection = None
        await super().close()


@atexit.register
def end_idle_workers() -> None:
    """End the kept processes when the tests end."""
    for process, connection in PassedOn.idle:
        connection.close()
        process.kill()
        process.wait()


def worker_of(pages: list[Page]) -> Worker:
    """The worker of the most recent page."""
    setup = pages[-1].setup
    assert setup is not None
    return setup.cell.worker


@contextmanager
def in_this_process() -> Iterator[list[Page]]:
    """Make daemons in this context run their pages in this process; yields the list that collects the pages.

    For tests that do not depend on the page's process, which takes longer to start than most tests run.
    """
    pages: list[Page] = []

    def made(link: PageEnd, task: PageTask) -> Page:
        pages.append(Page(link, task))
        return pages[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page_process, "Page", made)
        patch.setattr(daemon, "PageServer", SamePage)
        patch.setattr(setup_of_pages, "Worker", PassedOn)
        yield pages
