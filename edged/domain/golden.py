"""The golden part: where a part lay when the robot's path was taught, and how another one lies against it."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from edged.domain.arrays import FloatArray


class GoldenState(enum.IntEnum):
    """Whether results carry an offset from a golden part."""

    NONE = 0
    """No GOLDEN was kept for this job."""
    HELD = 1
    """Good parts have an offset."""
    OTHER_CALIBRATION = 2
    """It was kept with another calibration of the rig: no offset."""
    OTHER_REGISTRATION = 3
    """The rig was registered to the robot anew since: no offset."""
    OTHER_PART = 4
    """The job was taught anew since, or reports another place of the part: no offset."""
    DAMAGED = 5
    """Its file cannot be read: no offset."""


@dataclass(frozen=True, slots=True, eq=False)
class Golden:
    """Where the taught part lay.

    number, part : of the job, and digest of what fixes its frame. calibration_id : of the rig;
    registration : digest of how it stands to the robot. exposed_ns : UTC.
    robot_from_rig, rig_from_part (4, 4). covariance (6, 6) : of robot_from_part, all causes together.
    own (6, 6) : of rig_from_part, axes of the rig, from what other exposures do not share.
    points_mm (N, 3) : of the part, rig frame, to tell what the calibration's error does to its pose; none
    where `own` is the whole.
    free_axis (3,) : as in `Target`.
    """

    number: int
    job: str
    part: str
    calibration_id: str
    registration: str
    exposed_ns: int
    robot_from_rig: FloatArray
    rig_from_part: FloatArray
    covariance: FloatArray
    own: FloatArray
    points_mm: FloatArray
    free_axis: FloatArray | None = None

    @property
    def robot_from_part(self) -> FloatArray:
        """(4, 4)."""
        return self.robot_from_rig @ self.rig_from_part


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """How a part lies against the golden one.

    robot (4, 4) : robot_now robot_golden^-1; a taught path is multiplied by it from the left.
    covariance (6, 6) : of where it lays the golden part's reference point (mm, axes of the robot), and of its
    rotation (rad, applied on the left).
    part (4, 4) : the same motion in the golden part's own frame, golden_from_now; part_covariance (6, 6) of
    it, in that frame's axes.
    """

    robot: FloatArray
    covariance: FloatArray
    part: FloatArray
    part_covariance: FloatArray
