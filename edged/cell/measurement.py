"""One cycle up to its snapshot: one job or all jobs, drift, picking limits and stage times."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from edged.cell.announcements import log
from edged.cell.context import CellContext
from edged.cell.drift import refused
from edged.cell.loaded import LoadedJob
from edged.domain.belt import BeltMoment
from edged.domain.cell import CalibrationHealth
from edged.domain.events import Command, CommandKind, Snapshot
from edged.domain.frames import FramePair
from edged.domain.marks import MarksTrack
from edged.domain.measurement import Outcome, Status
from edged.domain.stopwatch import Stopwatch
from edged.errors import CaptureError
from edged.robot.belt import moment_of, on_belt
from edged.robot.picking import picked

TRY_ALL_S = 3.0
"""A command that tries every job starts no further job after this time."""


@dataclass(frozen=True, slots=True, eq=False)
class CycleRun:
    """A running cycle; exactly one of `failed`, `grabbed` and `located` ends it.

    cell : its setup and active job do not change during a cycle. command : None for a tick.
    utc_ns : clock for the result's time stamp. lap : called at the end of each stage.
    """

    cell: CellContext
    command: Command | None
    utc_ns: Callable[[], int]
    lap: Stopwatch = field(default_factory=Stopwatch, init=False)

    def failed(self, error: CaptureError) -> Snapshot:
        """Snapshot of a cycle whose exposure failed."""
        blank = self._blank(self._job, Status.CAPTURE_FAULT)
        return replace(blank, error=str(error), error_code=error.code)

    def grabbed(self, pair: FramePair) -> Snapshot:
        """Snapshot of an exposure that is not measured."""
        return self._exposed(self._job, pair, Outcome(Status.NO_TARGET))

    async def located(self, pair: FramePair) -> Snapshot:
        """Snapshot of an exposure measured with the cycle's job, or with the best of all jobs.

        Anything that the pipeline raises is a bug and propagates.
        """
        before = await self.followed(pair)
        if self.command is not None and self.command.tries_all:
            job, outcome = await self._best(pair)
        else:
            job, outcome = self._job, await self._located(self._job, pair)
        outcome = self._picked(job, self._on_belt(pair, self._watched(job, outcome)))
        if not self.cell.marks.valid:
            outcome = refused(outcome)
        golden = job.golden
        if golden is None or (self.command is not None and self.command.kind is CommandKind.GOLDEN):
            return self._exposed(job, pair, outcome, before)
        frame, registration = self.cell.setup.frame(self.command)
        outcome = await self.cell.on_vision_thread(
            golden.applied, outcome, frame.robot_from_rig, registration
        )
        exposed = self._exposed(job, pair, outcome, before)
        return replace(exposed, golden=golden.state, golden_ns=golden.exposed_ns)

    @property
    def _job(self) -> LoadedJob:
        """Job named by the command, else the active one."""
        named = self.command is not None and self.command.job
        return self.cell.setup.jobs[named] if named else self.cell.active

    async def _located(self, job: LoadedJob, pair: FramePair) -> Outcome:
        marks, track = self.cell.setup.marks, self.cell.track
        if marks is None or track is None:
            return await self.cell.on_vision_thread(job.locate, pair, lap=self.lap)
        return await self.cell.on_vision_thread(marks.locate, job.number, pair, track, lap=self.lap)

    async def followed(self, pair: FramePair) -> MarksTrack | None:
        """Add this exposure to the track of the reference marks; return the track before it."""
        before = await self.cell.follow(pair)
        if before is not None:
            self.lap("marks")
        return before

    async def _best(self, pair: FramePair) -> tuple[LoadedJob, Outcome]:
        """Try every job on one exposure, the active one first, then by number, until time is up.

        The good part with the highest score wins; without a good part, the highest score.
        """
        active = self.cell.active
        others = [job for _, job in sorted(self.cell.setup.jobs.items()) if job is not active]
        end_s = time.monotonic() + TRY_ALL_S
        tried: list[tuple[LoadedJob, Outcome]] = []
        for job in (active, *others):
            if not tried or time.monotonic() < end_s:
                tried.append((job, await self._located(job, pair)))
        if len(tried) <= len(others):
            log.warning("%d of %d jobs were tried within %g s", len(tried), 1 + len(others), TRY_ALL_S)

        def agreement(attempt: tuple[LoadedJob, Outcome]) -> tuple[bool, float]:
            allowed = self._picked(*attempt)
            return allowed.status is Status.OK, max((t.match.score for t in allowed.targets), default=-1.0)

        return max(tried, key=agreement)

    def _picked(self, job: LoadedJob, outcome: Outcome) -> Outcome:
        """Return the outcome with targets in picking order and those outside the robot's limits refused."""
        frame, _ = self.cell.setup.frame(self.command)
        return picked(outcome, self.cell.setup.picking(job, self.command), frame)

    def _on_belt(self, pair: FramePair, outcome: Outcome) -> Outcome:
        """Return the outcome for parts on a belt: each gets its number, and blurred ones are refused."""
        belt = self.cell.setup.belt
        if belt is None:
            return outcome
        frame, _ = self.cell.setup.frame(self.command)
        outcome, self.cell.seen = on_belt(
            outcome, belt, self._moment(pair), frame.robot_from_rig, self.cell.seen
        )
        return outcome

    def _moment(self, pair: FramePair) -> BeltMoment | None:
        belt, command = self.cell.setup.belt, self.command
        return None if belt is None else moment_of(belt, pair, None if command is None else command.belt)

    def _watched(self, job: LoadedJob, outcome: Outcome) -> Outcome:
        """Feed the drift monitor; refuse good results while the calibration is known to be wrong."""
        for target in outcome.targets:
            self.cell.drift.add(target, job.witness)
        return refused(outcome) if self.cell.drift.state().verdict is CalibrationHealth.INVALID else outcome

    def _exposed(
        self, job: LoadedJob, pair: FramePair, outcome: Outcome, before: MarksTrack | None = None
    ) -> Snapshot:
        return self._blank(
            job,
            outcome.status,
            exposed_ns=pair.exposed_ns,
            exposed_bound_ns=pair.exposed_bound_ns,
            exposed_count=pair.count,
            targets=outcome.targets,
            dismissed=outcome.dismissed,
            nearest=outcome.nearest,
            pockets=outcome.pockets,
            belt=self._moment(pair),
            carried_by=self.cell.setup.belt,
            marks_before=before,
        )

    def _blank(self, job: LoadedJob, status: Status, exposed_ns: int = 0, **exposed: Any) -> Snapshot:
        """Return a snapshot with the cycle's context; exposed : fields of exposure and result, if any."""
        setup = self.cell.setup
        frame, registration = setup.frame(self.command)
        return Snapshot(
            cycle=self.cell.number,
            status=status,
            command=self.command,
            job=job.name,
            job_number=job.number,
            calibration_id=setup.calibration_id,
            fingerprint=setup.fingerprint,
            simulated=setup.simulated,
            exposed_ns=exposed_ns,
            published_ns=self.utc_ns(),
            timing_ms=self.lap.timing_ms(),
            robot_from_rig=frame.robot_from_rig,
            registration_covariance=registration,
            drift=self.cell.drift.state(),
            basis=self.cell.announcements.basis.number,
            marks=self.cell.marks,
            **exposed,
        )
