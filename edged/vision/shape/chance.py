"""Measure edges by chance: those that the bare face shows, in this picture, where the part has no edge.

Grinding, turning and milling leave a texture that is full of edges. How many of them a curve meets depends on
the surface, the light and the curve: a curve concentric with rings meets them all along, others do not;
streaks are met by curves along them. So chance is measured where it matters: the very points that distinguish
two rotations are turned about the part's middle to where the face has no edge of its own, and examined.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import B8, F64, I64, FloatArray, Image
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.kernels.jit import F1, F2, FLOAT, I1, kernel
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import ROTATIONS
from edged.vision.shape.refine import look_along, place

EVIDENCE = -math.log(ROTATIONS.mistakes)
"""Nats of evidence that decide for a rotation: chance shows as much in a share `mistakes` of pictures."""
PLACES = 23
"""Steps of a full turn by which points are turned to places elsewhere: prime, so that none is a part's
symmetry."""
# numba freezes globals when it compiles: kernels read these by name
FEW_LOOKS = ROTATIONS.few_looks
FEW_PLACES = ROTATIONS.few_places
CURVE_POINTS = ROTATIONS.curve_points
MIN_SLOPE = ROTATIONS.min_slope
UNKNOWN = ROTATIONS.unknown
EXCEEDED = (ROTATIONS.often, *ROTATIONS.rare)
Array = npt.NDArray[Any]
Flags = B8


class FacePlaces(NamedTuple):
    """Points of a model, turned about its middle to where its face has no edge.

    points, normals (C, 2) : as `ShapeLevel`.  of (C,) : index of the model's point.  place (C,) : number of
    the rotation, below PLACES.
    """

    points: F2
    normals: F2
    of: I1
    place: I1


class Chance(NamedTuple):
    """Edges that the model's points show elsewhere on its face.

    known (U,) : indices of the model's points.  looked (U,), met (T, U) : number of places where the bare
    face was seen, and of those with an edge.  thresholds (T,) : slopes from which an edge may count,
    ascending; chance exceeds the first at the first of the shares `rare`, and so on.  repeated, many : factor
    by which the number of edges of a set scatters more than that of independent points, and the mean number
    of points that it was estimated from.
    """

    known: I1
    looked: F1
    met: F2
    thresholds: F1
    repeated: FLOAT = 1.0  # independent points
    many: FLOAT = 1.0  # single points

    def shares(self, sets: Flags) -> FloatArray:
        """Shares (T, K) of K sets (K, N) of the model's points that show an edge by chance."""
        return chance_shares(self, sets)

    def evidence(self, sets: Flags, slopes: FloatArray, strong: float, shares: FloatArray) -> FloatArray:
        """Nats (K,) by which chance is unlikely to show as many edges in each of K sets of points.

        sets (K, N) : points of the model, with their `shares`.  slopes (N,) or (K, N) : strength of the edge
        that each shows.  strong : lower limit of the slopes that count.
        A share s of n independent points, where chance shows a share p, is reached with a probability below
        exp(-n KL(s, p)) (H. Chernoff, 1952). The threshold with most evidence decides, less the price of
        having chosen it.
        """
        each = slopes if slopes.ndim == 2 else slopes[None]
        return chance_evidence(self, sets, each, strong, np.ascontiguousarray(shares))


@kernel("f8[:, ::1](Chance, b1[:, ::1])", tuples=(Chance,))
def chance_shares(chance: Chance, sets: Flags) -> F64:
    """`Chance.shares`: sets with few looks are judged by the looks of all points."""
    levels, shares = len(chance.thresholds), np.empty((len(chance.thresholds), len(sets)))
    met = np.empty(levels)
    for k in range(len(sets)):
        for whole in (False, True):
            looked = 0.0
            met[:] = 0.0
            for u in range(len(chance.known)):
                if whole or sets[k, chance.known[u]]:
                    looked += chance.looked[u]
                    for t in range(levels):
                        met[t] += chance.met[t, u]
            if looked >= FEW_LOOKS:
                break
        for t in range(levels):
            shares[t, k] = (met[t] + 0.5) / (looked + 1.0) if looked > 0.0 else UNKNOWN
    return shares


@kernel("f8[::1](Chance, b1[:, ::1], f8[:, ::1], f8, f8[:, ::1])", tuples=(Chance,))
def chance_evidence(chance: Chance, sets: Flags, slopes: F64, strong: float, shares: F64) -> F64:
    """`Chance.evidence`, with slopes (K, N), or (1, N) for all sets."""
    levels, nats = len(chance.thresholds), np.empty(len(sets))
    shared = min((chance.repeated - 1.0) / max(chance.many - 1.0, 1.0), 1.0)
    for k in range(len(sets)):
        row, count, best = slopes[k if len(slopes) > 1 else 0], 0, -np.inf
        for n in range(sets.shape[1]):
            count += sets[k, n]
        count = max(count, 1)
        independent = count / (1.0 + (min(count, CURVE_POINTS) - 1.0) * shared)
        for t in range(levels):
            shown, level = 0, max(chance.thresholds[t], strong)
            for n in range(sets.shape[1]):
                shown += sets[k, n] and row[n] >= level
            share = shares[t, k]
            seen = min(max(shown / count, share), 1.0)
            rest = (1.0 - seen) * np.log(max(1.0 - seen, 1e-12) / (1.0 - share))
            best = max(best, independent * (seen * np.log(seen / share) + rest))
        nats[k] = best - np.log(levels)
    return nats


@kernel("UniTuple(f8, 2)(f8[::1], i8[::1], i8[::1], b1[:, ::1], f8)")
def clumping(slope: F64, of: I64, place: I64, sets: Flags, often: float) -> tuple[float, float]:
    """Excess scatter of the number of edges of a set over independent points, and its mean number of points.

    slope (C,) : of the edge at each place, 0 without one, NaN where no face was seen.  of, place (C,) : as in
    `FacePlaces`.  sets (K, N) : points that lie on a curve or two.  often : slope that chance exceeds often
    enough for an estimate.
    Rings and streaks are met by many points at once, or by none: the number of edges scatters from place to
    place like that of fewer points (beta-binomial).
    """
    looked, met = np.zeros((len(sets), PLACES)), np.zeros((len(sets), PLACES))
    for c in range(len(slope)):
        for k in range(len(sets) if not np.isnan(slope[c]) else 0):
            if sets[k, of[c]]:
                looked[k, place[c]] += 1.0
                met[k, place[c]] += slope[c] >= often
    scatter, freedom, points, used = 0.0, 0, 0.0, 0
    for k in range(len(sets)):
        places, all_looked, all_met = 0, 0.0, 0.0
        for p in range(PLACES):
            places += looked[k, p] > 1.0
            all_looked += looked[k, p]
            all_met += met[k, p]
        if places <= FEW_PLACES or all_met == 0.0:
            continue
        share = all_met / all_looked
        freedom += places - 1
        for p in range(PLACES):
            if looked[k, p] > 1.0:
                wanted = looked[k, p] * share
                scatter += (met[k, p] - wanted) ** 2 / max(wanted * (1.0 - share), 1e-9)
                points += looked[k, p]
                used += 1
    if freedom == 0:
        return 1.0, 1.0
    return max(scatter / freedom, 1.0), points / used


@kernel("void(u1[:, ::1], FacePlaces, f8[::1], i8, f8, f8, f8[::1])", tuples=(FacePlaces,))
def look_elsewhere(
    image: Image, places: FacePlaces, pose: F64, sign: int, darkest: float, brightest: float, slope: F64
) -> None:
    """Fill slope (C,) of the edge at each place of the face of a part at a pose, 0 without one.

    darkest, brightest : grey values of the face; where it is darker or brighter, there is a hole or something
    else that is no texture, and the slope is NaN.
    """
    placed, greys = np.empty((len(slope), 4)), np.empty((len(slope), 3))
    place(places.points, places.normals, pose, placed)
    look_along(image, placed, sign, slope, greys)
    for c in range(len(slope)):
        slope[c] = abs(slope[c])
        for i in range(3):
            if not darkest < greys[c, i] < brightest:
                slope[c] = np.nan


@kernel("Chance(f8[::1], FacePlaces, b1[:, ::1], f8)", tuples=(FacePlaces, Chance))
def chance_of(slope: F64, places: FacePlaces, sets: Flags, strong: float) -> Chance:
    """Chance from slopes (C,) at places elsewhere, see `look_elsewhere`; sets (K, N) as in `clumping`.

    strong : slope from which an edge may be the part's.
    """
    ordered = np.sort(slope[~np.isnan(slope)])
    exceeded, levels = np.zeros(len(EXCEEDED)), len(EXCEEDED) - 1
    for t in range(len(EXCEEDED) if len(ordered) > 0 else 0):
        exceeded[t] = ordered[int(np.ceil((1.0 - EXCEEDED[t]) * len(ordered))) - 1]
    thresholds, repeated, many = np.maximum(exceeded[1:], strong), 0.0, 0.0
    for t in range(levels):
        found = clumping(slope, places.of, places.place, sets, max(exceeded[t], MIN_SLOPE))
        if found[0] > repeated or (found[0] == repeated and found[1] > many):
            repeated, many = found
    looked, met = np.zeros(sets.shape[1]), np.zeros((levels, sets.shape[1]))
    for c in range(len(slope)):
        if not np.isnan(slope[c]):
            looked[places.of[c]] += 1.0
            for t in range(levels):
                met[t, places.of[c]] += slope[c] >= thresholds[t]
    known = np.flatnonzero(looked > 0.0)
    return Chance(known, looked[known], np.ascontiguousarray(met[:, known]), thresholds, repeated, many)


def chosen_places(all_places: FacePlaces, points: Flags) -> FacePlaces:
    """Places to look at points (N,) of a model: curves as whole as possible, as many as time allows."""
    # the model's points come in random order: the first ones are as good as any
    some = points & (np.cumsum(points) <= ROTATIONS.max_points)
    found = np.flatnonzero(some[all_places.of])
    scattered = all_places.place[found] * ROTATIONS.stride % PLACES
    chosen = found[np.argsort(scattered, kind="stable")][: ROTATIONS.max_looks]
    points_px, normals, of, number = all_places
    return FacePlaces(points_px[chosen], normals[chosen], of[chosen], number[chosen])


@lru_cache(maxsize=16)
def elsewhere(model: ShapeModel) -> FacePlaces:
    """Places on the face, clear of the model's edges, to which its points may be turned."""
    level, centre = model.levels[0], model.centre_px
    points, normals = level.points, level.normals
    low = np.floor(points.min(axis=0)) - 2.0
    width, height = (np.ceil(points.max(axis=0)) - low).astype(int) + 3
    canvas = np.full((height, width), 255, np.uint8)
    inside = np.zeros_like(canvas)
    cells = np.rint(points - low).astype(np.int32)
    canvas[cells[:, 1], cells[:, 0]] = 0
    cv2.fillConvexPoly(inside, cv2.convexHull(cells), 255)
    clear = (cv2.distanceTransform(canvas, cv2.DIST_L2, 5) > ROTATIONS.clear_px) & (inside > 0)
    found: list[tuple[FloatArray, FloatArray, Array, Array]] = []
    for number in range(1, PLACES):
        turn = rotation_2d(2 * math.pi * number / PLACES)
        moved = (points - centre) @ turn.T + centre
        x, y = np.rint(moved - low).astype(np.int64).T
        there = np.flatnonzero((x >= 0) & (x < width) & (y >= 0) & (y < height))
        there = there[clear[y[there], x[there]]]
        found.append((moved[there], (normals @ turn.T)[there], there, np.full(len(there), number)))
    moved_points, moved_normals, of, numbers = (
        np.ascontiguousarray(np.concatenate(column)) for column in zip(*found, strict=True)
    )
    return FacePlaces(moved_points, moved_normals, of, numbers)
