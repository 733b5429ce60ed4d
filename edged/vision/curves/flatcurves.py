"""Curves of one face as flat arrays: kernels that sample them, and move them by a step of a fit.

The formulas are those of `Curve` and `Face`, sample by sample: a fit samples and moves its curves half a
dozen times, and for a dozen numbers a call of numpy takes longer than the arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64
from edged.vision.curves.outlines import (
    MIN_RADIUS_MM,
    PLANE_PARAMETERS,
    SIZES,
    Curve,
    CurveOutline,
    FlatCamera,
    distorted,
)
from edged.vision.curves.params import FIT
from edged.vision.kernels.jit import F1, F2, FLOAT, I1, I2, INT, kernel

RIGID_PARAMETERS = 4
"""Parameters of a rigid part besides its plane: shift along u and v, turn, growth."""
CIRCLE, EDGE, SLOT = 0, 1, 2  # kinds of curves, as numbers for kernels
NUMBERS = {"circle": CIRCLE, "edge": EDGE, "slot": SLOT}
SIZE_OF_ANY = 5  # parameters of a slot, which has most

# numba freezes globals when it compiles: kernels read these by name
PROBE_MM = FIT.probe_mm
MARGIN_PX = FIT.margin_px
LEAST_AROUND_PX = 2 * math.pi * FIT.min_radius_px  # least circumference of a circle
MIN_LENGTH_PX = FIT.min_length_px
MAX_LENGTH_PX = FIT.max_length_px
MIN_SAMPLES_AROUND = FIT.min_samples_around
FEWEST_SAMPLES = FIT.min_samples
MOST_SAMPLES = FIT.max_samples
GROWTH_SIGMA = FIT.growth_sigma
MAX_SLOPE = FIT.max_slope
MAX_RISE = FIT.max_rise
RUNAWAY = FIT.runaway
_AT_ONCE = 64  # points around a circle computed each from the one before: few, as rounding adds up


class FlatCurves(NamedTuple):
    """K curves of a face as arrays, see `Curve`.

    kinds (K,) : from `NUMBERS`; parameters (K, 5), 0 where a kind has fewer; length_mm, height_mm (K,),
    polarity (K,); signs (2, S) : of the stretches of all curves, each curve's beginning at first (K + 1,).
    """

    kinds: I1
    parameters: F2
    length_mm: F1
    height_mm: F1
    polarity: I1
    signs: I2
    first: I1


class Freedom(NamedTuple):
    """Quantities that a fit may change: the plane's normal, circles' radii (0: held).

    rigid_mm : the curves are those of one rigid part, see `fit_plane`; NaN: each curve moves independently.
    """

    normal: INT
    radius: INT
    rigid_mm: FLOAT


class CurvesAt(NamedTuple):
    """Curves of a face (4, 3), see `Face.flat`, with both cameras, and the freedom of a fit."""

    left: FlatCamera
    right: FlatCamera
    face: F2
    curves: FlatCurves
    freedom: Freedom


class LaidCurves(NamedTuple):
    """Samples of curves, each curve's beginning at starts (K + 1,)."""

    outline: CurveOutline
    starts: I1


TUPLES = (FlatCamera, CurveOutline, FlatCurves, Freedom, CurvesAt, LaidCurves)
"""Tuples for the signatures of kernels that take them."""


def flattened(curves: Sequence[Curve]) -> FlatCurves:
    """The curves as arrays for kernels."""
    parameters = np.zeros((len(curves), SIZE_OF_ANY))
    for row, curve in zip(parameters, curves, strict=True):
        row[: SIZES[curve.kind]] = curve.parameters
    kinds, polarity = np.array([(NUMBERS[curve.kind], curve.polarity) for curve in curves], np.int64).T.copy()
    length_mm, height_mm = np.array([(curve.length_mm, curve.height_mm) for curve in curves]).T.copy()
    parts = [curve.signs for curve in curves if curve.signs is not None]
    signs, first = np.zeros((2, 0), np.int64), np.zeros(len(curves) + 1, np.int64)
    if parts:
        signs = np.concatenate(parts, axis=1)
        first[1:] = np.cumsum([0 if curve.signs is None else curve.signs.shape[1] for curve in curves])
    return FlatCurves(kinds, parameters, length_mm, height_mm, polarity, signs, first)


@kernel("i8(i8)")
def free_of(kind: int) -> int:
    """Number of unknowns of a curve; that of an edge leaves out its motion along itself."""
    return 2 if kind == EDGE else (3 if kind == CIRCLE else SIZE_OF_ANY)


@kernel()
def shared_of(freedom: Freedom) -> int:
    """Number of unknowns that all curves share, which come first."""
    return PLANE_PARAMETERS + (0 if np.isnan(freedom.rigid_mm) else RIGID_PARAMETERS)


@kernel()
def most_free(curves: FlatCurves) -> int:
    """Largest number of unknowns of any of the curves."""
    most = 0
    for k in range(len(curves.kinds)):
        most = max(most, free_of(curves.kinds[k]))
    return most


@kernel()
def pixel_of(camera: FlatCamera, x: float, y: float, z: float) -> tuple[float, float]:
    """Raw pixel of a point in the camera's frame."""
    place = distorted(x / z, y / z, camera.lens, camera.model)
    return place[0] * camera.focal[0] + camera.centre[0], place[1] * camera.focal[1] + camera.centre[1]


@kernel()
def _px_per_mm(at: CurvesAt, k: int) -> float:
    """Scale of the left image at curve k; NaN behind the camera."""
    face, middle = at.face, np.empty(3)
    x, y, height = at.curves.parameters[k, 0], at.curves.parameters[k, 1], at.curves.height_mm[k]
    for i in range(3):
        middle[i] = face[3, i] + (x * face[0, i] + y * face[1, i] + height * face[2, i])
    if not middle[2] > 0.0:
        return np.nan
    px, py = pixel_of(at.left, middle[0], middle[1], middle[2])
    scale = 0.0
    for axis in range(2):
        u, v, w = PROBE_MM * face[axis, 0], PROBE_MM * face[axis, 1], PROBE_MM * face[axis, 2]
        qx, qy = pixel_of(at.left, middle[0] + u, middle[1] + v, middle[2] + w)
        scale += 0.5 * np.sqrt((qx - px) ** 2 + (qy - py) ** 2)
    return float(scale / PROBE_MM)


@kernel()
def _perimeter(curves: FlatCurves, k: int) -> float:
    parameters = curves.parameters[k]
    if curves.kinds[k] == CIRCLE:
        return float(2.0 * np.pi * parameters[2])
    if curves.kinds[k] == EDGE:
        return float(curves.length_mm[k])
    return float(2.0 * (parameters[3] - parameters[4]) + np.pi * parameters[4])


@kernel("void(f8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])")
def _lay_circle(parameters: F64, points: F64, normals: F64, speed: F64) -> None:
    x, y, radius = parameters[0], parameters[1], parameters[2]
    count = len(points)
    angle = 2.0 * np.pi / count
    step_x, step_y = np.cos(angle), np.sin(angle)
    cosine, sine = 1.0, 0.0
    for n in range(count):
        if n % _AT_ONCE == 0:
            cosine, sine = np.cos((n + 0.5) * angle), np.sin((n + 0.5) * angle)
        else:
            cosine, sine = cosine * step_x - sine * step_y, sine * step_x + cosine * step_y
        points[n, 0], points[n, 1] = x + radius * cosine, y + radius * sine
        normals[n, 0], normals[n, 1] = cosine, sine
        speed[n, 0], speed[n, 1], speed[n, 2] = cosine, sine, 1.0


@kernel("void(f8[::1], f8, f8[:, ::1], f8[:, ::1], f8[:, ::1])")
def _lay_edge(parameters: F64, length: float, points: F64, normals: F64, speed: F64) -> None:
    cosine, sine = np.cos(parameters[2]), np.sin(parameters[2])
    for n in range(len(points)):
        along = ((n + 0.5) / len(points) - 0.5) * max(length, 0.0)
        points[n, 0], points[n, 1] = parameters[0] + along * cosine, parameters[1] + along * sine
        normals[n, 0], normals[n, 1] = -sine, cosine
        speed[n, 0], speed[n, 1] = 1.0, along


@kernel("void(f8[::1], f8, f8[:, ::1], f8[:, ::1], f8[:, ::1])")
def _lay_slot(parameters: F64, perimeter: float, points: F64, normals: F64, speed: F64) -> None:
    """Sample from the middle of the right end around: arc, upper line, left arc, lower line, arc."""
    cosine, sine = np.cos(parameters[2]), np.sin(parameters[2])
    half, radius = 0.5 * (parameters[3] - parameters[4]), 0.5 * parameters[4]
    quarter = 0.5 * np.pi * radius
    for n in range(len(points)):
        way = (n + 0.5) / len(points) * perimeter
        straight = False
        if way < quarter:
            phase, middle = way / radius, half
        elif way < quarter + 2.0 * half:
            phase, middle, straight = 0.5 * np.pi, half - (way - quarter), True
        elif way < 3.0 * quarter + 2.0 * half:
            phase, middle = (way - 2.0 * half) / radius, -half
        elif way < 3.0 * quarter + 4.0 * half:
            phase, middle, straight = 1.5 * np.pi, -half + (way - 3.0 * quarter - 2.0 * half), True
        else:
            phase, middle = (way - 4.0 * half) / radius, half
        a, b = np.cos(phase), np.sin(phase)
        px, py = radius * a + middle, radius * b
        points[n, 0] = px * cosine - py * sine + parameters[0]
        points[n, 1] = px * sine + py * cosine + parameters[1]
        normals[n, 0], normals[n, 1] = a * cosine - b * sine, a * sine + b * cosine
        by_length = 0.0 if straight else 0.5 * abs(a)
        speed[n, 0], speed[n, 1], speed[n, 2] = normals[n, 0], normals[n, 1], px * b - py * a
        speed[n, 3], speed[n, 4] = by_length, 0.5 - by_length


@kernel("LaidCurves(CurvesAt, f8)", tuples=TUPLES)
def lay(at: CurvesAt, spacing_px: float) -> LaidCurves:
    """Samples of all curves with this spacing in the left image; a rigid part's unknowns come first in speed.

    There are none at all if a curve lies behind the cameras, or has a size that no image can show.
    """
    curves, rigid_mm = at.curves, at.freedom.rigid_mm
    count, common = len(curves.kinds), shared_of(at.freedom) - PLANE_PARAMETERS
    starts, margins = np.zeros(count + 1, np.int64), np.empty(count)
    for k in range(count):
        scale, closed = _px_per_mm(at, k), curves.kinds[k] != EDGE
        size_px = _perimeter(curves, k) * scale - (0.0 if closed else 2.0 * MARGIN_PX)
        least_px = LEAST_AROUND_PX if curves.kinds[k] == CIRCLE else MIN_LENGTH_PX
        if not least_px < size_px < MAX_LENGTH_PX:  # False for NaN
            starts[:] = 0
            break
        fewest = MIN_SAMPLES_AROUND if closed else FEWEST_SAMPLES
        starts[k + 1] = starts[k] + min(max(int(size_px / spacing_px), fewest), MOST_SAMPLES)
        margins[k] = MARGIN_PX / scale
    total = starts[count]
    points, normals = np.empty((total, 3)), np.empty((total, 2))
    speed, own = np.zeros((total, common + most_free(curves))), np.zeros((total, SIZE_OF_ANY))
    for k in range(count if total > 0 else 0):
        a, b, parameters = starts[k], starts[k + 1], curves.parameters[k]
        if curves.kinds[k] == CIRCLE:
            _lay_circle(parameters, points[a:b], normals[a:b], own[a:b])
        elif curves.kinds[k] == EDGE:
            length = curves.length_mm[k] - 2.0 * margins[k]
            _lay_edge(parameters, length, points[a:b], normals[a:b], own[a:b])
        else:
            _lay_slot(parameters, _perimeter(curves, k), points[a:b], normals[a:b], own[a:b])
        for n in range(a, b):
            points[n, 2] = curves.height_mm[k]
            for f in range(free_of(curves.kinds[k])):
                speed[n, common + f] = own[n, f]
    for n in range(total if common else 0):
        for f in range(common, speed.shape[1]):
            speed[n, f] *= rigid_mm
        x, y, out_x, out_y = points[n, 0], points[n, 1], normals[n, 0], normals[n, 1]
        speed[n, 0], speed[n, 1] = out_x, out_y
        speed[n, 2] = x * out_y - y * out_x
        speed[n, 3] = GROWTH_SIGMA * (x * out_x + y * out_y)
    return LaidCurves(CurveOutline(points, normals, speed), starts)


@kernel("void(f8[:, ::1], f8[::1], f8[:, ::1])")
def _move_face(face: F64, plane: F64, moved: F64) -> None:
    """Fill moved (4, 3), as `Face.moved`: the axes turn as little as possible."""
    long, short, along = 0.0, 0.0, 0.0
    for i in range(3):
        moved[2, i] = face[2, i] - plane[1] * face[0, i] - plane[2] * face[1, i]
        moved[3, i] = face[3, i] + plane[0] * face[2, i]
        long += moved[2, i] ** 2
    for i in range(3):
        moved[2, i] /= np.sqrt(long)
        along += face[0, i] * moved[2, i]
    for i in range(3):
        moved[0, i] = face[0, i] - along * moved[2, i]
        short += moved[0, i] ** 2
    for i in range(3):
        moved[0, i] /= np.sqrt(short)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        moved[1, i] = moved[2, j] * moved[0, k] - moved[2, k] * moved[0, j]


@kernel("b1(i8, f8[::1], f8[::1], f8[::1])")
def _move_curve(kind: int, parameters: F64, delta: F64, moved: F64) -> bool:
    """Fill moved (5,), as `Curve.moved`; False if the curve has run away or its size has vanished."""
    free, size = free_of(kind), 3 if kind != SLOT else SIZE_OF_ANY
    moved[:] = parameters
    if kind == EDGE:
        moved[0] -= np.sin(parameters[2]) * delta[0]
        moved[1] += np.cos(parameters[2]) * delta[0]
        moved[2] += delta[1]
    else:
        for f in range(free):
            moved[f] += delta[f]
    for i in range(size):
        if not np.isfinite(moved[i]):
            return False
    if kind == CIRCLE:
        for f in range(free):
            if abs(delta[f]) >= RUNAWAY * parameters[2]:
                return False
    if kind != EDGE and moved[size - 1] < MIN_RADIUS_MM:
        return False
    return not (kind == SLOT and moved[3] < moved[4])


@kernel("b1(CurvesAt, f8[::1], f8[:, ::1], f8[:, ::1])", tuples=TUPLES)
def move(at: CurvesAt, delta: F64, face: F64, parameters: F64) -> bool:
    """Fill face (4, 3) and parameters (K, 5) after a step of the unknowns; False when the fit has run away.

    One of several curves that would run away stays where it is. In a rigid part all curves stay, and the face
    moves with the part.
    """
    curves, freedom = at.curves, at.freedom
    for i in range(len(delta)):
        if not np.isfinite(delta[i]):
            return False
    if max(abs(delta[1]), abs(delta[2])) > MAX_SLOPE or abs(delta[0]) > MAX_RISE * abs(at.face[3, 2]):
        return False
    _move_face(at.face, delta[:PLANE_PARAMETERS], face)
    parameters[:] = curves.parameters
    first = shared_of(freedom)
    if first > PLANE_PARAMETERS:
        cosine, sine = np.cos(delta[5]), np.sin(delta[5])
        for i in range(3):
            u, v = face[0, i], face[1, i]
            face[3, i] += delta[3] * u + delta[4] * v
            face[0, i], face[1, i] = cosine * u + sine * v, cosine * v - sine * u
        return True
    for k in range(len(curves.kinds)):
        free = free_of(curves.kinds[k])
        if not _move_curve(curves.kinds[k], curves.parameters[k], delta[first : first + free], parameters[k]):
            if len(curves.kinds) == 1:
                return False
            parameters[k] = curves.parameters[k]
        first += free
    return True
