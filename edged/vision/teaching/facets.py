"""Recover circles and straight edges of a part that is known as bare triangles.

A sharp, level edge is a chain of sides of triangles. Where the chain turns by a little at each corner, it was
a circle: programs that write such files put the corners on the curve, and the chords inside of it. So a
circle through the corners is not biased by the sagitta of the chords. But this is a convention and no rule:
sigma follows from the sagitta as the range within which the true curve lies.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from edged.domain.arrays import B8, I64, FloatArray
from edged.vision.geometry.rigid import unit
from edged.vision.part.body import neighbours
from edged.vision.teaching.cadmodel import (
    CadModel,
    ModelCircle,
    ModelCurves,
    ModelEdge,
    merged_circles,
    triangle_normals,
)
from edged.vision.teaching.params import CAD

RECTANGULAR = 1 / math.sqrt(12)
"""Sigma of a uniform distribution, as a share of its range."""


def faceted_curves(model: CadModel, up: FloatArray) -> ModelCurves:
    """Level circles and straight edges of bare triangles that are visible from direction up (3,)."""
    up = unit(np.asarray(up, np.float64))
    x = unit(np.eye(3)[int(np.abs(up).argmin())] - up * up[int(np.abs(up).argmin())])
    frame = np.stack([x, np.cross(up, x), up])
    points = model.points_mm @ frame.T
    corners, normals = triangle_normals(model)
    sides, beside, slopes = _sharp_sides(model, corners, normals, points, up)
    circles: list[ModelCircle] = []
    edges: list[ModelEdge] = []
    for chain, closed in _chains(sides, slopes, points):
        if closed:
            chain = _from_a_corner(sides, chain, points)
        place = points[_corners_along(sides, chain)]
        outside = normals[beside[chain]].sum(axis=1) @ frame.T
        wall = normals[beside[chain, 1]] @ frame.T
        arcs, straight = _parts(place[:, :2], closed)
        for first, last in arcs:
            circles.append(_circle(place, wall, first, last, frame))
        for first, last in straight:
            edges += _edge(place, outside, first, last, frame)
    return ModelCurves(up, merged_circles(circles), tuple(edges), model)


def _sharp_sides(
    model: CadModel, corners: FloatArray, normals: FloatArray, points: FloatArray, up: FloatArray
) -> tuple[I64, I64, FloatArray]:
    """Level, sharp, outer and visible sides (K, 2) of triangles.

    Also numbers (K, 2) and slopes (K, 2) of the two triangles at each, the one that faces up more first.
    """
    sides, beside = neighbours(model.triangles)
    height = points[sides, 2]
    length = np.linalg.norm(points[sides[:, 1]] - points[sides[:, 0]], axis=1)
    level = np.abs(height[:, 0] - height[:, 1]) < np.maximum(CAD.level_share * length, CAD.facet_level_mm)
    cosine = np.einsum("ij,ij->i", normals[beside[:, 0]], normals[beside[:, 1]])
    chosen = level & (cosine < math.cos(CAD.sharp_rad))
    sides, beside = sides[chosen], beside[chosen]
    slopes = normals[beside] @ up
    swapped = slopes[:, 0] < slopes[:, 1]
    beside[swapped], slopes[swapped] = beside[swapped][:, ::-1], slopes[swapped][:, ::-1]
    # outer where the second triangle falls away from the first one's plane
    off = np.einsum(
        "kij,kj->ki", corners[beside[:, 1]] - model.points_mm[sides[:, :1]], normals[beside[:, 0]]
    )
    farthest = off[np.arange(len(off)), np.abs(off).argmax(axis=1)] if len(off) else np.zeros(0)
    seen = (slopes[:, 0] >= CAD.looks_up) & (farthest < 0)
    return sides[seen], beside[seen], slopes[seen]


def _chains(sides: I64, slopes: FloatArray, points: FloatArray) -> Iterator[tuple[I64, bool]]:
    """Chains of adjoining sides of one kind, as their numbers in order; whether each chain is closed.

    Sides of one kind lie at one height, between facets of the same slopes.
    """
    kind = np.column_stack([np.rint(points[sides[:, 0], 2] / (2 * CAD.facet_level_mm)), np.rint(20 * slopes)])
    order = np.lexsort(kind.T)
    apart = np.abs(np.diff(points[sides[order, 0], 2])) > 2 * CAD.facet_level_mm
    apart |= np.abs(np.diff(slopes[order], axis=0)).max(axis=1) > 0.1
    for rows in np.split(order, np.flatnonzero(apart) + 1):
        yield from _followed(sides, rows)


def _followed(sides: I64, rows: I64) -> Iterator[tuple[I64, bool]]:
    at: dict[int, list[int]] = {}
    for row in rows.tolist():
        for corner in sides[row].tolist():
            at.setdefault(corner, []).append(row)
    left = dict.fromkeys(rows.tolist())
    ends = [corner for corner, here in at.items() if len(here) != 2]
    starts = [(corner, row) for corner in ends for row in at[corner]]
    for corner, row in (*starts, *((int(sides[row, 0]), row) for row in rows.tolist())):
        if row not in left:
            continue
        chain, here, following = [], corner, row
        while following in left:
            del left[following]
            chain.append(following)
            here = int(sides[following].sum()) - here
            nearby = at[here]
            if len(nearby) != 2:
                break
            following = nearby[0] if nearby[1] == following else nearby[1]
        yield np.array(chain), here == corner and len(chain) > 2


def _from_a_corner(sides: I64, chain: I64, points: FloatArray) -> I64:
    """Rotate a closed chain to start where it turns most, not within a straight edge."""
    steps = np.diff(points[_corners_along(sides, chain), :2], axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.angle(np.exp(1j * (heading - np.roll(heading, 1))))
    return np.roll(chain, -int(np.abs(turn).argmax()))


def _corners_along(sides: I64, chain: I64) -> I64:
    """Corners (K + 1,) along a chain of K sides (K, 2)."""
    if len(chain) == 1:
        return np.asarray(sides[chain[0]])
    first, second = sides[chain[0]], sides[chain[1]]
    corners = [int(first[0] if first[1] in second else first[1])]
    for row in chain.tolist():
        corners.append(int(sides[row].sum()) - corners[-1])
    return np.array(corners)


def _parts(place: FloatArray, closed: bool) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Split a chain of corners (K + 1, 2) into arcs and straight stretches: first and last corner of each."""
    count = len(place) - 1
    steps = np.diff(place, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.angle(np.exp(1j * np.diff(heading)))
    bends = (np.abs(turn) > CAD.straight_rad) & (np.abs(turn) < CAD.facet_rad)
    arcs, straight = [], []
    first = 0
    while first < count:
        last = _arc_from(place, turn, bends, first)
        if last:
            arcs.append((first, last))
            first = last
            continue
        last = first + 1
        while last < count and abs(turn[last - 1]) < CAD.straight_rad:
            last += 1
        straight.append((first, last))
        first = last
    if closed and not straight and _is_round(place):
        arcs = [(0, count)]
    return arcs, straight


def _arc_from(place: FloatArray, turn: FloatArray, bends: B8, first: int) -> int:
    """Last corner of the arc that begins at corner `first`; 0 if none does."""
    last = first + CAD.min_corners - 1
    if (
        last > len(place) - 1
        or not _bends_on(turn, bends, first, last)
        or not _is_round(place[first : last + 1])
    ):
        return 0
    while last < len(place) - 1:
        further = min(2 * last - first, len(place) - 1)  # try twice as long, or else one more
        if _bends_on(turn, bends, first, further) and _is_round(place[first : further + 1]):
            last = further
        elif _bends_on(turn, bends, first, last + 1) and _is_round(place[first : last + 2]):
            last += 1
        else:
            break
    return last if abs(float(turn[first : last - 1].sum())) > CAD.min_arc_rad else 0


def _bends_on(turn: FloatArray, bends: B8, first: int, last: int) -> bool:
    inner = slice(first, last - 1)
    return bool(bends[inner].all()) and bool(abs(np.sign(turn[inner]).sum()) == last - 1 - first)


def _is_round(place: FloatArray) -> bool:
    """Whether corners lie on one circle, and each chord is short against it."""
    centre, radius = _fitted(place)
    if not math.isfinite(radius):
        return False
    off = np.abs(np.linalg.norm(place - centre, axis=1) - radius).max()
    longest = np.linalg.norm(np.diff(place, axis=0), axis=1).max()
    return bool(
        off < max(CAD.on_circle_mm, CAD.on_circle_share * radius)
        and longest < 2 * radius * math.sin(CAD.facet_rad / 2)
    )


def _fitted(place: FloatArray) -> tuple[FloatArray, float]:
    """Centre (2,) and radius of the circle through corners (N, 2) (I. Kåsa, IEEE Trans. IM 25, 1976)."""
    middle = place.mean(axis=0)
    near = place - middle
    design = np.column_stack([2 * near, np.ones(len(near))])
    solved, _, rank, _ = np.linalg.lstsq(design, (near**2).sum(axis=1), rcond=None)
    square = float(solved[2] + solved[:2] @ solved[:2])
    if rank < 3 or square <= 0:
        return middle, math.inf
    return np.asarray(middle + solved[:2]), math.sqrt(square)


def _circle(place: FloatArray, wall: FloatArray, first: int, last: int, frame: FloatArray) -> ModelCircle:
    corners = place[first : last + 1]
    centre, radius = _fitted(corners[:, :2])
    chords = np.linalg.norm(np.diff(corners[:, :2], axis=0), axis=1)
    angles = 2 * np.arcsin(np.clip(0.5 * chords / radius, 0.0, 1.0))
    middles = 0.5 * (corners[1:] + corners[:-1])[:, :2] - centre
    hole = float(np.einsum("ij,ij->", wall[first:last, :2], middles)) < 0
    sagitta = radius * (1 - math.cos(0.5 * float(angles.max())))
    place_mm = np.append(centre, corners[:, 2].mean()) @ frame
    return ModelCircle(
        place_mm, radius, hole, min(float(angles.sum()) / math.tau, 1.0), RECTANGULAR * sagitta
    )


def _edge(
    place: FloatArray, outside: FloatArray, first: int, last: int, frame: FloatArray
) -> list[ModelEdge]:
    start, end = place[first], place[last]
    if float(np.linalg.norm(end - start)) < CAD.min_edge_mm:
        return []
    along = unit(np.append(end[:2] - start[:2], 0.0))
    aside = np.array([-along[1], along[0], 0.0])
    away = aside * (1.0 if outside[first] @ aside >= 0 else -1.0)
    return [ModelEdge(start @ frame, end @ frame, away @ frame)]
