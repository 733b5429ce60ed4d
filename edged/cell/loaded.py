"""Setup of the loop: jobs in memory, and everything else that a reload exchanges."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from edged.cell.drift import DriftLimits
from edged.domain.acceptance import Acceptance
from edged.domain.arrays import FloatArray
from edged.domain.belt import Belt
from edged.domain.cell import SetupSource
from edged.domain.events import WITHOUT_PICTURE, Command, CommandKind
from edged.domain.frames import FramePair
from edged.domain.marks import MarksReport, MarksState, MarksTrack
from edged.domain.measurement import Outcome
from edged.domain.picking import Bounds, Picking
from edged.domain.robotmap import MapFigures
from edged.robot.covariance import moved_frame
from edged.robot.errormap import ErrorMap
from edged.robot.golden import GoldenPart
from edged.robot.picking import RobotFrame, narrowed, within

_IN_ROBOTS_FRAME = (CommandKind.LOCATE, CommandKind.GOLDEN)
Locate = Callable[[FramePair, Callable[[str], None]], Outcome]
"""The pipeline with job and rig bound; calls the second argument at the end of each stage."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedJob:
    """A job that is in memory and warm.

    witness : its measurement of known size, used to detect drift. picking : which parts a robot may pick, and
    how.
    golden : the reference part for offsets; None if none was kept.
    """

    name: str
    number: int
    locate: Locate
    witness: str | None = None
    picking: Picking = field(default_factory=Picking)
    golden: GoldenPart | None = None


class MarksFollower(Protocol):
    """Follows a rig's reference marks, which give the position of its cameras in each exposure."""

    @property
    def digest(self) -> str:
        """Digest of the marks: a track continues as long as it is unchanged."""

    def begin(self) -> MarksTrack:
        """Return the track before the first exposure."""

    def see(self, track: MarksTrack, pair: FramePair) -> tuple[MarksTrack, MarksReport]:
        """Return the track after this pair, and a report of its marks; called on the measuring thread."""

    def locate(self, number: int, pair: FramePair, track: MarksTrack, lap: Callable[[str], None]) -> Outcome:
        """Locate a job's part with the rig geometry corrected by the track."""


def _no_job(_pair: FramePair, _lap: Callable[[str], None]) -> Outcome:
    raise RuntimeError("measured by a cell that has no job")


NO_JOB = LoadedJob("", 0, _no_job)
"""Active job of a cell without calibration or jobs, which is in SETUP and never measures."""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Everything that a reload may exchange between two cycles.

    jobs : by number. period_s : None: measure only on command.
    lacks : why the cell cannot measure and is in SETUP; it has no jobs then.
    idle_s : interval of warming exposures while nothing is requested; None: none are made.
    listens : the cameras are triggered externally, and every exposure is measured.
    flange_from_rig : for a rig carried by the robot; each command then gives the flange pose.
    registration_covariance : (6, 6) of robot_from_rig, or of flange_from_rig.
    bounds : where the robot may go, for all jobs. marks : None: nothing is corrected; others : state to
    report then, which says why marks that exist are not used. error_map : of the robot. acceptance : last
    acceptance test of the cell. belt : the belt carrying the parts; None: they lie still.
    """

    jobs: Mapping[int, LoadedJob]
    active_job: int
    period_s: float | None
    calibration_id: str
    fingerprint: str
    simulated: bool
    robot_from_rig: FloatArray | None
    registration_covariance: FloatArray | None = None
    flange_from_rig: FloatArray | None = None
    drift: DriftLimits = field(default_factory=DriftLimits)
    listens: bool = False
    lacks: SetupSource = SetupSource.NONE
    bounds: Bounds = field(default_factory=Bounds)
    idle_s: float | None = None
    marks: MarksFollower | None = None
    error_map: ErrorMap | None = None
    others: MarksState = MarksState.NONE
    acceptance: Acceptance = field(default_factory=Acceptance)
    belt: Belt | None = None

    @property
    def map_figures(self) -> MapFigures:
        """Figures of the robot's error map."""
        return MapFigures() if self.error_map is None else self.error_map.figures

    def problem(self, command: Command) -> str:
        """Reason why a command cannot be carried out; "" if it can."""
        if command.kind in WITHOUT_PICTURE:
            return f"{command.kind.name} is answered from the last picture, and this client has none"
        if command.job and command.job not in self.jobs:
            known = ", ".join(f"{job.number} ({job.name})" for job in self.jobs.values())
            return f"unknown job {command.job}, there are {known}"
        if command.kind is CommandKind.CHANGE_JOB and not command.job:
            return "a job change needs a job number"
        if command.box > len(self.bounds.boxes):
            return f"no box {command.box}, the cell's limits have {len(self.bounds.boxes)}"
        if command.kind is CommandKind.GOLDEN:
            if self.robot_from_rig is None and self.flange_from_rig is None:
                return "the rig is not registered to the robot: GOLDEN is kept in its frame"
            if command.tries_all:
                return "GOLDEN is of one job, not of all"
        is_on_belt = self.belt is not None and self.belt.source == "command"
        if is_on_belt and command.kind is CommandKind.LOCATE and command.belt is None:
            return "the parts are on a belt: LOCATE needs its count (OPTIONS with BELT, and BELT_COUNT)"
        needs_place = self.flange_from_rig is not None and command.kind in _IN_ROBOTS_FRAME
        if needs_place and command.robot_from_flange is None:
            return f"the robot carries the cameras: {command.kind.name} needs the pose of the flange"
        return ""

    def frame(self, command: Command | None) -> tuple[RobotFrame, FloatArray | None]:
        """Return the frame of a cycle's coordinates, and the covariance (6, 6) of its registration."""
        robot_from_rig, registration = self.robot_from_rig, self.registration_covariance
        robot_from_flange = command.robot_from_flange if command is not None else None
        if self.flange_from_rig is None:
            frame = RobotFrame(robot_from_rig, robot_from_flange=robot_from_flange, error_map=self.error_map)
            return frame, registration
        if robot_from_flange is None:
            return RobotFrame(robot_from_rig, robot_from_rig is not None), registration
        moved = None if registration is None else moved_frame(registration, robot_from_flange)
        robot_from_rig = np.asarray(robot_from_flange @ self.flange_from_rig)
        return RobotFrame(robot_from_rig, robot_from_flange=robot_from_flange), moved

    def picking(self, job: LoadedJob, command: Command | None) -> Picking:
        """Return the job's picking rules, restricted by the limits of the cell and the command."""
        picking = within(job.picking, narrowed(self.bounds, command.box if command is not None else 0))
        return picking if command is None else replace(picking, skipped_mm=command.skipped_mm)
