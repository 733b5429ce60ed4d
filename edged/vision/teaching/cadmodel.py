"""A part's CAD model, and the curves of it that two cameras can measure: circles and straight edges.

A model is a triangulated boundary with the face that each triangle belongs to and, for each face that is a
plane, a cylinder or a cone, its exact parameters. Two such faces meet in a curve that is as exact: the
triangles only show that they meet, and over which stretch.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.vision.geometry.rigid import unit
from edged.vision.part.body import all_sides, neighbours
from edged.vision.teaching.params import CAD

PARALLEL = 1e-6  # sine: parallel to rounding


@dataclass(frozen=True, slots=True, eq=False)
class FlatSurface:
    """A plane through a point (3,) with its normal (3,), of either sign."""

    origin_mm: FloatArray
    normal: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RoundSurface:
    """A cylinder or a cone: radius_mm at origin_mm (3,), growing by slope for each mm along axis (3,)."""

    origin_mm: FloatArray
    axis: FloatArray
    radius_mm: float
    slope: float


Surface = FlatSurface | RoundSurface


@dataclass(frozen=True, slots=True, eq=False)
class CadModel:
    """One solid in the frame of its file.

    points_mm (N, 3).  triangles (M, 3) : counter-clockwise seen from outside.  face_of (M,) : number of each
    triangle's face.  surfaces : of each face; None where it is neither plane, cylinder nor cone; empty where
    nothing but triangles is known.
    """

    points_mm: FloatArray
    triangles: I64
    face_of: I64
    surfaces: tuple[Surface | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ModelCircle:
    """A circle in which a face meets a round wall.

    centre_mm (3,) : model frame.  hole : material is outside of it.  span : share of the whole circle.
    sigma_mm : of the radius, if the model has only chords of the circle.
    """

    centre_mm: FloatArray
    radius_mm: float
    hole: bool
    span: float
    sigma_mm: float = 0.0

    @property
    def words(self) -> str:
        """Description for messages."""
        place = ", ".join(f"{value:.3f}" for value in self.centre_mm)
        return f"the {'hole' if self.hole else 'boss'} of radius {self.radius_mm:.3f} mm at ({place})"


@dataclass(frozen=True, slots=True, eq=False)
class ModelEdge:
    """A straight edge between two points (3,) of the model frame.  away (3,) : level, out of the material."""

    start_mm: FloatArray
    end_mm: FloatArray
    away: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ModelCurves:
    """Sharp, level outer edges of a model that are visible from direction up (3,)."""

    up: FloatArray
    circles: tuple[ModelCircle, ...]
    edges: tuple[ModelEdge, ...]
    model: CadModel


def curves_towards(model: CadModel, up: FloatArray) -> ModelCurves:
    """Level circles and straight edges of a model that are visible from direction up (3,) of its frame.

    model : with its faces; for bare triangles use `facets.faceted_curves`.

    Inner edges, where a wall stands on a face, are left out: their contrast is shading.
    """
    up = unit(np.asarray(up, np.float64))
    corners, normals = triangle_normals(model)
    circles: list[ModelCircle] = []
    edges: list[ModelEdge] = []
    for meeting in _meetings(model):
        sides = [model.surfaces[face] for face in meeting.faces]
        looks = [float(normals[index].mean(axis=0) @ up) for index in meeting.beside]
        if max(looks) < CAD.looks_up or not _is_outer(meeting, corners, normals):
            continue
        first, second = sides
        if isinstance(first, FlatSurface) and isinstance(second, FlatSurface):
            edges += _edges(first, second, meeting, normals, up)
        elif first is not None and second is not None:
            circle = _circle(first, second, meeting, normals, up)
            circles += [] if circle is None else [circle]
    return ModelCurves(up, merged_circles(circles), tuple(edges), model)


@dataclass(frozen=True, slots=True, eq=False)
class _Meeting:
    """Two faces that meet in segments (K, 2, 3).  beside (2, K) : triangles of each face at the segments."""

    faces: tuple[int, int]
    segments: FloatArray
    beside: I64


def triangle_normals(model: CadModel) -> tuple[FloatArray, FloatArray]:
    """Corners (M, 3, 3) of the triangles, and their normals (M, 3), outwards."""
    corners = model.points_mm[model.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    volume = float(np.einsum("ij,ij->", corners[:, 0], normals))
    return corners, np.asarray(normals / np.maximum(length, 1e-300) * (1.0 if volume >= 0 else -1.0))


def _welding(points_mm: FloatArray) -> tuple[I64, I64]:
    """Distinct points among (N, 3), and the index of each point's distinct one (N,)."""
    keys = np.rint(points_mm / CAD.weld_mm).astype(np.int64)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def welded(corners_mm: FloatArray) -> tuple[FloatArray, I64]:
    """Points (N, 3) and triangles (M, 3) of corners (K, 3, 3), without triangles that have no area."""
    points = corners_mm.reshape(-1, 3)
    first, number = _welding(points)
    triangles = number.reshape(-1, 3)
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return points[first], triangles[whole]


def open_sides(triangles: I64) -> tuple[int, int]:
    """Number of sides of triangles (M, 3) that not exactly two share, and number of connected bodies."""
    _, _, _, count = all_sides(triangles)
    label = np.arange(triangles.max() + 1)
    while True:  # spread the lowest label within each body; its reach doubles each time
        least = label[triangles].min(axis=1)
        lower = label.copy()
        for corner in range(3):
            np.minimum.at(lower, triangles[:, corner], least)
            np.minimum.at(lower, label[triangles[:, corner]], least)
        lower = lower[lower]
        if np.array_equal(lower, label):
            return int(count[count != 2].sum()), len(np.unique(label[triangles[:, 0]]))
        label = lower


def _meetings(model: CadModel) -> Iterator[_Meeting]:
    """Yield each pair of faces that share sides of triangles."""
    first, number = _welding(model.points_mm)
    sides, pairs = neighbours(number[model.triangles])
    faces = model.face_of[pairs]
    swapped = faces[:, 0] > faces[:, 1]
    pairs[swapped], faces[swapped] = pairs[swapped][:, ::-1], faces[swapped][:, ::-1]
    apart = faces[:, 0] != faces[:, 1]
    sides, pairs, faces = sides[apart], pairs[apart], faces[apart]
    order = np.lexsort((faces[:, 1], faces[:, 0]))
    sides, pairs, faces = sides[order], pairs[order], faces[order]
    bounds = np.flatnonzero(np.any(np.diff(faces, axis=0) != 0, axis=1)) + 1
    for rows in np.split(np.arange(len(faces)), bounds):
        if len(rows):
            ends = model.points_mm[first[sides[rows]]]
            yield _Meeting((int(faces[rows[0], 0]), int(faces[rows[0], 1])), ends, pairs[rows].T)


def _is_outer(meeting: _Meeting, corners: FloatArray, normals: FloatArray) -> bool:
    """Whether the edge is convex: the second face falls away from the first."""
    first, second = meeting.beside
    farthest = np.einsum("kij,kj->ki", corners[second] - meeting.segments[:, :1], normals[first])
    rows = np.abs(farthest).argmax(axis=1)
    return bool(farthest[np.arange(len(rows)), rows].sum() < 0)


def _edges(
    first: FlatSurface, second: FlatSurface, meeting: _Meeting, normals: FloatArray, up: FloatArray
) -> list[ModelEdge]:
    """Straight edges in which two planes meet; empty if they are not level."""
    along = np.cross(first.normal, second.normal)
    size = float(np.linalg.norm(along))
    if size < PARALLEL or abs(float(along @ up)) > PARALLEL * size:
        return []
    along = along / size
    # the point of both planes that is nearest to the corners
    middle = meeting.segments.mean(axis=(0, 1))
    planes = np.stack([first.normal, second.normal])
    offsets = np.array([first.normal @ first.origin_mm, second.normal @ second.origin_mm])
    point = middle + np.linalg.lstsq(planes, offsets - planes @ middle, rcond=None)[0]
    if float(np.linalg.norm(point - middle)) > CAD.on_curve_mm:
        return []
    outside = normals[meeting.beside[0][0]] + normals[meeting.beside[1][0]]
    aside = np.cross(up, along)
    away = aside * (1.0 if outside @ aside >= 0 else -1.0)
    spans = np.sort((meeting.segments - point) @ along, axis=1)
    found = []
    for start, end in _joined(spans):
        if end - start > CAD.min_edge_mm:
            found.append(ModelEdge(point + start * along, point + end * along, away))
    return found


def _joined(spans: FloatArray) -> list[tuple[float, float]]:
    """Merge intervals (K, 2) that touch."""
    joined: list[tuple[float, float]] = []
    for start, end in spans[np.argsort(spans[:, 0])]:
        if joined and start <= joined[-1][1] + CAD.same_mm:
            joined[-1] = (joined[-1][0], max(joined[-1][1], float(end)))
        else:
            joined.append((float(start), float(end)))
    return joined


def _circle(
    first: Surface, second: Surface, meeting: _Meeting, normals: FloatArray, up: FloatArray
) -> ModelCircle | None:
    """The level circle in which a round wall meets a plane or another wall about its axis, or None."""
    wall, side = (first, 0) if isinstance(first, RoundSurface) else (second, 1)
    other = second if side == 0 else first
    assert isinstance(wall, RoundSurface)
    if not _parallel(wall.axis, up):
        return None
    height = _meeting_height(wall, other, up)
    if height is None:
        return None
    centre = wall.origin_mm + (height - float(wall.origin_mm @ up)) * up
    radius = _radius_at(wall, height, up)
    points = meeting.segments - centre
    level = points - (points @ up)[..., None] * up
    away = np.linalg.norm(level, axis=2)
    if (
        max(np.abs(away - radius).max(), np.abs(points @ up).max()) > CAD.on_curve_mm
        or radius < CAD.on_curve_mm
    ):
        return None
    middle = level.mean(axis=1)
    hole = float(np.einsum("ki,ki->", normals[meeting.beside[side]], middle)) < 0
    cosine = np.einsum("ki,ki->k", level[:, 0], level[:, 1]) / (away[:, 0] * away[:, 1])
    span = float(np.arccos(np.clip(cosine, -1.0, 1.0)).sum()) / math.tau
    return ModelCircle(centre, radius, hole, min(span, 1.0))


def _meeting_height(wall: RoundSurface, other: Surface, up: FloatArray) -> float | None:
    """Height along up (3,) at which a wall meets a plane or another wall about its axis, or None."""
    if isinstance(other, FlatSurface):
        return float(other.origin_mm @ up) if _parallel(other.normal, up) else None
    gap = other.origin_mm - wall.origin_mm
    aside = gap - float(gap @ up) * up
    if not _parallel(other.axis, up) or float(np.linalg.norm(aside)) > CAD.same_mm:
        return None
    slopes = [surface.slope * float(surface.axis @ up) for surface in (wall, other)]
    if abs(slopes[0] - slopes[1]) < PARALLEL:
        return None
    at_zero = [_radius_at(surface, 0.0, up) for surface in (wall, other)]
    return (at_zero[1] - at_zero[0]) / (slopes[0] - slopes[1])


def _radius_at(wall: RoundSurface, height: float, up: FloatArray) -> float:
    return wall.radius_mm + wall.slope * float(wall.axis @ up) * (height - float(wall.origin_mm @ up))


def _parallel(first: FloatArray, second: FloatArray) -> bool:
    return float(np.linalg.norm(np.cross(first, second))) < PARALLEL


def merged_circles(circles: Sequence[ModelCircle]) -> tuple[ModelCircle, ...]:
    """Merge the pieces of each circle: its wall may be several faces, or be cut by a notch."""
    order = sorted(circles, key=lambda circle: (-round(circle.radius_mm, 3), circle.hole))
    merged: list[ModelCircle] = []
    for _, group in itertools.groupby(order, key=lambda circle: (round(circle.radius_mm, 3), circle.hole)):
        kept: list[ModelCircle] = []
        for circle in group:
            same = [k for k, other in enumerate(kept)
                    if float(np.linalg.norm(other.centre_mm - circle.centre_mm)) < CAD.same_mm]  # fmt: skip
            if same:
                before = kept[same[0]]
                span = min(1.0, before.span + circle.span)
                sigma_mm = max(before.sigma_mm, circle.sigma_mm)
                kept[same[0]] = ModelCircle(before.centre_mm, before.radius_mm, circle.hole, span, sigma_mm)
            else:
                kept.append(circle)
        merged += kept
    return tuple(merged)
