"""A stage: the virtual cell that is to be set up, beside its daemon, and a browser's session with it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import cv2
import numpy as np

from edged.app.cell import load_any_cell
from edged.app.daemon import Daemon
from edged.app.stage import StageRoutes
from edged.commands.stage import USER, write_cell
from edged.domain.arrays import SIDES, Image
from edged.sim.world import VirtualWorld

PASSWORD = "correct horse"


def free_port() -> int:
    """A TCP port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Newcomer:
    """A browser's session with a stage."""

    def __init__(
        self, world: VirtualWorld, session: aiohttp.ClientSession, port: int, daemon: Daemon
    ) -> None:
        self.world, self.session, self.daemon = world, session, daemon
        self.origin = f"http://127.0.0.1:{port}"
        self.token: dict[str, str] = {}

    async def ask(self, method: str, path: str, document: Any = None, expected: int = 200) -> Any:
        """The answer, as the page gets it."""
        headers = {"Origin": self.origin}
        async with self.session.request(method, f"/api/v1/{path}", json=document, headers=headers) as answer:
            body = await answer.json() if answer.content_type.endswith("json") else None
            assert expected == answer.status, body
            return body

    async def take(self) -> None:
        """Log in and take the cell."""
        async with self.session.post(
            "/login", data={"name": USER, "password": PASSWORD}, allow_redirects=False
        ) as answer:
            assert "Location" in answer.headers
        self.token = await self.ask("POST", "setup", {"name": "Anna"}, 201)

    async def picture(self) -> dict[str, Image]:
        """A fresh pair."""
        taken = await self.ask("POST", "captures", self.token, 201)
        images = {}
        for side in SIDES:
            async with self.session.get(taken[side]) as answer:
                images[side] = cv2.imdecode(
                    np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_UNCHANGED
                )
        return images


def run(folder: Path, test: Callable[[Newcomer], Awaitable[None]], *, gige: bool = True) -> None:
    """A test beside a running stage, bounded. gige : cameras on the network, not inside the process."""

    async def bounded() -> None:
        async with asyncio.timeout(60), staged(folder, gige=gige) as newcomer:
            await test(newcomer)

    asyncio.run(bounded())


@asynccontextmanager
async def staged(folder: Path, *, gige: bool = True) -> AsyncIterator[Newcomer]:
    """A running stage, and a session that has logged in and taken the cell."""
    ports = free_port(), free_port(), free_port()
    with VirtualWorld(gige=gige, staged=True) as world:
        assert world.stage is not None
        path = write_cell(folder, PASSWORD, ports=ports, period_s=0.2, gige=gige)
        routes = StageRoutes(world.stage)
        loaded = load_any_cell(path)
        daemon = Daemon(path, loaded, observers=[routes], world=world, rooms=[routes.add_to])
        running = asyncio.create_task(daemon.run())
        try:
            jar = aiohttp.CookieJar(unsafe=True)  # cookies of an IP address
            base = f"http://127.0.0.1:{ports[0]}"
            async with aiohttp.ClientSession(base, cookie_jar=jar) as session:
                newcomer = Newcomer(world, session, ports[0], daemon)
                while True:
                    try:
                        await newcomer.take()
                        break
                    except aiohttp.ClientConnectorError:
                        assert not running.done()
                        await asyncio.sleep(0.02)
                yield newcomer
        finally:
            daemon.stop()
            await running
