"""One cycle up to its snapshot: one job or all of them, the drift, what a robot gets, and the times."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field

from edged.cell.drift import DriftMonitor, refused
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.cell import Calibrated
from edged.domain.events import Command, Snapshot
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Status
from edged.errors import CaptureError
from edged.robot.picking import picked

log = logging.getLogger("edged.cell.cycle")
"""The loop's: whoever searches the journal for it finds these lines, too."""

TRY_ALL_S = 3.0
"""A command that tries every job begins with no further one after so long."""


class _Stopwatch:
    """Collects stage times; called at the end of each stage."""

    def __init__(self) -> None:
        self._start_s = self._last_s = time.perf_counter()
        self._stages: dict[str, float] = {}

    def __call__(self, stage: str) -> None:
        now_s = time.perf_counter()
        self._stages[stage] = self._stages.get(stage, 0.0) + (now_s - self._last_s) * 1e3
        self._last_s = now_s

    def timing_ms(self) -> dict[str, float]:
        return {**self._stages, "total": (time.perf_counter() - self._start_s) * 1e3}


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A cycle that runs; exactly one of `failed`, `grabbed` and `located` ends it.

    basis : the number of what `setup` is. command : None for a tick. drift : sees every part that is located.
    vision : where jobs are tried.
    lap : called at the end of each stage.
    """

    number: int
    basis: int
    setup: Setup
    active: LoadedJob
    command: Command | None
    drift: DriftMonitor
    vision: Executor
    utc_ns: Callable[[], int]
    lap: _Stopwatch = field(default_factory=_Stopwatch, init=False)

    def failed(self, error: CaptureError) -> Snapshot:
        """There is no exposure."""
        return self._snapshot(self._job, Status.CAPTURE_FAULT, error=error)

    def grabbed(self, pair: FramePair) -> Snapshot:
        """Only the images were wanted."""
        return self._snapshot(self._job, Status.NO_TARGET, pair=pair)

    async def located(self, pair: FramePair) -> Snapshot:
        """What the job finds, or the best of all jobs. A bug in the pipeline propagates."""
        if self.command is not None and self.command.tries_all:
            job, outcome = await self._best(pair)
        else:
            job, outcome = self._job, await self._located(self._job, pair)
        outcome = self._watched(job, outcome)
        return self._snapshot(job, outcome.status, pair=pair, outcome=outcome)

    @property
    def _job(self) -> LoadedJob:
        """The one that the command names, else the active one."""
        named = self.command is not None and self.command.job
        return self.setup.jobs[named] if named else self.active

    async def _located(self, job: LoadedJob, pair: FramePair) -> Outcome:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.vision, job.locate, pair, self.lap)

    async def _best(self, pair: FramePair) -> tuple[LoadedJob, Outcome]:
        """Every job on one exposure, the active one first, the others by number, as far as the time goes.

        The good part that agrees best counts; without any the bad one that does, or that nothing was found.
        """
        frame, _ = self.setup.frame(self.command)
        others = [job for _, job in sorted(self.setup.jobs.items()) if job is not self.active]
        end_s = time.monotonic() + TRY_ALL_S
        tried: list[tuple[LoadedJob, Outcome]] = []
        for job in (self.active, *others):
            if not tried or time.monotonic() < end_s:
                tried.append((job, await self._located(job, pair)))
        if len(tried) <= len(others):
            log.warning("%d of %d jobs were tried within %g s", len(tried), 1 + len(others), TRY_ALL_S)

        def agreement(one: tuple[LoadedJob, Outcome]) -> tuple[bool, float]:
            job, outcome = one
            allowed = picked(outcome, self.setup.picking(job, self.command), frame)
            return allowed.status is Status.OK, max((t.match.score for t in allowed.targets), default=-1.0)

        return max(tried, key=agreement)

    def _watched(self, job: LoadedJob, outcome: Outcome) -> Outcome:
        """The outcome with good results refused while the calibration is known to be wrong."""
        for target in outcome.targets:
            self.drift.add(target, job.witness)
        return refused(outcome) if self.drift.state().verdict is Calibrated.INVALID else outcome

    def _snapshot(
        self,
        job: LoadedJob,
        status: Status,
        *,
        pair: FramePair | None = None,
        outcome: Outcome | None = None,
        error: CaptureError | None = None,
    ) -> Snapshot:
        frame, registration = self.setup.frame(self.command)
        if outcome is not None:
            outcome = picked(outcome, self.setup.picking(job, self.command), frame)
            status = outcome.status
        return Snapshot(
            cycle=self.number,
            status=status,
            command=self.command,
            job=job.name,
            job_number=job.number,
            calibration_id=self.setup.calibration_id,
            fingerprint=self.setup.fingerprint,
            simulated=self.setup.simulated,
            exposed_ns=pair.exposed_ns if pair is not None else 0,
            exposed_bound_ns=pair.exposed_bound_ns if pair is not None else None,
            published_ns=self.utc_ns(),
            targets=outcome.targets if outcome is not None else (),
            dismissed=outcome.dismissed if outcome is not None else (),
            nearest=outcome.nearest if outcome is not None else None,
            timing_ms=self.lap.timing_ms(),
            error=str(error) if error is not None else "",
            error_code=error.code if error is not None else 0,
            robot_from_rig=frame.robot_from_rig,
            registration_covariance=registration,
            drift=self.drift.state(),
            basis=self.basis,
        )
