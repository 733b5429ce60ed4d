"""Circles through lens and pose into a raw image, with their derivatives, as one kernel.

The camera models and their derivatives are those of `projection`, point by point instead of array by array:
a fit projects some thousand points a dozen times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.kernels.jit import for_kernel, kernel

F64 = npt.NDArray[np.float64]

_DIVISION, _BROWN = 0, 1


def project_samples(
    camera: CameraModel,
    camera_from_rig: FloatArray,
    frame: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    index: npt.NDArray[np.int64],
    phase: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels, normals and derivatives of the points at angles `phase` (N,) of circles in one plane.

    frame (3, 3) : rows u, v, normal of the plane, rig frame.  centres (K, 3), radii (K,) : of the circles;
    index (N,) : which of them a point lies on.  camera_from_rig (4, 4).
    Returns pixels (N, 2); normals (N, 2), unit and outwards; jacobian (N, 6): derivative of the curve along
    its normal by centre (3), tilts (2), radius. Rows are NaN or infinite where the lens cannot show a point.
    """
    count = len(phase)
    pixels, normals, jacobian = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 6))
    lens = np.zeros(5)
    lens[: len(camera.distortion)] = camera.distortion
    _project_samples(
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        lens,
        _DIVISION if camera.model == "division" else _BROWN,
        for_kernel(camera_from_rig, np.float64),
        for_kernel(frame, np.float64),
        for_kernel(centres, np.float64),
        for_kernel(radii, np.float64),
        for_kernel(index, np.int64),
        for_kernel(phase, np.float64),
        pixels,
        normals,
        jacobian,
    )
    return pixels, normals, jacobian


@kernel("UniTuple(f8, 6)(f8, f8, f8[::1], i8)", any_order=True)
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


@kernel("void(f8[:, ::1], f8[::1], f8[::1])")
def _turn(pose: F64, vector: F64, turned: F64) -> None:
    """The rotation of a pose (4, 4) on a vector."""
    for i in range(3):
        turned[i] = pose[i, 0] * vector[0] + pose[i, 1] * vector[1] + pose[i, 2] * vector[2]


@kernel(
    "void(f8[::1], f8[::1], i8, f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8[::1], f8[::1],"
    " f8[:, ::1], f8[:, ::1], f8[:, ::1])",
    any_order=True,
)
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
    pixels: F64,
    normals: F64,
    jacobian: F64,
) -> None:
    """Fill the last three; all is reckoned in the camera's frame, but the derivatives by the centre."""
    axes, middle = np.empty((3, 3)), np.empty((len(radii), 3))
    for i in range(3):
        _turn(pose, frame[i], axes[i])
    for k in range(len(radii)):
        _turn(pose, centres[k], middle[k])
        for i in range(3):
            middle[k, i] += pose[i, 3]
    u0, u1, u2 = axes[0, 0], axes[0, 1], axes[0, 2]
    v0, v1, v2 = axes[1, 0], axes[1, 1], axes[1, 2]
    for n in range(len(phase)):
        cosine, sine = np.cos(phase[n]), np.sin(phase[n])
        radius, place = radii[index[n]], middle[index[n]]
        radial0, radial1, radial2 = cosine * u0 + sine * v0, cosine * u1 + sine * v1, cosine * u2 + sine * v2
        across0, across1, across2 = cosine * v0 - sine * u0, cosine * v1 - sine * u1, cosine * v2 - sine * u2
        nearness = 1.0 / (place[2] + radius * radial2)
        u, v = (place[0] + radius * radial0) * nearness, (place[1] + radius * radial1) * nearness
        x, y, xu, xv, yu, yv = _distort(u, v, lens, model)
        # d pixel / d u and v, then along the circle and outwards
        xu, xv = pinhole[0] * xu * nearness, pinhole[0] * xv * nearness
        yu, yv = pinhole[1] * yu * nearness, pinhole[1] * yv * nearness
        along_u, along_v = across0 - u * across2, across1 - v * across2
        out_u, out_v = radial0 - u * radial2, radial1 - v * radial2
        tx, ty = xu * along_u + xv * along_v, yu * along_u + yv * along_v
        outward = ty * (xu * out_u + xv * out_v) - tx * (yu * out_u + yv * out_v)
        shorten = (-1.0 if outward < 0 else 1.0) / np.sqrt(tx * tx + ty * ty)
        nx, ny = ty * shorten, -tx * shorten
        pixels[n, 0], pixels[n, 1] = x * pinhole[0] + pinhole[2], y * pinhole[1] + pinhole[3]
        normals[n, 0], normals[n, 1] = nx, ny
        du, dv = nx * xu + ny * yu, nx * xv + ny * yv
        dw = -(u * du + v * dv)
        for i in range(3):
            jacobian[n, i] = pose[0, i] * du + pose[1, i] * dv + pose[2, i] * dw
        up = (axes[2, 0] * du + axes[2, 1] * dv + axes[2, 2] * dw) * radius
        jacobian[n, 3], jacobian[n, 4] = up * sine, up * cosine
        jacobian[n, 5] = radial0 * du + radial1 * dv + radial2 * dw


@kernel("f8[::1](f8[:, ::1], f8[:, ::1], i8[::1])")
def bends(pixels: F64, normals: F64, starts: npt.NDArray[np.int64]) -> F64:
    """Curvature (N,), 1 / px, of closed curves in the image from their samples and unit normals (N, 2).

    starts (K + 1,) : where the samples of each curve begin.
    """
    found = np.empty(len(pixels))
    for k in range(len(starts) - 1):
        first, last = starts[k], starts[k + 1] - 1
        for n in range(first, last + 1):
            a, b = n - 1 if n > first else last, n + 1 if n < last else first
            turn = np.arcsin(
                min(max(normals[a, 0] * normals[b, 1] - normals[a, 1] * normals[b, 0], -1.0), 1.0)
            )
            x, y = pixels[b, 0] - pixels[a, 0], pixels[b, 1] - pixels[a, 1]
            found[n] = abs(turn) / max(np.sqrt(x * x + y * y), 1e-9)
    return found


_NO_MOTION = np.eye(4)


def circle_axes(normal: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) that span the plane with this normal; the first lies across rig x."""
    x, y, z = (float(value) for value in normal)
    # normal x (1, 0, 0), or normal x (0, 1, 0) where that is short
    across = (0.0, z, -y) if abs(x) < 0.9 else (-z, 0.0, x)
    length = math.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)
    u, v, w = across[0] / length, across[1] / length, across[2] / length
    return np.array([[u, v, w], [y * w - z * v, z * u - x * w, x * v - y * u]])


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedCircle:
    """Samples of circles in one raw image.

    pixels (N, 2), normals (N, 2) unit and outwards, jacobian (N, 6): derivative of the curve along its
    normal by (centre, tilt u, tilt v, radius).
    """

    pixels: FloatArray
    normals: FloatArray
    jacobian: FloatArray


def project_circle(
    rig: StereoRig, side: str, centre: FloatArray, normal: FloatArray, radius: float, phase: FloatArray
) -> ProjectedCircle:
    """Project the points at angles `phase` (N,) of a circle of the rig frame into a raw image.

    centre, normal (3,).
    """
    frame = np.vstack([circle_axes(normal), normal])
    which = np.zeros(len(phase), np.int64)
    return project_circles(rig, side, frame, np.asarray(centre)[None], np.array([radius]), which, phase)


def project_circles(
    rig: StereoRig,
    side: str,
    frame: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    index: npt.NDArray[np.int64],
    phase: FloatArray,
) -> ProjectedCircle:
    """`project_circle` for circles of one plane; the arguments are those of `project_samples`."""
    camera = rig.left if side == "left" else rig.right
    pose = _NO_MOTION if side == "left" else rig.right_from_left
    return ProjectedCircle(*project_samples(camera, pose, frame, centres, radii, index, phase))
