"""Propagation of a calibration's uncertainty to measured points and poses."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rigid import skew


def shift_by_parameters(rig: StereoRig, points_mm: FloatArray) -> FloatArray:
    """(N, 3, P): motion in mm of triangulated points per unit of each of `rig.parameter_names`.

    points_mm (N, 3), rig frame. To first order, for fixed images: the rig changes, and the point follows.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    rotated = points @ rig.right_from_left[:3, :3].T
    _, left_by_point, left_by_lens = project_with_jacobians(rig.left, points)
    in_right = rotated + rig.right_from_left[:3, 3]
    _, right_by_point, right_by_lens = project_with_jacobians(rig.right, in_right)
    lenses = left_by_lens.shape[2], right_by_lens.shape[2]
    by_rig = np.zeros((len(points), 4, sum(lenses) + 6))
    by_rig[:, :2, : lenses[0]] = left_by_lens
    by_rig[:, 2:, lenses[0] : -6] = right_by_lens
    by_rig[:, 2:, -6:-3] = -right_by_point @ skew(rotated)
    by_rig[:, 2:, -3:] = right_by_point
    by_point = np.concatenate([left_by_point, right_by_point @ rig.right_from_left[:3, :3]], axis=1)
    transposed = by_point.transpose(0, 2, 1)
    return -np.linalg.solve(transposed @ by_point, transposed @ by_rig)


def shifted_pose_covariance(covariance: FloatArray, arm_mm: FloatArray) -> FloatArray:
    """Covariance (6, 6) of a pose whose origin lies an arm (3,) away from that of a known pose of the body.

    covariance : of (x, y, z in mm, rotation vector in rad), the small rotation applied on the left; arm_mm in
    the same axes. A rotation w of the body moves the end of the arm by w x arm.
    """
    jacobian = np.eye(6)
    jacobian[:3, 3:] = -skew(arm_mm)
    with np.errstate(invalid="ignore", over="ignore"):  # unknown entries stay NaN
        return np.asarray(jacobian @ covariance @ jacobian.T)


def calibration_covariance(rig: StereoRig, points_mm: FloatArray) -> FloatArray:
    """Covariance (N, 3, 3) in mm² of triangulated points (N, 3) that follows from the rig's own covariance.

    The errors of neighbouring points are nearly equal: distances between them are far more certain.
    Zero for a rig of unknown covariance.
    """
    if rig.covariance is None:
        return np.zeros((len(points_mm), 3, 3))
    shift = shift_by_parameters(rig, points_mm)
    return np.asarray(shift @ rig.covariance @ shift.transpose(0, 2, 1))
