"""Mirrors a registration by the robot's own program into a draft for the pages; the program never waits."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

import numpy as np

from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import FloatArray
from edged.domain.frames import FramePair
from edged.errors import EdgedError
from edged.robot.orientations import pose_of
from edged.setup.inuse import CellInUse
from edged.setup.registration.model import Kind, Mount
from edged.setup.registration.service import Given, Registrations

log = logging.getLogger(__name__)

MOST_WAITING = 20
"""Steps in the queue; while it is full, new ones are dropped, but for one that begins a registration."""


class RobotProgram:
    """`RegistrationListener` of a robot program: called from any thread, never blocks, writes to a draft."""

    def __init__(self, registrations: Registrations, cell: CellInUse) -> None:
        self._registrations = registrations
        self._cell = cell
        self._loop = asyncio.get_running_loop()
        self._heard: asyncio.Queue[Callable[[], Awaitable[None]]] = asyncio.Queue()
        self._draft: str | None = None
        self._writing = asyncio.create_task(self._write(), name="robot's program")

    async def close(self) -> None:
        """Stop writing; steps still in the queue are dropped."""
        await cancel_and_await(self._writing)

    def begun(self, mount: Mount, kind: Kind, board: str, limit_mm: float) -> None:
        """The program has begun a registration: begin a new draft."""

        async def work() -> None:
            self._draft = None
            self._draft = await self._registrations.adopt(mount, kind, self._cell.brand, board, limit_mm)

        self._tell(work, begins=True)

    def posed(self, pair: FramePair, robot_from_flange: FloatArray) -> None:
        """The program has added a pose of the flange."""

        async def work() -> None:
            if self._draft is not None:
                await self._registrations.adopt_pose(self._draft, pair, self._shown(robot_from_flange))

        self._tell(work)

    def touched(self, pair: FramePair, job: str, rig_mm: FloatArray, robot_from_tip: FloatArray) -> None:
        """The program has added a point: the reference point of a job's part."""

        async def work() -> None:
            if self._draft is not None:
                shown = self._shown(robot_from_tip)
                await self._registrations.adopt_point(self._draft, pair, job, np.asarray(rig_mm), shown)

        self._tell(work)

    def activated(self) -> None:
        """The cell now uses the rig that the program has registered."""

        async def work() -> None:
            if self._draft is not None:
                await self._registrations.adopt_solved(self._draft)

        self._tell(work)

    def _shown(self, pose: FloatArray) -> Given:
        return Given(pose_of(self._cell.brand, pose))

    def _tell(self, work: Callable[[], Awaitable[None]], *, begins: bool = False) -> None:
        self._loop.call_soon_threadsafe(self._put, work, begins)

    def _put(self, work: Callable[[], Awaitable[None]], begins: bool) -> None:
        if begins and self._heard.qsize() >= MOST_WAITING:
            while not self._heard.empty():  # else the new registration's steps would go to the former draft
                self._heard.get_nowait()
        if self._heard.qsize() < MOST_WAITING:
            self._heard.put_nowait(work)

    async def _write(self) -> None:
        while True:
            work = await self._heard.get()
            try:
                await work()
            except (EdgedError, OSError, KeyError) as error:
                log.warning("what the robot's program registers is not shown: %s", error)
