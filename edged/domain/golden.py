"""The golden part: where a part lay when the robot's path was taught, and other parts' offset from it."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from edged.domain.arrays import FloatArray


class GoldenState(enum.IntEnum):
    """Whether results carry an offset from a golden part."""

    NONE = 0
    """No golden part was kept for this job."""
    HELD = 1
    """Good parts have an offset."""
    OTHER_CALIBRATION = 2
    """It was kept with another calibration of the rig; no offset."""
    OTHER_REGISTRATION = 3
    """The rig has been reregistered to the robot since; no offset."""
    OTHER_PART = 4
    """The job has been retaught since, or reports another point of the part; no offset."""
    DAMAGED = 5
    """Its file cannot be read; no offset."""


@dataclass(frozen=True, slots=True, eq=False)
class Golden:
    """Where the taught part lay.

    number, part : of the job, and digest of the data that define its frame. calibration_id : of the rig;
    registration : digest of the rig's pose relative to the robot. exposed_ns : UTC.
    robot_from_rig, rig_from_part (4, 4). covariance (6, 6) : of robot_from_part, from all causes.
    own (6, 6) : share of rig_from_part's covariance, axes of the rig, that other exposures do not have in
    common. points_mm (N, 3) : of the part, rig frame, to propagate the calibration's error to its pose; none
    if `own` is the whole covariance.
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
        """Pose (4, 4) of the golden part in the robot's frame."""
        return self.robot_from_rig @ self.rig_from_part


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """Offset of a part from the golden one.

    robot (4, 4) : robot_now robot_golden^-1; a taught path is multiplied by it from the left.
    covariance (6, 6) : of the golden part's reference point after the offset (mm, axes of the robot), and of
    the offset's rotation (rad, applied on the left).
    part (4, 4) : the same motion in the golden part's own frame, golden_from_now; part_covariance (6, 6) of
    it, in that frame's axes.
    """

    robot: FloatArray
    covariance: FloatArray
    part: FloatArray
    part_covariance: FloatArray
