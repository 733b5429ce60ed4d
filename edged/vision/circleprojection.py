"""Circles through lens and pose into a raw image, with their derivatives, as one kernel.

The camera models and their derivatives are those of `projection`, point by point instead of array by array:
a fit projects some thousand points a dozen times.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray
from edged.vision.camera import CameraModel
from edged.vision.jit import kernel

F64 = npt.NDArray[np.float64]

_DIVISION, _BROWN = 0, 1
OUTPUTS = 10
"""Columns: pixel (2), outward unit normal (2), derivative along it by centre (3), tilts (2), radius."""


def project_samples(
    camera: CameraModel,
    camera_from_rig: FloatArray,
    frame: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    index: npt.NDArray[np.int64],
    phase: FloatArray,
) -> FloatArray:
    """(N, OUTPUTS) of the points at angles `phase` (N,) of circles in one plane.

    frame (3, 3) : rows u, v, normal of the plane, rig frame.  centres (K, 3), radii (K,) : of the circles;
    index (N,) : which of them a point lies on.  camera_from_rig (4, 4).
    Rows are NaN or infinite where the lens cannot show a point.
    """
    lens = np.zeros(5)
    lens[: len(camera.distortion)] = camera.distortion
    return _project_samples(
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        lens,
        _DIVISION if camera.model == "division" else _BROWN,
        np.require(camera_from_rig, np.float64, ("C", "W")),
        np.require(frame, np.float64, ("C", "W")),
        np.require(centres, np.float64, ("C", "W")),
        np.require(radii, np.float64, ("C", "W")),
        np.require(index, np.int64, ("C", "W")),
        np.require(phase, np.float64, ("C", "W")),
    )


@kernel("UniTuple(f8, 6)(f8, f8, f8[::1], i8)")
def _distort(u: float, v: float, lens: F64, model: int) -> tuple[float, float, float, float, float, float]:
    """The distorted point and its derivatives: x, y, dx/du, dx/dv, dy/du, dy/dv."""
    r2 = u * u + v * v
    if model == _DIVISION:
        root = np.sqrt(1.0 - 4.0 * lens[0] * r2)
        gain = 2.0 / (1.0 + root)
        slope = 2.0 * lens[0] * gain * gain / root
        mixed = slope * u * v
        return u * gain, v * gain, gain + slope * u * u, mixed, mixed, gain + slope * v * v
    k1, k2, p1, p2, k3 = lens[0], lens[1], lens[2], lens[3], lens[4]
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    mixed = slope * u * v + 2.0 * p1 * u + 2.0 * p2 * v
    return (
        u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
        v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
        radial + slope * u * u + 2.0 * p1 * v + 6.0 * p2 * u,
        mixed,
        mixed,
        radial + slope * v * v + 6.0 * p1 * v + 2.0 * p2 * u,
    )


@kernel("f8[:, ::1](f8[::1], f8[::1], i8, f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8[::1], f8[::1])")
def _project_samples(
    pinhole: F64,
    lens: F64,
    model: int,
    pose: F64,
    frame: F64,
    centres: F64,
    radii: F64,
    index: npt.NDArray[np.int64],
    phase: F64,
) -> F64:
    count = len(phase)
    found = np.empty((count, OUTPUTS))
    radial, across, point, along = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    rows = np.empty((2, 3))  # d pixel / d point, rig frame
    for n in range(count):
        cosine, sine = np.cos(phase[n]), np.sin(phase[n])
        centre, radius = centres[index[n]], radii[index[n]]
        for i in range(3):
            radial[i] = cosine * frame[0, i] + sine * frame[1, i]
            across[i] = cosine * frame[1, i] - sine * frame[0, i]
        for i in range(3):
            point[i] = pose[i, 3]
            for j in range(3):
                point[i] += pose[i, j] * (centre[j] + radius * radial[j])
        u, v, depth = point[0] / point[2], point[1] / point[2], point[2]
        x, y, xu, xv, yu, yv = _distort(u, v, lens, model)
        for j in range(3):
            du, dv = (pose[0, j] - u * pose[2, j]) / depth, (pose[1, j] - v * pose[2, j]) / depth
            rows[0, j] = pinhole[0] * (xu * du + xv * dv)
            rows[1, j] = pinhole[1] * (yu * du + yv * dv)
        tx = rows[0, 0] * across[0] + rows[0, 1] * across[1] + rows[0, 2] * across[2]
        ty = rows[1, 0] * across[0] + rows[1, 1] * across[1] + rows[1, 2] * across[2]
        outward = ty * (rows[0, 0] * radial[0] + rows[0, 1] * radial[1] + rows[0, 2] * radial[2]) - tx * (
            rows[1, 0] * radial[0] + rows[1, 1] * radial[1] + rows[1, 2] * radial[2]
        )
        length = np.sqrt(tx * tx + ty * ty) * (-1.0 if outward < 0 else 1.0)
        nx, ny = ty / length, -tx / length
        up, out = 0.0, 0.0
        for j in range(3):
            along[j] = nx * rows[0, j] + ny * rows[1, j]
            up += along[j] * frame[2, j]
            out += along[j] * radial[j]
        found[n, 0], found[n, 1] = x * pinhole[0] + pinhole[2], y * pinhole[1] + pinhole[3]
        found[n, 2], found[n, 3] = nx, ny
        found[n, 4:7] = along
        found[n, 7], found[n, 8] = up * radius * sine, up * radius * cosine
        found[n, 9] = out
    return found
