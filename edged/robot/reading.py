"""Position and A, B, C of a located part, in the robot's frame if there is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Target
from edged.robot.covariance import rig_covariance, robot_covariance, robot_pose
from edged.robot.orientations import ANGLES_DEG, Convention, sigma_angles_deg


@dataclass(frozen=True, slots=True, eq=False)
class PartReading:
    """Pose of a part: position_mm (3,), angles_deg A, B, C (3,), and one sigma of each."""

    position_mm: FloatArray
    sigma_mm: FloatArray
    angles_deg: FloatArray
    sigma_deg: FloatArray


def frame_name(robot_from_rig: FloatArray | None) -> str:
    """Frame of published positions: `robot` if the rig is registered to one, else `rig`."""
    return "rig" if robot_from_rig is None else "robot"


def reading_of(
    target: Target, robot_from_rig: FloatArray | None, registration: FloatArray | None, convention: Convention
) -> PartReading:
    """Pose of a target in the frame of `frame_name`.

    registration (6, 6) : as for `robot_covariance`. The pose and its covariance must be finite.
    """
    pose, covariance = target.rig_from_part, rig_covariance(target)
    if robot_from_rig is not None:
        pose = robot_pose(target, robot_from_rig)
        covariance = robot_covariance(target, robot_from_rig, registration)
    turned = pose[:3, :3]
    return PartReading(
        position_mm=pose[:3, 3],
        sigma_mm=np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0)),
        angles_deg=np.array(ANGLES_DEG[convention](turned)),
        sigma_deg=sigma_angles_deg(turned, covariance[3:, 3:], convention),
    )
