"""Edge model of a part that was taught from pictures alone: its circles, slots, straight and traced edges.

Its surface is not known, so hidden stretches cannot be predicted: they are left to the evidence, which needs
no curve as a whole. A taught curve is one edge of an edge break, if there is one: mostly that in the face.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, SlotFeature
from edged.vision.part.traced import TracedCurve
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.params import BREAKS, CURVES

UP = np.array([0.0, 0.0, -1.0])
"""Towards the cameras, part frame."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rim:
    """A taught curve as a polyline of points (N, 3).  outwards (N - 1, 3) : unit, away from the face."""

    points: FloatArray
    outwards: FloatArray

    @property
    def level(self) -> float:
        """Its height, z."""
        return float(self.points[0, 2])

    def other(self, break_mm: float) -> FloatArray:
        """(N - 1, 3) middles of the pieces of the other edge of its break, in the wall."""
        middles = 0.5 * (self.points[:-1] + self.points[1:])
        return np.asarray(middles + break_mm * (self.outwards - UP))


def has_enough_curves(job: Job) -> bool:
    """Whether a job has enough curves to distinguish its part from chance."""
    return len(job.circles) + len(job.edges) + len(job.slots) + len(job.traced) >= CURVES.fewest


def curve_points(job: Job) -> list[FloatArray]:
    """Points (N, 3) along each of the taught curves of a job, part frame."""
    return [rim.points for rim in _rims(job)]


def unevenness_mm(job: Job) -> float:
    """Rms by which curves were taught higher or lower than the median of their face; 0 if faces are flat.

    Where walls are as bright as the face, each camera sees the edges of holes and bosses where their walls
    darken: deeper by up to half a millimetre, and by a different amount for each.
    """
    return _unevenness_mm(list(_rims(job)))


def curve_model(job: Job, break_mm: float = 0.0, is_lower: bool = False) -> EdgeModel:
    """The edges of a job's taught curves, each the rim of a face that looks at the cameras.

    break_mm : width of their edge breaks.  is_lower : the taught curves are the ends of the breaks in the
    walls, not those in the faces.  Curves have the numbers of the job's: its circles come first.
    """
    rims = list(_rims(job))
    if job.break_end == "face":  # true of all; the lower edges of some may have been taught, too
        lower = [_has_upper(rim, rims, break_mm) for rim in rims]
    else:
        lower = [is_lower or _is_lower(rim, rims, break_mm) for rim in rims]
    kept = [k for k, rim in enumerate(rims) if not (lower[k] and _has_upper(rim, rims, break_mm))]
    rims, lower = [rims[k] for k in kept], [lower[k] for k in kept]
    start, end, outwards = (
        np.concatenate(parts)
        for parts in zip(*((rim.points[:-1], rim.points[1:], rim.outwards) for rim in rims), strict=True)
    )
    pieces = [len(rim.outwards) for rim in rims]
    count, up = len(start), np.broadcast_to(UP, (len(start), 3))
    down = np.repeat(lower, pieces)[:, None]
    across = outwards - up  # from the edge in the face to that in the wall
    zero = np.zeros((count, 3))
    by_break = np.stack([np.where(down, -across, zero), np.where(down, zero, across)], axis=1)
    low, high = np.minimum(start, end).min(axis=0), np.maximum(start, end).max(axis=0)
    return EdgeModel(
        np.zeros((count, 2), np.int64), start, end, np.stack([up, outwards], axis=1),
        np.repeat(kept, pieces), np.ones(count, bool), np.ones(count, bool), by_break,
        np.full(count, break_mm), np.zeros((0, 3)), np.zeros((0, 3), np.int64), 0.5 * (low + high),
        float(np.linalg.norm(high - low)), CURVES.taught_px, _unevenness_mm(rims), *sigmas_of_breaks(job),
    )  # fmt: skip


def sigmas_of_breaks(job: Job) -> tuple[float, float]:
    """Sigmas of an `EdgeModel` for breaks that are unknown or stated: of all together, and each one's own."""
    if job.break_mm is None:
        return BREAKS.unknown_sigma_mm, BREAKS.unknown_sigma_mm
    return BREAKS.taught_sigma_mm, 0.0


def _unevenness_mm(rims: list[_Rim]) -> float:
    heights = np.sort([rim.level for rim in rims])
    face = np.cumsum(np.diff(heights, prepend=heights[0]) > CURVES.same_face_mm)
    usual = np.array([np.median(heights[face == number]) for number in range(face[-1] + 1)])
    uneven_mm = float(np.sqrt(np.mean((heights - usual[face]) ** 2)))
    return uneven_mm if uneven_mm > CURVES.level_mm else 0.0


def _is_lower(rim: _Rim, rims: list[_Rim], break_mm: float) -> bool:
    """Whether a curve lies one break's width below another curve, and none lies as far below it."""
    if break_mm < 2 * CURVES.level_mm:
        return False
    below = [rim.level - other.level for other in rims]
    return any(abs(depth - break_mm) < CURVES.level_mm for depth in below) and not any(
        abs(depth + break_mm) < CURVES.level_mm for depth in below
    )


def _has_upper(rim: _Rim, rims: list[_Rim], break_mm: float) -> bool:
    """Whether the upper edge of a lower one was taught, too: then the model has the lower one by that."""
    middles = 0.5 * (rim.points[:-1] + rim.points[1:])
    for other in rims:
        if other is rim:
            continue
        apart = np.linalg.norm(other.other(break_mm)[:, None] - middles[None], axis=2)
        if len(apart) > 1 and (apart.min(axis=1) < 2 * CURVES.level_mm).mean() > 0.5:
            return True
    return False


def _rims(job: Job) -> Iterator[_Rim]:
    for circle in job.circles:
        yield _circle(circle, -1.0 if _is_hole(job, circle) else 1.0)
    for slot in job.slots:
        yield _slot(slot, -1.0 if _is_slot_hole(job, slot) else 1.0)
    for edge in job.edges:
        yield _edge(edge)
    for curve in job.traced:
        yield _traced(curve)


def _is_hole(job: Job, circle: CircleFeature) -> bool:
    """Whether a circle is a hole: other curves of its face, or of one hardly above, run around it.

    Decided by its polarity where there are too few.
    """
    x, y, z = circle.centre_mm
    for other in job.circles:
        apart = math.dist((x, y), other.centre_mm[:2])
        near = abs(float(other.centre_mm[2]) - z) < CURVES.same_face_mm
        if near and other.radius_mm > circle.radius_mm + apart:
            return True
    lines = [np.stack([edge.start_mm, edge.end_mm]) for edge in job.edges]
    points = np.concatenate([np.zeros((0, 3)), *lines, *(curve.points_mm for curve in job.traced)])
    corners = points[np.abs(points[:, 2] - z) < CURVES.same_face_mm, :2]
    if len(corners) < 4:
        return circle.polarity > 0
    reach, away = circle.radius_mm, corners - (x, y)
    if np.mean(np.linalg.norm(away, axis=1) < 1.1 * reach) > 0.5:  # most of them are its own, or within it
        return False
    if (away.min(axis=0) < -reach).all() and (away.max(axis=0) > reach).all():
        return True
    return circle.polarity > 0


def _is_slot_hole(job: Job, slot: SlotFeature) -> bool:
    """Whether a slot is a hole: with a circle within it, it is the part's outline."""
    along = np.array([math.cos(slot.angle_rad), math.sin(slot.angle_rad)])
    reach = 0.5 * (slot.length_mm - slot.width_mm)
    for circle in job.circles:
        gap = (circle.centre_mm - slot.centre_mm)[:2]
        beside = gap - np.clip(gap @ along, -reach, reach) * along
        if np.linalg.norm(beside) + circle.radius_mm < 0.5 * slot.width_mm:
            return False
    return True


def _circle(circle: CircleFeature, outwards: float) -> _Rim:
    turns = _turns(2 * math.pi, circle.radius_mm)
    points = circle.centre_mm + circle.radius_mm * _around(turns)
    return _Rim(points, outwards * _around(0.5 * (turns[:-1] + turns[1:])))


def _slot(slot: SlotFeature, outwards: float) -> _Rim:
    """Rim of a slot: both half circles, cut as finely as circles, and the straight edges between them."""
    radius = 0.5 * slot.width_mm
    reach = 0.5 * slot.length_mm - radius
    turns = _turns(math.pi, radius) - 0.5 * math.pi
    halves = [
        slot.centre_mm + reach * _around(np.array([half])) + radius * _around(turns + half)
        for half in (slot.angle_rad, slot.angle_rad + math.pi)
    ]
    points = np.concatenate([*halves, halves[0][:1]])
    along = np.diff(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return _Rim(points, outwards * np.cross(along, -UP))


def _edge(edge: EdgeFeature) -> _Rim:
    """Rim of a straight edge, in a few pieces; its brighter side is taken for the face."""
    points = edge.start_mm + np.linspace(0, 1, CURVES.pieces + 1)[:, None] * (edge.end_mm - edge.start_mm)
    along = (edge.end_mm - edge.start_mm) / edge.length_mm
    return _Rim(points, np.repeat(np.cross(along, -UP)[None] * edge.polarity, CURVES.pieces, axis=0))


def _traced(curve: TracedCurve) -> _Rim:
    """Rim of a traced curve; its brighter side is taken for the face."""
    along = np.diff(curve.points_mm, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return _Rim(curve.points_mm, np.cross(along, -UP) * curve.polarity)


def _turns(turn_rad: float, radius_mm: float) -> FloatArray:
    """Angles of an arc whose chords lie a fraction of a micrometre off it."""
    chord = 2 * math.acos(1 - min(CURVES.sagitta_mm / radius_mm, 0.1))
    return np.linspace(0.0, turn_rad, max(math.ceil(turn_rad / chord), 8) + 1)


def _around(turns: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(turns), np.sin(turns), np.zeros(len(turns))])
