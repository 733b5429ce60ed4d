"""A cell in memory with its page, and a browser that speaks /api/v1."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import aiohttp
import pytest
from scriptedhead import Ear, Head, make_setup

from edged.adapters.web import Sources, WebPublisher, WebSettings
from edged.cycle import Cycle
from edged.passwords import hash_password
from edged.robot.orientations import Convention

PASSWORD = "correct horse"
HASH = hash_password(PASSWORD)


class Cell:
    """A cycle with its page, and a browser."""

    def __init__(
        self, cycle: Cycle, web: WebPublisher, head: Head, ear: Ear, session: aiohttp.ClientSession
    ) -> None:
        self.web = web
        self.cycle, self.head, self.ear, self.session = cycle, head, ear, session
        self.origin = str(session._base_url).rstrip("/")  # noqa: SLF001  (what the browser would send)

    async def ask(self, method: str, path: str, document: Any, **headers: str) -> tuple[int, Any]:
        """Status and answer, as the page asks."""
        sent = {"Origin": self.origin, **headers}
        async with self.session.request(method, path, json=document, headers=sent) as answer:
            return answer.status, await answer.json() if answer.content_type.endswith("json") else None

    async def log_in(self) -> None:
        """With the form."""
        async with self.session.post("/login", data={"password": PASSWORD}, allow_redirects=False) as answer:
            assert "/" == answer.headers["Location"]


def run(test: Callable[[Cell], Awaitable[None]], *, commissioning: bool = True) -> Ear:
    """A test's coroutine beside a running cell, bounded."""
    ear = Ear()

    async def bounded() -> None:
        async with asyncio.timeout(30), running(ear, commissioning) as cell:
            await test(cell)

    asyncio.run(bounded())
    return ear


@asynccontextmanager
async def running(ear: Ear, commissioning: bool) -> AsyncIterator[Cell]:
    """A cell with a head in memory, its page on a free port, and a browser's session with it."""
    head = Head()
    cycle = Cycle(head, make_setup())
    sources = Sources(
        rectification=lambda: pytest.fail("no cycle has made a picture"),
        jobs=list,
        facts=dict,
        registers=list,
        metrics=bytes,
        convention=lambda: Convention.FIXED_XYZ,
    )
    settings = WebSettings(port=0, password_hash=HASH, commissioning=commissioning)
    web = WebPublisher("cell1", settings, sources, commissioner=cycle)
    await web.start()
    cycle.set_publishers([ear, web])
    task = asyncio.create_task(cycle.run())
    try:
        jar = aiohttp.CookieJar(unsafe=True)  # cookies of an IP address
        async with aiohttp.ClientSession(f"http://127.0.0.1:{web.port}", cookie_jar=jar) as session:
            yield Cell(cycle, web, head, ear, session)
    finally:
        cycle.stop()
        await task
        await web.close()
