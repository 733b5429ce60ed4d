"""Triangulation of corresponding image points (paper, eq. 1-3, with the principal point)."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply

_GAUSS_NEWTON_STEPS = 5  # converges quadratically from the midpoint: 2-3 steps reach 1e-9 mm


def triangulate(rectification: Rectification, left_px: FloatArray, right_x_px: FloatArray) -> FloatArray:
    """Points (N, 3) in mm, in the rig frame (the raw left camera), of rectified correspondences.

    left_px (N, 2) : (x, y) in the rectified left image; right_x_px (N,) : column in the
    rectified right image, on the same row.
    NaN where the parallax is not positive: such rays do not meet in front of the cameras.
    The paper's eq. 3 leaves out the principal point; here it is included.
    """
    left = np.asarray(left_px, dtype=np.float64)
    parallax = _parallax(rectification, left, right_x_px)
    cx, cy = rectification.centre_left_px
    depth = rectification.focal_px * rectification.baseline_mm / parallax
    across = (left - (cx, cy)) * (depth / rectification.focal_px)[:, None]
    rectified = np.column_stack([across, depth])
    return np.asarray(rectified @ rectification.rectified_from_left)


def triangulation_covariance(
    rectification: Rectification, left_px: FloatArray, right_x_px: FloatArray, covariance_px: FloatArray
) -> FloatArray:
    """Covariance (N, 3, 3) in mm² of the points from `triangulate`, to first order.

    covariance_px : (3, 3) or (N, 3, 3), of (x_left, y, x_right) in px². The rig is taken as exact.
    """
    left = np.asarray(left_px, dtype=np.float64)
    parallax = _parallax(rectification, left, right_x_px)
    offset = left - rectification.centre_left_px
    baseline, focal = rectification.baseline_mm, rectification.focal_px
    # X = B u / d, Y = B v / d, Z = B f / d with d = u - u_right
    jacobian = np.zeros((len(left), 3, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = baseline / parallax
    steep = -baseline * np.column_stack([offset, np.full(len(left), focal)]) / parallax[:, None] ** 2
    jacobian[:, :, 0] += steep
    jacobian[:, :, 2] -= steep
    jacobian = rectification.rectified_from_left.T @ jacobian
    return np.asarray(jacobian @ covariance_px @ jacobian.transpose(0, 2, 1))


def triangulate_raw(rig: StereoRig, left_px: FloatArray, right_px: FloatArray) -> FloatArray:
    """Points (N, 3) in mm, rig frame, that minimise the squared reprojection error in both raw images.

    left_px, right_px (N, 2). These are the maximum-likelihood points for equal noise in all coordinates.
    NaN where the rays do not meet in front of both cameras.
    """
    left, right = np.asarray(left_px, dtype=np.float64), np.asarray(right_px, dtype=np.float64)
    points = _midpoints(rig, left, right)
    known = np.isfinite(points).all(axis=1)
    good = points[known]
    for _ in range(_GAUSS_NEWTON_STEPS):
        residuals, jacobian = _reprojection(rig, good, left[known], right[known])
        normal = jacobian.transpose(0, 2, 1) @ jacobian
        gradient = np.einsum("nij,ni->nj", jacobian, residuals)
        good = good + np.linalg.solve(normal, gradient[..., None])[..., 0]
    result = np.full_like(points, np.nan)
    in_front = (good[:, 2] > 0) & (apply(rig.right_from_left, good)[:, 2] > 0)
    result[known] = np.where(in_front[:, None], good, np.nan)
    return result


def raw_covariance(rig: StereoRig, points_mm: FloatArray, sigma_px: float | FloatArray = 1.0) -> FloatArray:
    """Covariance (N, 3, 3) in mm² of points (N, 3) triangulated from both raw images.

    sigma_px : noise of one image coordinate, a number or (N,). The rig is taken as exact.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    nothing = np.zeros((len(points), 2))
    _, jacobian = _reprojection(rig, points, nothing, nothing)
    variance = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64) ** 2, (len(points),))
    return np.asarray(np.linalg.inv(jacobian.transpose(0, 2, 1) @ jacobian) * variance[:, None, None])


def _parallax(rectification: Rectification, left: FloatArray, right_x_px: FloatArray) -> FloatArray:
    right_x = np.asarray(right_x_px, dtype=np.float64)
    parallax = (left[:, 0] - rectification.centre_left_px[0]) - (right_x - rectification.centre_right_px[0])
    return np.where(parallax > 0, parallax, np.nan)


def _midpoints(rig: StereoRig, left: FloatArray, right: FloatArray) -> FloatArray:
    """Midpoints (N, 3) of the shortest lines between both rays; NaN where one lies behind a camera."""
    rotation, translation = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]
    ray_left = np.column_stack([rig.left.normalise(left), np.ones(len(left))])
    ray_right = np.column_stack([rig.right.normalise(right), np.ones(len(right))]) @ rotation
    centre_right = -rotation.T @ translation
    ll, lr, rr = (np.sum(a * b, axis=1) for a, b in _pairs(ray_left, ray_right))
    cl, cr = ray_left @ centre_right, ray_right @ centre_right
    determinant = ll * rr - lr * lr
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (rr * cl - lr * cr) / determinant
        t = (lr * cl - ll * cr) / determinant
        middle = 0.5 * (ray_left * s[:, None] + centre_right + ray_right * t[:, None])
    usable = (determinant > 1e-12 * ll * rr) & (s > 0) & (t > 0)
    return np.where(usable[:, None], middle, np.nan)


def _pairs(a: FloatArray, b: FloatArray) -> tuple[tuple[FloatArray, FloatArray], ...]:
    return (a, a), (a, b), (b, b)


def _reprojection(
    rig: StereoRig, points: FloatArray, left: FloatArray, right: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals (N, 4), measured - projected, and the Jacobian (N, 4, 3) of the projection by the point."""
    in_left, by_left, _ = project_with_jacobians(rig.left, points)
    in_right, by_right, _ = project_with_jacobians(rig.right, apply(rig.right_from_left, points))
    residuals = np.concatenate([left - in_left, right - in_right], axis=1)
    jacobian = np.concatenate([by_left, by_right @ rig.right_from_left[:3, :3]], axis=1)
    return residuals, jacobian
