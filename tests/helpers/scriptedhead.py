"""A stereo head controlled by the test, jobs for it, and a publisher that records the cycle's events."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import numpy as np

from edged.cell.cycle import Cycle
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Command, CommandFailed, CommandKind, Event, JobChanged, Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Outcome, Status
from edged.errors import FrameTimeout
from edged.ports import Publisher
from helpers.waiting import LIMIT_S


class Head:
    """A stereo head in memory; `broken` makes every capture fail."""

    def __init__(self) -> None:
        self.captures = 0
        self.closed = 0
        self.broken = False
        self.capture_s = 0.0
        self.exposures: asyncio.Queue[FramePair] = asyncio.Queue()

    async def open(self) -> None:
        if self.broken:
            raise FrameTimeout("left", "unplugged")

    async def capture(self) -> FramePair:
        await asyncio.sleep(self.capture_s)
        if self.broken:
            raise FrameTimeout("left", "unplugged")
        self.captures += 1
        image = np.zeros((4, 4), np.uint8)
        now_ns = time.time_ns()
        left, right = (Frame(side, self.captures, image, now_ns, now_ns) for side in ("left", "right"))
        return FramePair(left, right)

    async def listen(self) -> FramePair:
        return await self.exposures.get()

    async def close(self) -> None:
        self.closed += 1


class Ear:
    """A publisher that records all events."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    async def start(self) -> None:
        pass

    def announce(self, event: Event) -> None:
        self.events.append(event)

    async def close(self) -> None:
        pass

    def snapshots(self) -> list[Snapshot]:
        return [event for event in self.events if isinstance(event, Snapshot)]

    def state(self) -> CellPhase | None:
        """The latest state announced."""
        return next((event.state for event in reversed(self.events) if isinstance(event, CellState)), None)

    def answers(self, command: Command) -> list[Event]:
        kinds = (Snapshot, JobChanged, CommandFailed)
        return [event for event in self.events if isinstance(event, kinds) and event.command == command]


def found_nothing(pair: FramePair, lap: Callable[[str], None]) -> Outcome:
    """A pipeline that never finds anything."""
    lap("find")
    return Outcome(Status.NO_TARGET)


def make_setup(
    period_s: float | None = None, locate=found_nothing, numbers: tuple[int, ...] = (1, 2)
) -> Setup:
    """Jobs "job1", "job2", ... with the given pipeline."""
    jobs = {number: LoadedJob(f"job{number}", number, locate) for number in numbers}
    return Setup(jobs, numbers[0], period_s, "cal", "f00d", simulated=False, robot_from_rig=None)


def locate_command(sequence: int, job: int = 0) -> Command:
    """A LOCATE command."""
    return Command(CommandKind.LOCATE, "test", sequence, job)


def held() -> tuple[threading.Event, Callable[[FramePair, Callable[[str], None]], Outcome]]:
    """A measurement that finds nothing and ends only after the event is set."""
    release = threading.Event()

    def slow(pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        release.wait(LIMIT_S)
        return Outcome(Status.NO_TARGET)

    return release, slow


@asynccontextmanager
async def running(cycle: Cycle, *publishers: Publisher) -> AsyncIterator[None]:
    """Run the cycle with these publishers within the context."""
    cycle.set_publishers(publishers)
    task = asyncio.create_task(cycle.run())
    try:
        yield
    finally:
        cycle.stop()
        await asyncio.wait_for(task, LIMIT_S)
