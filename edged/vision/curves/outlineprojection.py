"""Outlines through lens and pose into a raw image, with their derivatives, as one kernel.

The camera models and their derivatives are those of `projection`, point by point instead of array by array:
a fit projects some thousand points a dozen times.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.curves.outlines import Curve, CurveOutline, Face
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.kernels.jit import F1, F2, INT, for_kernel, kernel

F64 = npt.NDArray[np.float64]

_DIVISION, _BROWN = 0, 1
_NO_MOTION = np.eye(4)


class ProjectedOutline(NamedTuple):
    """Samples of curves of one face in one raw image.

    pixels (N, 2); normals (N, 2) unit, along the curves' own normals; gain (N,) : motion along the image
    normal by motion along the curve's own, px/mm; design (N, 3 + F) : motion along the image normal by the
    plane's height and slopes, and by the unknowns of the sample's curve. Rows are NaN or infinite where the
    lens cannot show a point.
    """

    pixels: F2
    normals: F2
    gain: F1
    design: F2


class _View(NamedTuple):
    """A camera at a face. focal (2,), centre (2,) px; lens (5,), 0 where there is no coefficient.

    model : of the lens.  pose (4, 4) : camera_from_rig.  face (4, 3) : axes u, v, n and origin, rig frame.
    """

    focal: F1
    centre: F1
    lens: F1
    model: INT
    pose: F2
    face: F2


def camera_pose(rig: StereoRig, side: str) -> tuple[CameraModel, FloatArray]:
    """A camera and its camera_from_rig (4, 4)."""
    return (rig.left, _NO_MOTION) if side == "left" else (rig.right, rig.right_from_left)


def project_outline(rig: StereoRig, side: str, face: Face, outline: CurveOutline) -> ProjectedOutline:
    """Project samples of the curves of a face into a raw image."""
    camera, camera_from_rig = camera_pose(rig, side)
    lens = np.zeros(5)
    lens[: len(camera.distortion)] = camera.distortion
    view = _View(
        np.array([camera.fx, camera.fy]),
        np.array([camera.cx, camera.cy]),
        lens,
        _DIVISION if camera.model == "division" else _BROWN,
        for_kernel(camera_from_rig, np.float64),
        for_kernel(np.vstack([face.axes, face.origin]), np.float64),
    )
    count, free = outline.speed.shape
    seen = ProjectedOutline(
        np.empty((count, 2)), np.empty((count, 2)), np.empty(count), np.empty((count, 3 + free))
    )
    _project_outline(view, CurveOutline._make(for_kernel(field, np.float64) for field in outline), seen)
    return seen


def project_circle(
    rig: StereoRig, side: str, centre: FloatArray, normal: FloatArray, radius: float, phase: FloatArray
) -> ProjectedOutline:
    """Project the points at angles `phase` (N,) of a circle of the rig frame into a raw image.

    centre, normal (3,).  The angles count from the first of `circle_axes` to the second.
    """
    face = Face(np.asarray(centre), np.vstack([circle_axes(normal), normal]))
    circle = Curve("", "circle", np.array([0.0, 0.0, radius]), 0)
    return project_outline(rig, side, face, circle.outline(phase / (2 * np.pi)))


def circle_axes(normal: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) that span the plane with this normal; the first lies across rig x."""
    x, y, z = (float(value) for value in normal)
    # normal x (1, 0, 0), or normal x (0, 1, 0) where that is short
    across = (0.0, z, -y) if abs(x) < 0.9 else (-z, 0.0, x)
    length = math.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)
    u, v, w = across[0] / length, across[1] / length, across[2] / length
    return np.array([[u, v, w], [y * w - z * v, z * u - x * w, x * v - y * u]])


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
    "void(_View, CurveOutline, ProjectedOutline)",
    tuples=(_View, CurveOutline, ProjectedOutline),
    any_order=True,
)
def _project_outline(view: _View, outline: CurveOutline, seen: ProjectedOutline) -> None:
    """Fill what is seen; in the camera's frame within."""
    pose, focal, centre, design = view.pose, view.focal, view.centre, seen.design
    axes = np.empty((4, 3))
    for i in range(4):
        _turn(pose, view.face[i], axes[i])
    for i in range(3):
        axes[3, i] += pose[i, 3]
    u0, u1, u2 = axes[0, 0], axes[0, 1], axes[0, 2]
    v0, v1, v2 = axes[1, 0], axes[1, 1], axes[1, 2]
    n0, n1, n2 = axes[2, 0], axes[2, 1], axes[2, 2]
    for n in range(len(outline.points)):
        px, py, pz = outline.points[n, 0], outline.points[n, 1], outline.points[n, 2]
        nx, ny = outline.normals[n, 0], outline.normals[n, 1]
        nearness = 1.0 / (axes[3, 2] + px * u2 + py * v2 + pz * n2)
        u = (axes[3, 0] + px * u0 + py * v0 + pz * n0) * nearness
        v = (axes[3, 1] + px * u1 + py * v1 + pz * n1) * nearness
        x, y, xu, xv, yu, yv = _distort(u, v, view.lens, view.model)
        # d pixel / d u and v, then along the curve and across it
        xu, xv = focal[0] * xu * nearness, focal[0] * xv * nearness
        yu, yv = focal[1] * yu * nearness, focal[1] * yv * nearness
        out0, out1, out2 = nx * u0 + ny * v0, nx * u1 + ny * v1, nx * u2 + ny * v2
        along0, along1, along2 = nx * v0 - ny * u0, nx * v1 - ny * u1, nx * v2 - ny * u2
        along_u, along_v = along0 - u * along2, along1 - v * along2
        out_u, out_v = out0 - u * out2, out1 - v * out2
        tx, ty = xu * along_u + xv * along_v, yu * along_u + yv * along_v
        outward = ty * (xu * out_u + xv * out_v) - tx * (yu * out_u + yv * out_v)
        shorten = (-1.0 if outward < 0 else 1.0) / np.sqrt(tx * tx + ty * ty)
        normal_x, normal_y = ty * shorten, -tx * shorten
        seen.pixels[n, 0], seen.pixels[n, 1] = x * focal[0] + centre[0], y * focal[1] + centre[1]
        seen.normals[n, 0], seen.normals[n, 1] = normal_x, normal_y
        du, dv = normal_x * xu + normal_y * yu, normal_x * xv + normal_y * yv
        dw = -(u * du + v * dv)
        up = n0 * du + n1 * dv + n2 * dw
        gain = out0 * du + out1 * dv + out2 * dw
        seen.gain[n] = gain
        design[n, 0] = up
        # a slope lifts what lies beside the origin, and moves what stands over the plane sideways
        design[n, 1] = up * px - pz * (u0 * du + u1 * dv + u2 * dw)
        design[n, 2] = up * py - pz * (v0 * du + v1 * dv + v2 * dw)
        for f in range(outline.speed.shape[1]):
            design[n, 3 + f] = gain * outline.speed[n, f]


@kernel("f8[::1](f8[:, ::1], f8[:, ::1], i8[::1])")
def curvatures(pixels: F64, normals: F64, starts: npt.NDArray[np.int64]) -> F64:
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
