"""Taking the cell over HTTP: who may, from where, and what it does to the cell."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest
from scriptedhead import Ear, Head, make_setup, until

from edged.adapters.web import Sources, WebPublisher, WebSettings
from edged.cycle import Cycle
from edged.domain.cell import CellPhase
from edged.passwords import hash_password
from edged.robot.orientations import Convention

PASSWORD = "correct horse"
HASH = hash_password(PASSWORD)
CHANGING = (
    ("POST", "/api/v1/setup", {"name": "Anna"}),
    ("PUT", "/api/v1/setup/lease", {"token": "x"}),
    ("DELETE", "/api/v1/setup", {"name": "Anna"}),
    ("POST", "/api/v1/captures", {"token": "x"}),
)


class Cell:
    """A cycle with its page, and a browser."""

    def __init__(self, cycle: Cycle, head: Head, ear: Ear, session: aiohttp.ClientSession) -> None:
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
            yield Cell(cycle, head, ear, session)
    finally:
        cycle.stop()
        await task
        await web.close()


def test_somebody_takes_the_cell_looks_and_gives_it_back() -> None:
    """The state changes before the answer; pictures are what the cameras gave, to the last grey value."""

    async def test(cell: Cell) -> None:
        await cell.log_in()
        status, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        assert (201, CellPhase.SETUP) == (status, cell.ear.state())
        async with cell.session.get("/ready") as answer:
            assert (503, "setup by Anna") == (answer.status, (await answer.json())["error"])
        token = {"token": entered["token"]}
        assert (204, None) == await cell.ask("PUT", "/api/v1/setup/lease", token)
        status, taken = await cell.ask("POST", "/api/v1/captures", token)
        assert 201 == status
        for side in ("left", "right"):
            async with cell.session.get(taken[side]) as answer:
                image = cv2.imdecode(np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_UNCHANGED)
                assert np.array_equal(np.zeros((4, 4), np.uint8), image)
        assert (204, None) == await cell.ask("DELETE", "/api/v1/setup", token)
        await until(lambda: cell.ear.state() is CellPhase.READY)

    assert [] == run(test).snapshots()


def test_two_people_are_told_of_each_other() -> None:
    """The second is refused with the first one's name, may take over, and the first one's token ends."""

    async def test(cell: Cell) -> None:
        await cell.log_in()
        _, first = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        status, refused = await cell.ask("POST", "/api/v1/setup", {"name": "Ben"})
        assert (409, "setup_refused", "Anna has the cell") == (status, refused["code"], refused["detail"])
        status, second = await cell.ask("POST", "/api/v1/setup", {"name": "Ben", "take_over": True})
        assert 201 == status
        status, refused = await cell.ask("POST", "/api/v1/captures", {"token": first["token"]})
        assert (409, "Ben has the cell") == (status, refused["detail"])
        status, _ = await cell.ask("POST", "/api/v1/captures", {"token": second["token"]})
        assert 201 == status
        assert (204, None) == await cell.ask("DELETE", "/api/v1/setup", {"name": "Carl"})
        await until(lambda: cell.ear.state() is CellPhase.READY)

    run(test)


def test_a_dead_camera_and_an_old_picture_are_problems_with_a_code() -> None:
    """Of RFC 9457: what a program needs, and a sentence."""

    async def test(cell: Cell) -> None:
        await cell.log_in()
        _, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        for _ in range(5):
            _, taken = await cell.ask("POST", "/api/v1/captures", entered)
        for number, expected in (("1", 404), ("5", 200)):
            async with cell.session.get(taken["left"].replace("/5/", f"/{number}/")) as answer:
                assert expected == answer.status
        cell.head.broken = True
        status, problem = await cell.ask("POST", "/api/v1/captures", entered)
        assert (503, "camera_104") == (status, problem["code"])
        assert "unplugged" in problem["detail"]

    run(test)


@pytest.mark.parametrize("method, path, document", CHANGING)
def test_nobody_changes_the_cell_but_from_the_page(method: str, path: str, document: dict[str, str]) -> None:
    """Not without logging in, not with the password of a scraper, not from another page or from none."""

    async def test(cell: Cell) -> None:
        async with cell.session.request(method, path, json=document) as answer:
            assert 401 == answer.status
        basic = "Basic " + base64.b64encode(f"edged:{PASSWORD}".encode()).decode()
        status, problem = await cell.ask(method, path, document, Authorization=basic)
        assert (403, "log_in") == (status, problem["code"])
        await cell.log_in()
        for origin in ("http://evil.example", "null", cell.origin.replace("http", "https"), ""):
            status, problem = await cell.ask(method, path, document, Origin=origin)
            assert (403, "origin") == (status, problem["code"])
        sent = {"Origin": cell.origin}
        async with cell.session.request(method, path, json=document) as answer:
            assert (403, "origin") == (answer.status, (await answer.json())["code"])
        async with cell.session.request(method, path, data=document, headers=sent) as answer:
            assert 415 == answer.status

    ear = run(test)
    assert CellPhase.SETUP not in {event.state for event in ear.events if hasattr(event, "setup_by")}


@pytest.mark.parametrize("method, path, document", CHANGING)
def test_without_the_switch_there_is_no_such_route(method: str, path: str, document: dict[str, str]) -> None:
    """A page that only shows has nothing that changes the cell."""

    async def test(cell: Cell) -> None:
        await cell.log_in()
        assert 404 == (await cell.ask(method, path, document))[0]

    run(test, commissioning=False)


@pytest.mark.parametrize(
    "body, status, code",
    [
        (b"{", 400, "json"),
        (b"[]", 400, "json"),
        (b"[" * 4000, 400, "json"),
        (b"\xff", 400, "json"),
        (b"{}", 400, "name"),
        (b'{"name": ""}', 400, "name"),
        (b'{"name": "  "}', 400, "name"),
        (b'{"name": 7}', 400, "name"),
        (b'{"name": "a\\nb"}', 400, "name"),
        (b'{"name": "' + b"a" * 65 + b'"}', 400, "name"),
        (b'{"name": "' + b"a" * 5000 + b'"}', 413, None),
    ],
)
def test_what_is_no_request_is_said(body: bytes, status: int, code: str | None) -> None:
    """By its place; and it takes no cell."""

    async def test(cell: Cell) -> None:
        await cell.log_in()
        headers = {"Origin": cell.origin, "Content-Type": "application/json"}
        async with cell.session.post("/api/v1/setup", data=body, headers=headers) as answer:
            assert status == answer.status
            if code is not None:
                assert "application/problem+json" == answer.content_type
                assert code == (await answer.json())["code"]
        assert CellPhase.SETUP is not cell.ear.state()

    run(test)


def test_the_plant_that_runs_is_named() -> None:
    """409 with AUTO_LOCK, and READY stays."""

    async def test(cell: Cell) -> None:
        await cell.log_in()
        cell.cycle.lock_setup(True)
        status, problem = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        assert 409 == status
        assert "AUTO_LOCK" in problem["detail"]
        await until(lambda: cell.ear.state() is CellPhase.READY)

    run(test)
