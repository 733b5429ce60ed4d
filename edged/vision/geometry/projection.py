"""Projection with its derivatives, for estimation and error propagation."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import CameraModel, StereoRig


def project_with_jacobians(
    camera: CameraModel, points_mm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points of the camera's frame, with derivatives.

    points_mm (N, 3).  Returns pixels (N, 2); d pixels / d point (N, 2, 3); and d pixels / d parameter
    (N, 2, P) with the parameters fx, fy, cx, cy and then the model's distortion.
    """
    x, y, z = points_mm[:, 0], points_mm[:, 1], points_mm[:, 2]
    u, v = x / z, y / z
    if camera.model == "division":
        distorted, by_normalised, by_lens = _division(u, v, camera.distortion[0])
    else:
        distorted, by_normalised, by_lens = _brown(u, v, camera.distortion)
    focal = np.array([camera.fx, camera.fy])
    pixels = distorted * focal + (camera.cx, camera.cy)

    by_point = np.empty((len(u), 2, 3))
    by_point[:, :, :2] = by_normalised / z[:, None, None]
    by_point[:, :, 2] = (
        -(by_normalised[:, :, 0] * u[:, None] + by_normalised[:, :, 1] * v[:, None]) / z[:, None]
    )
    by_point *= focal[:, None]

    by_parameter = np.zeros((len(u), 2, 4 + by_lens.shape[2]))
    by_parameter[:, 0, 0], by_parameter[:, 1, 1] = distorted[:, 0], distorted[:, 1]
    by_parameter[:, 0, 2] = by_parameter[:, 1, 3] = 1.0
    by_parameter[:, :, 4:] = by_lens * focal[:, None]
    return pixels, by_point, by_parameter


def shifts_by_calibration(
    rig: StereoRig, points_mm: FloatArray, normals_left: FloatArray, normals_right: FloatArray
) -> FloatArray:
    """(2, N, Q): motion of edges against the projected curve, along its normals, per unit of each parameter.

    points_mm (N, 3) rig frame; normals (N, 2) in the raw images; left first. The parameters are those of
    `rig.parameter_names`.
    """
    rotation, translation = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]
    turned = points_mm @ rotation.T
    _, _, by_left = project_with_jacobians(rig.left, points_mm)
    _, by_point, by_right = project_with_jacobians(rig.right, turned + translation)
    left = np.einsum("ni,niq->nq", normals_left, by_left)
    right = np.einsum("ni,niq->nq", normals_right, by_right)
    along = np.einsum("ni,nij->nj", normals_right, by_point)
    # a small rotation w on the left of R moves a point by w x (R X): a . (w x b) = w . (b x a)
    right = np.hstack([right, np.cross(turned, along), along])
    shifts = np.zeros((2, len(points_mm), left.shape[1] + right.shape[1]))
    shifts[0, :, : left.shape[1]] = -left
    shifts[1, :, left.shape[1] :] = -right
    return shifts


def _division(u: FloatArray, v: FloatArray, kappa: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Division model: distorted = undistorted g, g = 2 / (1 + s), s = sqrt(1 - 4 kappa r²)."""
    r2 = u * u + v * v
    with np.errstate(invalid="ignore"):
        s = np.sqrt(1 - 4 * kappa * r2)
    g = 2 / (1 + s)
    slope_r2 = kappa * g * g / s  # dg/dr² = -2/(1+s)² * ds/dr², ds/dr² = -2 kappa/s
    slope_kappa = r2 * g * g / s
    undistorted = np.stack([u, v], axis=-1)
    by_normalised = g[:, None, None] * np.eye(2) + 2 * slope_r2[:, None, None] * (
        undistorted[:, :, None] * undistorted[:, None, :]
    )
    return undistorted * g[:, None], by_normalised, (undistorted * slope_kappa[:, None])[:, :, None]


def _brown(
    u: FloatArray, v: FloatArray, coefficients: tuple[float, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Brown-Conrady model, columns of the last derivative: k1, k2, p1, p2, k3."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)
    distorted = np.stack(
        [
            u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u),
            v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v,
        ],
        axis=-1,
    )
    by_normalised = np.empty((len(u), 2, 2))
    by_normalised[:, 0, 0] = radial + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u
    by_normalised[:, 0, 1] = by_normalised[:, 1, 0] = 2 * u * v * slope + 2 * p1 * u + 2 * p2 * v
    by_normalised[:, 1, 1] = radial + 2 * v * v * slope + 6 * p1 * v + 2 * p2 * u
    by_lens = np.empty((len(u), 2, 5))
    by_lens[:, 0] = np.stack([u * r2, u * r2**2, 2 * u * v, r2 + 2 * u * u, u * r2**3], axis=-1)
    by_lens[:, 1] = np.stack([v * r2, v * r2**2, r2 + 2 * v * v, 2 * u * v, v * r2**3], axis=-1)
    return distorted, by_normalised, by_lens
