"""Grasp poses for a located part: pure functions of its pose and the taught grasps.

A symmetric part may be taken in several ways; of the allowed ones, the tool gets the one nearest to its
current orientation, or to the taught one where the current is not known.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Target
from edged.domain.picking import Grasp, GraspPose
from edged.robot.orientations import about
from edged.vision.geometry.rigid import invert, rotation_vector, skew, transform

MAX_WAYS = 8
"""Maximum number of ways kept to take one part: a robot that can reach none of them gives up the part."""
TURNS_OF_ANY = 8
"""Number of turns tried for a part that may be taken at any angle: half a step clears a finger of 45°."""
ALONG_Z = 0.999
"""Least cosine between a part's axis of symmetry and its z for the two to count as the same."""


def allowed_grasps(
    target: Target,
    grasps: Sequence[Grasp],
    is_allowed: Callable[[GraspPose], bool],
    rig_from_tip: FloatArray | None = None,
) -> tuple[GraspPose, ...]:
    """The first `MAX_WAYS` allowed alternatives of the grasps, in the order of the job.

    rig_from_tip (4, 4) : current pose of the tool's tip; None: not known.
    """
    if not (np.isfinite(target.rig_from_part).all() and np.isfinite(target.covariance).all()):
        return ()
    poses = (
        pose
        for number, grasp in enumerate(grasps, 1)
        for pose in alternatives(target, grasp, number, rig_from_tip)
    )
    return tuple(itertools.islice(filter(is_allowed, poses), MAX_WAYS))


def alternatives(
    target: Target, grasp: Grasp, number: int, rig_from_tip: FloatArray | None = None
) -> Iterator[GraspPose]:
    """All ways to take the part by this grasp, those that turn the tool least from its current pose first."""
    before = grasp.rig_from_tcp if rig_from_tip is None else rig_from_tip
    is_any = grasp.symmetry == 0 or _looks_the_same(target)
    first_rad = _least_turn_rad(target.rig_from_part, grasp, before) if is_any else 0.0
    count = TURNS_OF_ANY if is_any else grasp.symmetry
    turns_rad = [first_rad + 2 * math.pi * k / count for k in range(count)]
    poses = [(turn_rad, _rig_from_tcp(target.rig_from_part, grasp, turn_rad)) for turn_rad in turns_rad]
    poses.sort(key=lambda turned: round(_turned_rad(turned[1], before), 9))
    for turn_rad, pose in poses:
        yield GraspPose(
            grasp.name,
            number,
            math.remainder(turn_rad, 2 * math.pi),
            pose,
            lever_covariance(target, pose, is_any=is_any),
            grasp.approach_mm,
            grasp.retreat_mm,
        )


def lever_covariance(target: Target, rig_from_tcp: FloatArray, *, is_any: bool) -> FloatArray:
    """Covariance (6, 6) of the tool's pose: a rotation w moves a point at r from the part's origin by w x r.

    is_any : the part may be taken in any rotation about its z, so that an error about z moves nothing.
    """
    arm = rig_from_tcp[:3, 3] - target.rig_from_part[:3, 3]
    jacobian = np.eye(6)
    if is_any:
        axis = target.rig_from_part[:3, 2]
        jacobian[3:, 3:] -= np.outer(axis, axis)
    jacobian[:3, 3:] = -skew(arm) @ jacobian[3:, 3:]
    return np.asarray(jacobian @ target.covariance @ jacobian.T)


def held(target: Target, grasp: GraspPose) -> Target:
    """Target with the pose of the tool's tip in place of its own."""
    return replace(
        target,
        rig_from_part=grasp.rig_from_tcp,
        covariance=grasp.covariance,
        robot_shift=grasp.robot_shift,
    )


def place_correction(robot_offset: FloatArray, robot_from_tool: FloatArray) -> FloatArray:
    """Matrix (4, 4) to multiply a taught place by from the right, for a part that the gripper holds askew.

    robot_offset : robot_now robot_golden^-1 of the part, both seen with the tool at robot_from_tool. The part
    is at tool_from_now in the tool, the golden one was at tool_from_golden: the tool must go to
    place tool_from_golden tool_from_now^-1.
    """
    return np.asarray(invert(robot_from_tool) @ invert(robot_offset) @ robot_from_tool)


def _looks_the_same(target: Target) -> bool:
    """Whether the part's rotation about its z is undetermined, as for a disc."""
    axis = target.free_axis
    return axis is not None and abs(float(axis @ target.rig_from_part[:3, 2])) > ALONG_Z


def _rig_from_tcp(rig_from_part: FloatArray, grasp: Grasp, turn_rad: float) -> FloatArray:
    turned = transform(about(2, turn_rad), np.zeros(3))
    return np.asarray(rig_from_part @ turned @ grasp.part_from_tcp)


def _turned_rad(rig_from_tcp: FloatArray, before: FloatArray) -> float:
    return float(np.linalg.norm(rotation_vector(rig_from_tcp[:3, :3] @ before[:3, :3].T)))


def _least_turn_rad(rig_from_part: FloatArray, grasp: Grasp, before: FloatArray) -> float:
    """Turn about the part's z that brings the tool nearest to the orientation `before`.

    The angle of a rotation is least where its trace is largest; with M = part_from_tcp before^T rig_from_part
    the trace of M Rz(t) is (M00 + M11) cos t + (M01 - M10) sin t + M22.
    """
    M = grasp.part_from_tcp[:3, :3] @ before[:3, :3].T @ rig_from_part[:3, :3]
    return math.atan2(M[0, 1] - M[1, 0], M[0, 0] + M[1, 1])
