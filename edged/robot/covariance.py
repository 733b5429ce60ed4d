"""Pose covariances, transformed from the rig's frame to the robot's."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Target
from edged.vision.geometry.rigid import skew


def robot_covariance(
    target: Target, robot_from_rig: FloatArray, registration: FloatArray | None
) -> FloatArray:
    """Covariance (6, 6) of a target's pose in the robot's frame, with the registration uncertainty.

    registration (6, 6) : of a small motion applied after robot_from_rig; None: taken as exact. Its rotation w
    moves a point p by w x p, and turns every part by w. A map of the robot's error was fitted on top of that
    registration: the variance of its shift includes the registration's error of place.
    """
    covariance = rotate_covariance(rig_covariance(target), robot_from_rig)
    jacobian = np.eye(6)
    shift = target.robot_shift
    if shift is not None:
        covariance = covariance + shift.variance_mm2 * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        if registration is not None:
            covariance[3:, 3:] += registration[3:, 3:]
        return covariance
    if registration is None:
        return covariance
    jacobian[:3, 3:] = -skew((robot_from_rig @ target.rig_from_part)[:3, 3])
    return np.asarray(covariance + jacobian @ registration @ jacobian.T)


def rig_covariance(target: Target) -> FloatArray:
    """Covariance (6, 6) of a target's pose in the rig's frame, with that of the belt that carries it."""
    return target.covariance if target.belt is None else target.covariance + target.belt.covariance


def robot_pose(target: Target, robot_from_rig: FloatArray) -> FloatArray:
    """Pose (4, 4) of a target in the robot's frame, corrected by the map of the robot's error, if any."""
    pose = np.asarray(robot_from_rig @ target.rig_from_part)
    return pose if target.robot_shift is None else target.robot_shift.moved(pose)


def moved_frame(registration: FloatArray, robot_from_flange: FloatArray) -> FloatArray:
    """Covariance (6, 6) of robot_from_rig from that of flange_from_rig; the flange's pose counts as exact."""
    moved = adjoint(robot_from_flange)
    return np.asarray(moved @ registration @ moved.T)


def adjoint(to_from_source: FloatArray) -> FloatArray:
    """Adjoint (6, 6): maps small motions about the source's origin to motions about the other frame's.

    (shift v, rotation w) becomes (R v + t x R w, R w).
    """
    R, t = to_from_source[:3, :3], to_from_source[:3, 3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = R
    result[:3, 3:] = skew(t) @ R
    return result


def rotate_covariance(covariance: FloatArray, to_from_source: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a pose, expressed in another frame.

    covariance : of (translation, rotation vector applied on the left), axes of the old frame.
    to_from_source : (4, 4) rigid transform. With new = T old, a small rotation w of the old axes is
    R w in the new ones, and so is a small shift: J = diag(R, R), J C J^T. The translation of T does
    not enter, because the rotation turns the part about its own origin.
    """
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = to_from_source[:3, :3]
    with np.errstate(invalid="ignore", over="ignore"):  # unknown values stay NaN, and are published as null
        return np.asarray(jacobian @ covariance @ jacobian.T, dtype=np.float64)
