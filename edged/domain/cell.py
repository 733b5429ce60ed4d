"""The state of the cell: what it is doing, and whether its calibration holds."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from edged.domain.acceptance import Acceptance
from edged.domain.marks import MarksReport
from edged.domain.robotmap import MapFigures


class CalibrationHealth(enum.IntEnum):
    """Whether the calibration holds, by what the parts show."""

    HOLDS = 0
    """No evidence against it, or too little to judge."""
    DRIFTS = 1
    """Rows or the known length are beyond the first limit: calibrate soon."""
    INVALID = 2
    """Beyond the second limit: results are refused."""


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
    """A person has taken it, to calibrate, teach or look."""
    NO_CALIBRATION = 2
    """There is no rig file yet."""
    NO_JOB = 3
    """There is no job yet."""
    ROBOT = 4
    """A robot's program registers the rig: HAND_EYE_START or TOUCH_START began it."""


@dataclass(frozen=True, slots=True)
class CellState:
    """The daemon's own state, published on change.

    marks : what the reference marks said when that changed last. acceptance : the last test of
    the cell. robot_map : of its robot's error. setup : why it is in SETUP. setup_by : holder of the cell; ""
    when no lease is held.
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
        """Why the cell does not measure, in words for people; "" when it does, or nothing is wrong."""
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
