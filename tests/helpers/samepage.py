"""The page in the process of its cell, over a real link: for tests that reach into its services."""

from __future__ import annotations

import asyncio
import socket

import pytest

from edged.app import daemon
from edged.app import page as page_process
from edged.app.page import Page
from edged.app.pageserver import PageServer
from edged.link.cellend import CellEnd
from edged.link.pageend import PageEnd
from edged.link.summary import PageTask
from edged.setup.jobs.worker import Worker


class SamePage(PageServer):
    """A page whose process is a task. pages : all that were made, for what tests look at."""

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


def worker_of(pages: list[Page]) -> Worker:
    """The worker of the page that was made last: nobody else knows its process, nor what it can do."""
    setup = pages[-1].setup
    assert setup is not None
    return setup.cell.worker


def in_this_process(monkeypatch: pytest.MonkeyPatch) -> list[Page]:
    """Let daemons of this process have such pages; returns the list that they come to."""
    pages: list[Page] = []

    def made(link: PageEnd, task: PageTask) -> Page:
        pages.append(Page(link, task))
        return pages[-1]

    monkeypatch.setattr(page_process, "Page", made)
    monkeypatch.setattr(daemon, "PageServer", SamePage)
    return pages
