"""A daemon without rig and jobs whose cameras see drawn boards, and a browser session that sets it up."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from typing import Any, Self

import aiohttp

from edged.app.cell import load_any_cell
from edged.app.daemon import Daemon
from edged.app.page import Page
from edged.domain.arrays import SIDES, Image
from edged.files.statefolder import state_folder
from edged.identity.users import User, UserFile
from edged.sim.exposure import ExposureRequest
from edged.sim.inprocess import InProcessCamera
from helpers.boardpairs import SPEC, pairs
from helpers.browsersession import PASSWORD, BrowserSession, browsing
from helpers.ports import free_port
from helpers.samepage import in_this_process
from helpers.waiting import WHOLE_S
from helpers.webcell import HASH


class BoardWorld:
    """Cameras that see a drawn pair; the exposure's number is drawn in the corner so that pictures differ."""

    addresses = None
    stage = None

    def __init__(self) -> None:
        self.shown = pairs(6)[0]

    def in_process_cameras(self) -> tuple[InProcessCamera, ...]:
        """Both cameras, in the form that the daemon expects."""
        return tuple(
            InProcessCamera(side, self._exposure(index), width=640, height=480)
            for index, side in enumerate(SIDES)
        )

    def _exposure(self, index: int) -> Callable[[ExposureRequest], Image]:
        def expose(request: ExposureRequest) -> Image:
            image = self.shown[index].copy()
            image[0, :8] = [(request.frame_id >> bit & 1) * 8 + 60 for bit in range(8)]
            return image

        return expose


class BoardCell:
    """The daemon's files, its world, and requests as the page makes them. pages : served in this process."""

    def __init__(self, folder: Path) -> None:
        self.world = BoardWorld()
        self.config, self.rig = folder / "cell.toml", folder / "rig.json"
        self.state = state_folder(self.config)
        self.port = free_port()
        (folder / "jobs").mkdir()
        self.config.write_text(
            '[cell]\nname = "cell1"\nrig = "rig.json"\njobs = "jobs"\njob = "none"\n'
            '[cycle]\nmode = "command"\n[cameras]\nsource = "virtual-inprocess"\n'
            "timeout_s = 10.0\nmax_skew_ms = 1000.0\n"  # a machine that does much else
            f"[modbus]\nport = {free_port()}\n[zenoh]\nenabled = false\n"
            f'[web]\nport = {self.port}\npassword_hash = "{HASH}"\ncommissioning = true\n'
        )
        anna = User(name="Anna", role="engineer", password_hash=HASH)
        UserFile(self.state / "users.json").put(anna)
        self.pages: list[Page]
        self.session: aiohttp.ClientSession
        self.daemon: Daemon

    async def ask(self, method: str, path: str, document: Any = None) -> tuple[int, Any]:
        """Status and answer of a request below /api/v1, made as the page makes it."""
        return await BrowserSession(self.session).ask(method, f"/api/v1{path}", document)

    async def done(self, task: str) -> dict[str, Any]:
        """Wait for a task to end and return its document."""
        while True:
            _, document = await self.ask("GET", f"/tasks/{task}")
            if document["state"] != "running":
                return document
            await asyncio.sleep(0.05)

    async def until(self, path: str, condition: Callable[[Any], object]) -> Any:
        """Poll until the answer fulfils the condition, and return it."""
        async with asyncio.timeout(WHOLE_S):
            while True:
                _, document = await self.ask("GET", path)
                if condition(document):
                    return document
                await asyncio.sleep(0.05)

    def run(self, test: Callable[[Self], Awaitable[None]]) -> Self:
        """Run a test's coroutine beside the daemon, with a time limit; returns the cell."""

        async def bounded() -> None:
            async with asyncio.timeout(WHOLE_S), self.running():
                await test(self)

        asyncio.run(bounded())
        return self

    @asynccontextmanager
    async def running(self, *, page_is_here: bool = True) -> AsyncIterator[Self]:
        """The running daemon with a logged-in browser session. page_is_here : in this process, not in its
        own."""
        with in_this_process() if page_is_here else nullcontext(list[Page]()) as self.pages:
            async with self._running():
                yield self

    @asynccontextmanager
    async def _running(self) -> AsyncIterator[None]:
        loaded = load_any_cell(self.config)
        self.daemon = Daemon(self.config, loaded, world=self.world)
        task = asyncio.create_task(self.daemon.run())
        try:
            async with browsing(f"http://127.0.0.1:{self.port}") as self.session:
                browser = BrowserSession(self.session)
                await browser.log_in_once_it_listens("Anna", PASSWORD, lambda: not task.done())
                yield
        finally:
            self.daemon.stop()
            await task


async def with_views(cell: BoardCell, count: int) -> tuple[str, str]:
    """Create a draft with this many views; returns its path and the token."""
    _, entered = await cell.ask("POST", "/setup", {"name": "Anna"})
    token = {"token": entered["token"]}
    status, draft = await cell.ask(
        "POST", "/calibrations", {"boards": [SPEC], "goal_um": 5.0, "lens": "division"}
    )
    assert (201, [SPEC], []) == (status, draft["boards"], draft["views"])
    place = f"/calibrations/{draft['id']}"
    for number in range(count):
        cell.world.shown = pairs(6)[number]
        status, draft = await cell.ask("POST", f"{place}/views", token)
        assert (201, number + 1) == (status, len(draft["views"]))
    return place, entered["token"]
