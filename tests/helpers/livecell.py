"""A cell in a thread: the real loop, handshake and Modbus server; cameras and vision are made up."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import replace
from types import TracebackType
from typing import Any, TypeVar

import numpy as np

from edged.adapters.modbus import ModbusPublisher, ModbusSettings
from edged.cell.cycle import Cycle, GoldenKeeper
from edged.cell.loaded import LoadedJob, Setup
from edged.cell.registering import Registrar
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Outcome, Status, Target
from edged.domain.picking import Grasp, Picking
from edged.errors import FrameTimeout
from edged.ports import Publisher
from helpers.snapshots import make_target, make_transform
from helpers.waiting import LIMIT_S

T = TypeVar("T")
Beside = TypeVar("Beside", bound=Publisher)
PART_FROM_TCP = make_transform((0.4, 0.0, -1.0), (30.0, -10.0, 5.0))
GRASPS = Picking(grasps=(Grasp("rim", PART_FROM_TCP, PART_FROM_TCP, 50.0, 80.0),))
"""A single grasp for the part of `make_target`."""


class Head:
    """A stereo head in memory; `broken` makes every capture fail."""

    def __init__(self) -> None:
        self.broken = False
        self.captures = 0

    async def open(self) -> None:
        self._check()

    async def capture(self) -> FramePair:
        await asyncio.sleep(0.005)
        self._check()
        self.captures += 1
        image = np.zeros((4, 4), np.uint8)
        left, right = (
            Frame(side, self.captures, image, time.time_ns(), time.time_ns()) for side in ("left", "right")
        )
        return FramePair(left, right)

    async def close(self) -> None:
        pass

    def _check(self) -> None:
        if self.broken:
            raise FrameTimeout("left", "unplugged")


class LiveCell:
    """A cell with two jobs, as a context; captures give `targets` after `slow_s`, once `may_end` is set."""

    def __init__(self, settings: ModbusSettings | None = None, period_s: float | None = None) -> None:
        self.settings = settings or ModbusSettings(port=0, validity_s=30.0)
        self.head = Head()
        self.targets: tuple[Target, ...] = (make_target(),)
        self.slow_s = 0.0
        self.registrar: Registrar | None = None
        self.keeper: GoldenKeeper | None = None
        self.may_end = threading.Event()
        self.may_end.set()
        jobs = {number: LoadedJob(f"job{number}", number, self._locate) for number in (1, 2)}
        self.setup = Setup(jobs, 1, period_s, "cal", "f00d", simulated=False, robot_from_rig=np.eye(4))
        self._started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    def pick(self, picking: Picking) -> LiveCell:
        """Set the picking of all jobs, before the cell starts."""
        jobs = {number: replace(job, picking=picking) for number, job in self.setup.jobs.items()}
        self.setup = replace(self.setup, jobs=jobs)
        return self

    def __enter__(self) -> LiveCell:
        self._thread.start()
        assert self._started.wait(LIMIT_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.call(self.cycle.stop)
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()

    @property
    def port(self) -> int:
        """TCP port of the server."""
        return self.server.port

    def call(self, work: Callable[[], T]) -> T:
        """Call a function on the cell's event loop."""

        async def run() -> T:
            return work()

        return self.run(run())

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Await a coroutine on the cell's event loop."""
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(LIMIT_S)

    @contextlib.contextmanager
    def publishing(self, make: Callable[[], Beside]) -> Iterator[Beside]:
        """Serve the running cell by one more publisher within the context. make : called on the loop."""

        async def start() -> Beside:
            publisher = make()
            await publisher.start()
            self.cycle.set_publishers([self.server, publisher])
            return publisher

        publisher = self.run(start())
        try:
            yield publisher
        finally:
            self.call(lambda: self.cycle.set_publishers([self.server]))
            self.run(publisher.close())

    def reload(self, **changes: object) -> None:
        """Reload with these setup fields changed; returns once the change is in force."""
        self.setup = replace(self.setup, **changes)
        self.call(lambda: self.cycle.exchange(self.setup))
        cell = vars(self.cycle)["_cell"]
        while cell.setup is not self.setup:
            time.sleep(0.001)

    def _locate(self, _pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        time.sleep(self.slow_s)
        assert self.may_end.wait(LIMIT_S)
        lap("find")
        return Outcome(Status.OK if self.targets else Status.NO_TARGET, self.targets)

    async def _run(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.cycle = Cycle(self.head, self.setup, registrar=self.registrar, keeper=self.keeper)
        jobs = [(job.number, job.name) for job in self.setup.jobs.values()]
        self.server = ModbusPublisher(self.settings, self.cycle, jobs=lambda: jobs)
        await self.server.start()
        try:
            self.cycle.set_publishers([self.server])
            self.loop.call_soon(self._started.set)
            await self.cycle.run()
        finally:
            await self.server.close()
