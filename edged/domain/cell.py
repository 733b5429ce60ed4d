"""The state of the cell: what it is doing, and whether its calibration holds."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from edged.domain.acceptance import Acceptance
from edged.domain.marks import MarksReport
from edged.domain.robotmap import MapFigures


class CalibrationHealth(enum.IntEnum):
    """Whether the calibration holds, judged by the measured parts."""

    HOLDS = 0
    """No evidence against it, or too little to judge."""
    DRIFTS = 1
    """Rows or the known length exceed the first limit: calibrate soon."""
    INVALID = 2
    """The second limit is exceeded: results are refused."""


@dataclass(frozen=True, slots=True)
class DriftState:
    """The verdict, the mean row difference (px rms) and the known length's mean deviation; NaN: unknown."""

    verdict: CalibrationHealth = CalibrationHealth.HOLDS
    rows_px: float = math.nan
    length_percent: float = math.nan


class CellPhase(enum.StrEnum):
    """Phase of the daemon."""

    STARTING = "STARTING"
    READY = "READY"
    BUSY = "BUSY"
    FAULT = "FAULT"
    STOPPING = "STOPPING"
    SETUP = "SETUP"


class SetupSource(enum.IntEnum):
    """Why the cell is in SETUP."""

    NONE = 0
    """It is not in SETUP."""
    PERSON = 1
    """A person has taken it, to calibrate, teach or inspect."""
    NO_CALIBRATION = 2
    """There is no rig file yet."""
    NO_JOB = 3
    """There is no job yet."""
    ROBOT = 4
    """A robot's program is registering the rig, begun by HAND_EYE_START or TOUCH_START."""


@dataclass(frozen=True, slots=True)
class CellState:
    """The daemon's own state, published on change.

    marks : report of the reference marks when it last changed. acceptance : last acceptance test of the
    cell. robot_map : figures of the robot's error map. setup : why it is in SETUP. setup_by : holder of the
    cell; "" if no lease is held.
    """

    state: CellPhase
    ready: bool
    cameras_ok: bool
    job: str
    job_number: int
    missed_triggers: int
    error: str = ""
    error_code: int = 0
    calibrated: CalibrationHealth = CalibrationHealth.HOLDS
    setup: SetupSource = SetupSource.NONE
    setup_by: str = ""
    marks: MarksReport = field(default_factory=MarksReport)
    acceptance: Acceptance = field(default_factory=Acceptance)
    robot_map: MapFigures = field(default_factory=MapFigures)

    @property
    def why(self) -> str:
        """Why the cell does not measure, as text for people; "" if it does, or nothing is wrong."""
        match self.setup:
            case SetupSource.NONE:
                return self.error
            case SetupSource.NO_CALIBRATION:
                return "setup: no calibration yet"
            case SetupSource.NO_JOB:
                return "setup: no job yet"
            case SetupSource.ROBOT:
                return "setup: a robot's program registers the rig"
            case SetupSource.PERSON:
                return f"setup by {self.setup_by}" if self.setup_by else "setup, unattended"
