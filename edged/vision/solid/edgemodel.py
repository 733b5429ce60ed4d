"""All edges of a solid part, as curves in its frame with both faces beside each.

A machined edge is a pair of edges: where two faces meet, an edge break (chamfer, rounding) of width b turns
the edge into two, each b away from it within one of the faces. Which of them a picture shows depends on light
and view, so the model holds both.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, I64, FloatArray
from edged.vision.kernels.jit import B1, F1, F2, F3, I1, kernel
from edged.vision.part.body import PartBody
from edged.vision.solid.params import MODEL


@dataclass(frozen=True, slots=True, eq=False)
class EdgeModel:
    """Edges of a part as segments, in order along each smooth curve, and the surface between them.

    sides (E, 2) : vertices of both ends.  start, end (E, 3) mm.
    normals (E, 2, 3) : of both faces, outwards.  chain (E,) : number of the curve.
    sharp (E,) : an edge from all sides; otherwise part of a curved wall, visible only on the outline.
    breakable (E,) : an outer edge that is not itself one of the two edges of a break.
    by_break (E, 2, 3) : motion from the segment to both edges of its break, by the width.
    breaks_mm (E,) : width of the edge break that the surface does not have.
    vertices (V, 3), triangles (T, 3) : the surface; empty where it is not known, and nothing hides.
    centre (3,), size_mm : of the part; poses are turned about the centre.
    taught_px : sigma of a shift of all edges together in each camera at teaching.
    height_mm : rms by which curves of one face were taught higher or lower than it; 0: they were even.
    sigma_break_mm : of the widths of all breaks together.  sigma_own_mm : of each curve's own, in addition.
    merged_mm : width below which pictures do not resolve breaks, which may be chamfers or roundings.
    upwards (E, 3) : motion from the lower to the upper edge of a break too narrow to be seen, by its width,
    where the upper face is turned to the cameras; 0 elsewhere. None: no such breaks.
    """

    sides: I64
    start: FloatArray
    end: FloatArray
    normals: FloatArray
    chain: I64
    sharp: B8
    breakable: B8
    by_break: FloatArray
    breaks_mm: FloatArray
    vertices: FloatArray
    triangles: I64
    centre: FloatArray
    size_mm: float
    taught_px: float = 0.0
    height_mm: float = 0.0
    sigma_break_mm: float = 0.0
    sigma_own_mm: float = 0.0
    merged_mm: float = 0.0
    upwards: FloatArray | None = None


class EdgePoints(NamedTuple):
    """Points along the edges of a model.

    points (N, 3), along (N, 3) unit; normals (N, 6) : of both faces.  by_break (N, 3) : motion by the width
    of the edge break; `EdgeModel.upwards` for an edge without one.  curve (N,) : number of the edge, a
    different one for each edge of a break; samples of an edge are consecutive.  sharp (N,) : as in the model.
    """

    points: F2
    along: F2
    normals: F2
    by_break: F2
    curve: I1
    sharp: B1


TINY_MM = MODEL.tiny_mm
EDGES = 3
"""Edge numbers per curve: the unbroken edge, and both edges of its break."""


def chains_of(curve: I64) -> I64:
    """(N,) numbers in `EdgeModel.chain` of edges (N,) that are numbered as in `EdgePoints`."""
    return np.asarray(curve // EDGES)


def are_unbroken(curve: I64) -> B8:
    """(N,) which edges (N,) that are numbered as in `EdgePoints` are not edges of a break."""
    return np.asarray(curve % EDGES == 0)


def model_of(body: PartBody) -> EdgeModel:
    """Edge model of a part's surface."""
    sides, beside = body.sides
    normals = body.normals
    flat = np.einsum("ej,ej->e", normals[beside[:, 0]], normals[beside[:, 1]])
    kept = flat < MODEL.flat
    sides, beside, sharp = sides[kept], beside[kept], (flat < MODEL.sharp)[kept]
    order, flipped, chain = _chained(body.points_mm, sides, sharp)
    sides[flipped] = sides[flipped][:, ::-1]
    sides, beside, sharp, chain = sides[order], beside[order], sharp[order], chain[order]
    start, end = body.points_mm[sides[:, 0]], body.points_mm[sides[:, 1]]
    along = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1, keepdims=True), MODEL.tiny_mm)
    middles = body.points_mm[body.triangles].mean(axis=1)
    inward = np.empty((len(sides), 2, 3))
    for k in (0, 1):
        inward[:, k] = np.cross(normals[beside[:, k]], along)
        away = middles[beside[:, k]] - 0.5 * (start + end)
        inward[:, k] *= np.sign(np.einsum("ej,ej->e", inward[:, k], away))[:, None]
    # an outer edge that is not itself one of the two edges of a break
    outer = np.einsum("ej,ej->e", inward[:, 0], normals[beside[:, 1]]) < MODEL.convex
    steep = np.einsum("ej,ej->e", normals[beside[:, 0]], normals[beside[:, 1]]) < MODEL.steep
    breakable, breaks = sharp & outer & steep, np.zeros(len(sides))
    if body.breaks_mm is not None:
        breaks = np.where(breakable, widths_of(sides, body.lines[:, :2], body.breaks_mm), 0.0)
    low, high = body.points_mm.min(axis=0), body.points_mm.max(axis=0)
    return EdgeModel(
        sides, start, end, normals[beside], chain, sharp, breakable, inward, breaks, body.points_mm,
        body.triangles, 0.5 * (low + high), float(np.linalg.norm(high - low)),
        sigma_break_mm=body.sigma_break_mm, merged_mm=body.merged_mm,
        upwards=_upwards(normals[beside], inward, breakable),
    )  # fmt: skip


def _upwards(normals: FloatArray, by_break: FloatArray, breakable: B8) -> FloatArray:
    """`EdgeModel.upwards` (E, 3)."""
    height, rows = normals[:, :, 2], np.arange(len(normals))  # a part's z leads away from the cameras
    upper = height.argmin(axis=1)
    is_open = breakable & (height.min(axis=1) < -MODEL.steep)
    return np.asarray(is_open[:, None] * (by_break[rows, upper] - by_break[rows, 1 - upper]))


def widths_of(sides: I64, known: I64, widths_mm: FloatArray) -> FloatArray:
    """(E,) break widths along sides (E, 2), given as vertices, looked up among those of known sides (K, 2).

    The order of the vertices does not matter; 0 along sides that are not known.
    """
    widths = {
        (min(a, b), max(a, b)): width
        for (a, b), width in zip(known.tolist(), widths_mm.tolist(), strict=True)
    }
    return np.array([widths.get((min(a, b), max(a, b)), 0.0) for a, b in sides.tolist()])


def _chained(points: FloatArray, sides: I64, sharp: B8) -> tuple[I64, B8, I64]:
    """Order (E,) in which the sharp sides of one smooth curve follow each other, head to tail.

    Also which sides (E,) must be flipped for that, and the number (E,) of each one's curve.
    """
    at: dict[int, list[int]] = defaultdict(list)
    for side in np.flatnonzero(sharp).tolist():
        for vertex in sides[side].tolist():
            at[vertex].append(side)
    heading = points[sides[:, 1]] - points[sides[:, 0]]
    heading /= np.maximum(np.linalg.norm(heading, axis=1, keepdims=True), MODEL.tiny_mm)
    used, flipped, chain = (
        np.zeros(len(sides), bool),
        np.zeros(len(sides), bool),
        np.zeros(len(sides), np.int64),
    )
    order: list[int] = []
    number = 0
    for first in np.flatnonzero(sharp).tolist():
        if used[first]:
            continue
        used[first] = True
        ways = []
        for onward in (1, 0):  # from its end, then from its beginning
            walked = _walk(first, onward, at, sides, heading, used)
            ways.append([(side, back if onward else not back) for side, back in walked])
        for side, back in [*ways[1][::-1], (first, False), *ways[0]]:
            order.append(side)
            chain[side], flipped[side] = number, back
        number += 1
    smooth = np.flatnonzero(~sharp)
    chain[smooth] = number + np.arange(len(smooth))
    return np.concatenate([np.array(order, np.int64), smooth]), flipped, chain


def _walk(
    first: int,
    onward: int,
    at: dict[int, list[int]],
    sides: I64,
    heading: FloatArray,
    used: B8,
) -> list[tuple[int, bool]]:
    """Sides that go on smoothly from one end of a side, each with whether it is walked backwards."""
    vertex, way = int(sides[first, onward]), heading[first] * (1.0 if onward else -1.0)
    walked: list[tuple[int, bool]] = []
    while True:
        for side in at[vertex]:
            back = int(sides[side, 0]) != vertex
            ahead = -heading[side] if back else heading[side]
            if not used[side] and float(ahead @ way) > MODEL.smooth:
                break
        else:
            return walked
        used[side], way = True, ahead
        vertex = int(sides[side, 0] if back else sides[side, 1])
        walked.append((side, back))


@lru_cache(maxsize=64)  # of a few jobs at a few spacings
def sampled(model: EdgeModel, spacing_mm: float) -> EdgePoints:
    """Points along all edges of a model, evenly spaced along each curve."""
    unbroken = np.zeros_like(model.start) if model.upwards is None else model.upwards
    by_break = np.stack([unbroken, model.by_break[:, 0], model.by_break[:, 1]], axis=1)
    broken = model.breaks_mm > 0
    rows = np.concatenate([np.flatnonzero(~broken), *[np.flatnonzero(broken)] * 2])
    part = np.repeat([0, 1, 2], [np.count_nonzero(~broken), *[np.count_nonzero(broken)] * 2])
    start, end, widths = (np.ascontiguousarray(each) for each in (model.start, model.end, model.breaks_mm))
    normals = model.normals.reshape(-1, 6)
    edges = _Edges(start, end, widths, by_break, normals, model.chain, model.sharp, rows, part)
    return _along(edges, spacing_mm)


class _Edges(NamedTuple):
    """Edges to sample: fields of an `EdgeModel` (E, ...), and the segments in order.

    by_break (E, 3, 3) : of the unbroken edge, and of both edges of its break.  normals (E, 6).
    rows (R,), part (R,) : of each segment in order, its number and which of these three edges it is.
    """

    start: F2
    end: F2
    breaks_mm: F1
    by_break: F3
    normals: F2
    chain: I1
    sharp: B1
    rows: I1
    part: I1


@kernel("EdgePoints(_Edges, f8)", tuples=(EdgePoints, _Edges))
def _along(edges: _Edges, spacing_mm: float) -> EdgePoints:
    """Samples of the segments, spaced evenly along each curve."""
    count = len(edges.rows)
    ends, places, steps = np.empty((count, 2, 3)), np.empty((count, 2)), np.zeros((count, 2), np.int64)
    total, before, so_far = 0, -1, 0.0
    for r in range(count):
        row, part, square = edges.rows[r], edges.part[r], 0.0
        for i in range(3):
            shift = edges.breaks_mm[row] * edges.by_break[row, part, i]
            ends[r, 0, i], ends[r, 1, i] = edges.start[row, i] + shift, edges.end[row, i] + shift
            square += (ends[r, 1, i] - ends[r, 0, i]) ** 2
        curve = edges.chain[row] * EDGES + part
        if curve != before:
            before, so_far = curve, 0.0
        places[r, 0], places[r, 1] = so_far, np.sqrt(square)
        so_far += places[r, 1]
        first, last = np.ceil(places[r, 0] / spacing_mm - 0.5), np.ceil(so_far / spacing_mm - 0.5)
        steps[r, 0], steps[r, 1] = int(first), int(last - first)
        total += steps[r, 1]
    points = EdgePoints(
        np.empty((total, 3)), np.empty((total, 3)), np.empty((total, 6)), np.empty((total, 3)),
        np.empty(total, np.int64), np.empty(total, np.bool_),
    )  # fmt: skip
    n = 0
    for r in range(count):
        row, part, length = edges.rows[r], edges.part[r], max(places[r, 1], TINY_MM)
        for step in range(steps[r, 1]):
            share = ((steps[r, 0] + step + 0.5) * spacing_mm - places[r, 0]) / length
            for i in range(3):
                way = ends[r, 1, i] - ends[r, 0, i]
                points.points[n, i], points.along[n, i] = ends[r, 0, i] + share * way, way / length
                points.by_break[n, i] = edges.by_break[row, part, i]
            for i in range(6):
                points.normals[n, i] = edges.normals[row, i]
            points.curve[n], points.sharp[n] = edges.chain[row] * EDGES + part, edges.sharp[row]
            n += 1
    return points
