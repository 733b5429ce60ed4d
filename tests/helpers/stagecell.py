"""A stage: the virtual cell to be set up, with its daemon, and a browser's session with it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path

import cv2
import numpy as np

from edged.app.cell import load_any_cell
from edged.app.daemon import Daemon
from edged.app.page import Page
from edged.commands.stage import USER, write_cell
from edged.domain.arrays import SIDES, Image
from edged.files.statefolder import state_folder
from edged.identity.users import User, UserFile
from edged.setup.stage.routes import StageRoutes
from edged.sim.world import VirtualWorld
from edged.vision.geometry.camera import StereoRig
from helpers.browsersession import PASSWORD, BrowserSession, Visitor, browsing
from helpers.cells import patient, small_rig
from helpers.ports import free_port
from helpers.samepage import in_this_process
from helpers.waiting import WHOLE_S
from helpers.webcell import HASH


class Newcomer(Visitor):
    """A user at a stage. pages : those of its daemon that run in this process."""

    def __init__(
        self, browser: BrowserSession, world: VirtualWorld, daemon: Daemon, pages: list[Page]
    ) -> None:
        super().__init__(browser)
        self.world, self.daemon, self.pages = world, daemon, pages

    async def picture(self) -> dict[str, Image]:
        """Capture a fresh pair."""
        taken = await self.ask("POST", "captures", self.token, 201)
        images = {}
        for side in SIDES:
            async with self.session.get(taken[side]) as answer:
                images[side] = cv2.imdecode(
                    np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_UNCHANGED
                )
        return images


def run(
    folder: Path,
    test: Callable[[Newcomer], Awaitable[None]],
    *,
    gige: bool = True,
    page_is_here: bool = True,
) -> None:
    """Run a test beside a running stage, with a time limit. gige : network cameras, not in-process ones."""

    async def bounded() -> None:
        async with asyncio.timeout(WHOLE_S), staged(folder, gige=gige, page_is_here=page_is_here) as newcomer:
            await test(newcomer)

    asyncio.run(bounded())


@asynccontextmanager
async def staged(
    folder: Path, *, gige: bool = True, rig: StereoRig | None = None, page_is_here: bool = True
) -> AsyncIterator[Newcomer]:
    """A running stage, and a session that has logged in and taken the cell.

    rig : if None, one with pictures of 640x480, which take a quarter of the time of the demo's.
    page_is_here : whether its page runs in this process, and is one of the newcomer's pages.
    """
    ports = free_port(), free_port(), free_port()
    with (
        in_this_process() if page_is_here else nullcontext(list[Page]()) as pages,
        VirtualWorld(gige=gige, rig=rig or small_rig(), staged=True) as world,
    ):
        assert world.stage is not None
        path = write_cell(folder, PASSWORD, ports=ports, period_s=0.2, gige=gige)
        path.write_text(patient(path.read_text()))
        UserFile(state_folder(path) / "users.json").put(User(name=USER, role="engineer", password_hash=HASH))
        routes = StageRoutes(world.stage)
        loaded = load_any_cell(path)
        daemon = Daemon(path, loaded, observers=[routes], world=world, routes=[routes, routes.robot])
        running = asyncio.create_task(daemon.run())
        try:
            async with browsing(f"http://127.0.0.1:{ports[0]}") as session:
                newcomer = Newcomer(BrowserSession(session), world, daemon, pages)
                await newcomer.browser.log_in_once_it_listens(USER, PASSWORD, lambda: not running.done())
                await newcomer.take()
                yield newcomer
        finally:
            daemon.stop()
            await running
