"""Outlines in a plane (circles, straight edges and slots), and their projection into a raw image.

A curve lies in a face: a plane with an origin and axes u, v, normal (away from the cameras, as z of a part
frame). Only its motion across itself shows in an image, so each sample carries one number per parameter: the
speed of the curve along its own normal. The projecting kernel evaluates the camera models of `projection`
point by point: a fit projects some thousand points a dozen times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from edged.domain.arrays import F64, I64, SIDES, FloatArray
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.kernels.jit import F1, F2, INT, for_kernel, kernel

Kind = Literal["circle", "edge", "slot"]
PLANE_PARAMETERS = 3
"""Height of the plane over the face, and its slopes along u and v."""
MIN_RADIUS_MM = 1e-3  # lower bound, so that no step of a fit leads to a radius of 0


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A plane in the rig frame: origin (3,), axes (3, 3) with rows u, v, normal (right-handed)."""

    origin: FloatArray
    axes: FloatArray

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,); the third axis."""
        return np.asarray(self.axes[2])

    def to_rig(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) of the rig frame for points (N, 2) in the face, or (N, 3) with a height over it."""
        return np.asarray(self.origin + points @ self.axes[: points.shape[-1]])

    def from_rig(self, points_mm: FloatArray) -> FloatArray:
        """Points (N, 3) in the axes of the face: u, v, height."""
        return np.asarray((points_mm - self.origin) @ self.axes.T)

    def flat(self) -> FloatArray:
        """(4, 3) axes u, v, normal and origin, in the form for kernels."""
        flat = np.empty((4, 3))
        flat[:3], flat[3] = self.axes, self.origin
        return flat

    def moved(self, plane: FloatArray) -> Face:
        """The face after a step of height and slopes; its axes turn as little as possible."""
        height, slope_u, slope_v = plane
        u, v, n = self.axes
        normal = n - slope_u * u - slope_v * v
        normal = normal / np.linalg.norm(normal)
        across = u - (u @ normal) * normal
        across = across / np.linalg.norm(across)
        return Face(self.origin + height * n, np.stack([across, np.cross(normal, across), normal]))


SIZES: dict[Kind, int] = {"circle": 3, "edge": 3, "slot": 5}
"""Number of parameters of each kind of curve."""
FREE: dict[Kind, int] = {"circle": 3, "edge": 2, "slot": 5}
"""Number of unknowns of each kind in a fit: that of an edge leaves out its motion along itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One outline in the face.

    parameters : mm and rad. For a circle (x, y, radius); for an edge (x, y, angle): its middle, its direction
    (u to v); for a slot (x, y, angle, length, width): its centre, its long axis, its overall length.
    polarity : +1 if brighter along the normal, -1 if darker, 0 if not known. The normal points outwards; for
    an edge it is the direction turned by 90° from u to v.
    length_mm : of an edge; a fit does not change it.
    height_mm : of its plane along the face's normal; a fit does not change it.
    signs (2, S) : the polarity over each of S equal stretches of the outline, in the left and the right
    image, 0 where it is not to be measured; None: the polarity is that of the whole curve in both.
    break_mm : width of an edge break of which it may be either end; 0: as the images show it.
    """

    name: str
    kind: Kind
    parameters: FloatArray
    polarity: int
    length_mm: float = 0.0  # 0: not an edge
    height_mm: float = 0.0  # 0: in the face
    signs: I64 | None = None
    break_mm: float = 0.0  # 0: as seen

    def signs_at(self, side: int, count: int) -> I64:
        """Polarity (count,) at the samples of `spread`; 0: not known or, with `signs`, not to be measured."""
        if self.signs is None:
            return np.full(count, self.polarity)
        stretch = (np.arange(count) + 0.5) / count * self.signs.shape[1]
        return np.asarray(self.signs[side, stretch.astype(np.int64)])

    def at(self, parameters: FloatArray, polarity: int) -> Curve:
        """The curve with other parameters, (P,) or more of which the first count, and another polarity."""
        own = parameters[: SIZES[self.kind]]
        return Curve(
            self.name,
            self.kind,
            own,
            polarity,
            self.length_mm,
            self.height_mm,
            self.signs,
            self.break_mm,
        )

    @property
    def closed(self) -> bool:
        """Whether the curve is closed."""
        return self.kind != "edge"

    @property
    def direction(self) -> FloatArray:
        """Unit vector (2,) along an edge, or along a slot's long axis."""
        angle = float(self.parameters[2])
        return np.array([math.cos(angle), math.sin(angle)])

    @property
    def perimeter_mm(self) -> float:
        """Length of the outline.

        >>> slot = Curve("s", "slot", np.array([0.0, 0.0, 0.0, 9.0, 4.0]), 1)  # 9 mm long, 4 mm wide
        >>> round(slot.perimeter_mm - (2 * 5 + 4 * math.pi), 9)
        0.0
        """
        if self.kind == "circle":
            return float(2 * math.pi * self.parameters[2])
        if self.kind == "edge":
            return self.length_mm
        length, width = self.parameters[3:]
        return float(2 * (length - width) + math.pi * width)

    @property
    def free(self) -> int:
        """Number of unknowns in a fit."""
        return FREE[self.kind]

    def lift(self) -> FloatArray:
        """(P, free): derivative of the parameters by the unknowns of a fit."""
        if self.kind != "edge":
            return np.eye(len(self.parameters))
        x, y = self.direction
        return np.array([[-y, 0.0], [x, 0.0], [0.0, 1.0]])

    def moved(self, delta: FloatArray) -> Curve | None:
        """The curve after a step of its unknowns; None when its size has vanished."""
        parameters = self.parameters + self.lift() @ delta
        if not np.isfinite(parameters).all() or (parameters[2:][-1] < MIN_RADIUS_MM and self.kind != "edge"):
            return None
        if self.kind == "slot" and parameters[3] < parameters[4]:
            return None
        return replace(self, parameters=parameters)

    def outline(self, share: FloatArray, margin_mm: float = 0.0) -> CurveOutline:
        """Samples at shares (N,) in [0, 1) of the outline; an edge keeps a margin from its ends."""
        if self.kind == "circle":
            points, normals, speed = _circle(self, share)
        elif self.kind == "edge":
            points, normals, speed = _edge(self, share, margin_mm)
        else:
            points, normals, speed = _slot(self, share)
        return CurveOutline(np.column_stack([points, np.full(len(share), self.height_mm)]), normals, speed)

    def spread(self, count: int, margin_mm: float = 0.0) -> CurveOutline:
        """`outline` at a number of evenly spread places."""
        if self.kind != "circle":
            return self.outline((np.arange(count) + 0.5) / count, margin_mm)
        x, y, radius = self.parameters
        normals, speed = _around(count)
        points = np.empty((count, 3))
        points[:, :2] = (x, y) + radius * normals
        points[:, 2] = self.height_mm
        return CurveOutline(points, normals, speed)


class CurveOutline(NamedTuple):
    """Samples of curves: points (N, 3), u, v and height; normals (N, 2) in the face.

    speed (N, F) : motion along the normal by the unknowns of the sample's curve.
    """

    points: F2
    normals: F2
    speed: F2


Samples = tuple[FloatArray, FloatArray, FloatArray]
"""Points (N, 2), normals (N, 2) and speed (N, free), see `CurveOutline`."""


def _circle(curve: Curve, share: FloatArray) -> Samples:
    x, y, radius = curve.parameters
    normals, speed = _at_phase(2 * np.pi * share)
    return (x, y) + radius * normals, normals, speed


def _at_phase(phase: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normals (N, 2) and speed (N, 3) of any circle."""
    normals = np.column_stack([np.cos(phase), np.sin(phase)])
    return normals, np.column_stack([normals, np.ones(len(phase))])


@lru_cache(maxsize=64)  # for a job's few circles at two spacings
def _around(count: int) -> tuple[FloatArray, FloatArray]:
    normals, speed = _at_phase(2 * np.pi * (np.arange(count) + 0.5) / count)
    normals.flags.writeable = speed.flags.writeable = False
    return normals, speed


def _edge(curve: Curve, share: FloatArray, margin_mm: float) -> Samples:
    direction = curve.direction
    along = (share - 0.5) * max(curve.length_mm - 2 * margin_mm, 0.0)
    normal = np.array([-direction[1], direction[0]])
    points = curve.parameters[:2] + along[:, None] * direction
    return points, np.tile(normal, (len(share), 1)), np.column_stack([np.ones(len(share)), along])


def _slot(curve: Curve, share: FloatArray) -> Samples:
    """Samples from the middle of the right end around: arc, upper line, left arc, lower line, arc."""
    x, y, _, length, width = curve.parameters
    half, radius = 0.5 * (length - width), 0.5 * width
    way = share * curve.perimeter_mm
    quarter = 0.5 * np.pi * radius
    first, second = way < quarter, way < quarter + 2 * half
    third, fourth = way < 3 * quarter + 2 * half, way < 3 * quarter + 4 * half
    on_line = (~first & second) | (~third & fourth)
    phase = np.select(
        [first, second, third, fourth],
        [
            way / radius,
            np.full_like(way, 0.5 * np.pi),
            (way - 2 * half) / radius,
            np.full_like(way, 1.5 * np.pi),
        ],
        (way - 4 * half) / radius,
    )
    middle = np.select(
        [first, second, third, fourth],
        [half, half - (way - quarter), -half, -half + (way - 3 * quarter - 2 * half)],
        half,
    )
    normals = np.column_stack([np.cos(phase), np.sin(phase)])
    points = radius * normals
    points[:, 0] += middle
    swing = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    by_length = np.where(on_line, 0.0, 0.5 * np.abs(normals[:, 0]))
    turn = np.stack([curve.direction, [-curve.direction[1], curve.direction[0]]])
    turned = normals @ turn
    return points @ turn + (x, y), turned, np.column_stack([turned, swing, by_length, 0.5 - by_length])


_DIVISION, _BROWN = 0, 1  # lens models, as numbers for the kernel
_NO_MOTION = np.eye(4)  # the rig frame is the left camera's


class ProjectedOutline(NamedTuple):
    """Samples of curves of one face in one raw image.

    pixels (N, 2); normals (N, 2) unit, in the sense of the curves' own normals; gain (N,) : motion along the
    image normal per motion along the curve's own, px/mm; design (N, 3 + F) : derivative of the motion along
    the image normal by the plane's height and slopes, and by the unknowns of the sample's curve. Rows are
    NaN or infinite where the lens cannot show a point.
    """

    pixels: F2
    normals: F2
    gain: F1
    design: F2


class FlatCamera(NamedTuple):
    """A camera for kernels. focal (2,), centre (2,) px; lens (5,), 0 where there is no coefficient.

    model : of the lens.  pose (4, 4) : camera_from_rig.
    """

    focal: F1
    centre: F1
    lens: F1
    model: INT
    pose: F2


@lru_cache(maxsize=8)  # the cell's rig, as calibrated and as corrected by its marks
def flat_cameras(rig: StereoRig) -> tuple[FlatCamera, FlatCamera]:
    """The left and the right camera of a rig."""
    left, right = (
        FlatCamera(
            np.array([camera.fx, camera.fy]),
            np.array([camera.cx, camera.cy]),
            *packed_lens(camera),
            for_kernel(pose, np.float64),
        )
        for camera, pose in (camera_pose(rig, side) for side in SIDES)
    )
    return left, right


def camera_pose(rig: StereoRig, side: str) -> tuple[CameraModel, FloatArray]:
    """A camera and its camera_from_rig (4, 4)."""
    return (rig.left, _NO_MOTION) if side == "left" else (rig.right, rig.right_from_left)


def project_outline(rig: StereoRig, side: str, face: Face, outline: CurveOutline) -> ProjectedOutline:
    """Project samples of the curves of a face into a raw image."""
    plain = CurveOutline._make(for_kernel(field, np.float64) for field in outline)
    return projected(flat_cameras(rig)[SIDES.index(side)], face.flat(), plain)


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
    """Two unit vectors (2, 3) that span the plane with this normal.

    The first is perpendicular to rig x, or to rig y where the normal lies near rig x.
    """
    x, y, z = (float(value) for value in normal)
    # normal x (1, 0, 0), or normal x (0, 1, 0) where that is short
    across = (0.0, z, -y) if abs(x) < 0.9 else (-z, 0.0, x)
    length = math.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)
    u, v, w = across[0] / length, across[1] / length, across[2] / length
    return np.array([[u, v, w], [y * w - z * v, z * u - x * w, x * v - y * u]])


def packed_lens(camera: CameraModel) -> tuple[F64, int]:
    """A camera's lens for `distorted`: coefficients (5,), 0 where there is none, and the model."""
    lens = np.zeros(5)
    lens[: len(camera.distortion)] = camera.distortion
    return lens, _DIVISION if camera.model == "division" else _BROWN


@kernel("UniTuple(f8, 6)(f8, f8, f8[::1], i8)", any_order=True)
def distorted(u: float, v: float, lens: F64, model: int) -> tuple[float, float, float, float, float, float]:
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
    """Fill turned (3,): vector (3,) rotated by a pose (4, 4)."""
    for i in range(3):
        turned[i] = pose[i, 0] * vector[0] + pose[i, 1] * vector[1] + pose[i, 2] * vector[2]


@kernel(
    "ProjectedOutline(FlatCamera, f8[:, ::1], CurveOutline)",
    tuples=(FlatCamera, CurveOutline, ProjectedOutline),
    any_order=True,
)
def projected(camera: FlatCamera, face: F64, outline: CurveOutline) -> ProjectedOutline:
    """Project samples of the curves of a face (4, 3), see `Face.flat`, into a camera's raw image."""
    count, free = outline.speed.shape
    design = np.empty((count, 3 + free))
    seen = ProjectedOutline(np.empty((count, 2)), np.empty((count, 2)), np.empty(count), design)
    pose, focal, centre = camera.pose, camera.focal, camera.centre
    axes = np.empty((4, 3))
    for i in range(4):
        _turn(pose, face[i], axes[i])
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
        x, y, xu, xv, yu, yv = distorted(u, v, camera.lens, camera.model)
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
        # a slope lifts points beside the origin, and moves points above the plane sideways
        design[n, 1] = up * px - pz * (u0 * du + u1 * dv + u2 * dw)
        design[n, 2] = up * py - pz * (v0 * du + v1 * dv + v2 * dw)
        for f in range(outline.speed.shape[1]):
            design[n, 3 + f] = gain * outline.speed[n, f]
    return seen


@kernel("f8[::1](f8[:, ::1], f8[:, ::1], i8[::1])")
def curvatures(pixels: F64, normals: F64, starts: I64) -> F64:
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
