"""Measure edges by chance: those that the bare face shows, in this picture, where the part has no edge.

Grinding, turning and milling leave a texture that is full of edges. How many of them a curve meets depends on
the surface, the light and the curve: a curve concentric with rings meets them all along, others do not;
streaks are met by curves along them. So chance is measured where it matters: the very points that distinguish
two rotations are turned about the part's middle to where the face has no edge of its own, and examined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import B8, I64, FloatArray, Image
from edged.vision.edges.subpixel import edge_profiles, edges_along_normals
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.shape import refine
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import ROTATIONS

EVIDENCE = -math.log(ROTATIONS.mistakes)
"""Nats of evidence that decide for a rotation: chance shows as much in a share `mistakes` of pictures."""
PLACES = 23
"""Steps of a full turn by which points are turned to places elsewhere: prime, so that none is a part's
symmetry."""
Array = npt.NDArray[Any]
Flags = B8


@dataclass(frozen=True, slots=True, eq=False)
class FacePlaces:
    """Points of a model, turned about its middle to where its face has no edge.

    points, normals (C, 2) : as `ShapeLevel`.  of (C,) : index of the model's point.  place (C,) : number of
    the rotation, below PLACES.
    """

    points: FloatArray
    normals: FloatArray
    of: I64
    place: I64


@dataclass(frozen=True, slots=True, eq=False)
class Chance:
    """Edges that the model's points show elsewhere on its face.

    known (U,) : indices of the model's points.  looked (U,), met (T, U) : number of places where the bare
    face was seen, and of those with an edge.  thresholds (T,) : slopes from which an edge may count,
    ascending; chance exceeds the first at the first of the shares `rare`, and so on.  repeated, many : factor
    by which the number of edges of a set scatters more than that of independent points, and the mean number
    of points that it was estimated from.
    """

    known: I64
    looked: FloatArray
    met: FloatArray
    thresholds: FloatArray
    repeated: float = 1.0  # independent points
    many: float = 1.0  # single points

    @staticmethod
    def of(known: I64, slope: FloatArray, thresholds: FloatArray, scatter: tuple[float, float]) -> Chance:
        """From slopes (PLACES, U) of the edges at each place, 0 without one, NaN where no face was seen."""
        looked = np.count_nonzero(np.isfinite(slope), axis=0).astype(np.float64)
        met = np.count_nonzero(slope >= thresholds[:, None, None], axis=1).astype(np.float64)  # False for NaN
        return Chance(known, looked, met, thresholds, *scatter)

    def shares(self, sets: Flags) -> FloatArray:
        """Shares (T, K) of K sets (K, N) of the model's points that show an edge by chance."""
        members = sets[:, self.known].T.astype(np.float64)
        looked, met = self.looked @ members, self.met @ members
        few = looked < ROTATIONS.few_looks
        looked[few], met[:, few] = self.looked.sum(), self.met.sum(axis=1)[:, None]
        return np.asarray(np.where(looked > 0, (met + 0.5) / (looked + 1.0), ROTATIONS.unknown))

    def evidence(self, sets: Flags, slopes: FloatArray, strong: float, shares: FloatArray) -> FloatArray:
        """Nats (K,) by which chance is unlikely to show as many edges in each of K sets of points.

        sets (K, N) : points of the model, with their `shares`.  slopes (N,) or (K, N) : strength of the edge
        that each shows.  strong : lower limit of the slopes that count.
        A share s of n independent points, where chance shows a share p, is reached with a probability below
        exp(-n KL(s, p)) (H. Chernoff, 1952). The threshold with most evidence decides, less the price of
        having chosen it.
        """
        count = np.maximum(np.count_nonzero(sets, axis=1), 1)
        levels = np.maximum(self.thresholds, strong)
        shown = np.stack([np.count_nonzero(sets & (slopes >= level), axis=1) for level in levels])
        seen = np.clip(shown / count, shares, 1.0)
        rest = (1.0 - seen) * np.log(np.maximum(1.0 - seen, 1e-12) / (1.0 - shares))
        nats = self._independent(count) * (seen * np.log(seen / shares) + rest)
        return np.asarray(nats.max(axis=0) - math.log(len(levels)))

    def _independent(self, count: Array) -> FloatArray:
        """The number of independent points equivalent to points on a few curves."""
        shared = (self.repeated - 1.0) / max(self.many - 1.0, 1.0)
        return np.asarray(
            count / (1.0 + (np.minimum(count, ROTATIONS.curve_points) - 1.0) * min(shared, 1.0))
        )


def clumping(slope: FloatArray, known: I64, sets: Flags, often: float) -> tuple[float, float]:
    """Excess scatter of the number of edges of a set over independent points, and its mean number of points.

    slope (PLACES, U), known (U,) : as in `Chance.of`.  sets (K, N) : points that lie on a curve or two.
    often : slope that chance exceeds often enough for an estimate.
    Rings and streaks are met by many points at once, or by none: the number of edges scatters from place to
    place like that of fewer points (beta-binomial).
    """
    members = sets[:, known].T.astype(np.float32)
    looked = np.isfinite(slope).astype(np.float32) @ members
    met = (slope >= often).astype(np.float32) @ members  # False for NaN
    used = looked > 1
    places = np.count_nonzero(used, axis=0)
    judged = (places > ROTATIONS.few_places) & (met.sum(axis=0) > 0)
    if not judged.any():
        return 1.0, 1.0
    looked, met, used = looked[:, judged], met[:, judged], used[:, judged]
    share = met.sum(axis=0) / np.maximum(looked.sum(axis=0), 1.0)
    scatter = (met - looked * share) ** 2 / np.maximum(looked * share * (1.0 - share), 1e-9)
    freedom = (places[judged] - 1).sum()
    return max(float(scatter[used].sum()) / float(freedom), 1.0), float(looked[used].mean())


def sample_face(
    image: Image,
    model: ShapeModel,
    pose: FloatArray,
    sign: int,
    sets: Flags,
    reach_px: tuple[float, float],
    face: tuple[float, float],
    strong: float,
) -> Chance:
    """Look at points of a model elsewhere on the face of the part at a pose, in an image (H, W) uint8.

    sets (K, N) : which of its points; those of one set lie together.  sign : as in `edges_along_normals`.
    reach_px : how far from a point its edge is looked for, and grey values beside it are taken.  face :
    lowest and highest grey value of the face; where it is darker or brighter, there is a hole or something
    else that is no texture.  strong : slope from which an edge may be the part's.
    """
    all_places = elsewhere(model)
    chosen = _chosen(all_places, np.asarray(sets.any(axis=0)))
    placed = np.empty((len(chosen), 4))
    refine.place(all_places.points[chosen], all_places.normals[chosen], pose, placed)
    reach, aside = reach_px
    beside, _ = edge_profiles(image, placed[:, :2], placed[:, 2:], aside, aside)
    on_face = ((beside > face[0]) & (beside < face[1])).all(axis=1)  # False for NaN
    placed, chosen = np.ascontiguousarray(placed[on_face]), chosen[on_face]
    offsets, slopes = edges_along_normals(image, placed[:, :2], placed[:, 2:], reach, sign)
    slope = np.where(np.abs(offsets) < refine.AGREES_PX, np.abs(slopes), 0.0)  # False for NaN
    known, column = np.unique(all_places.of[chosen], return_inverse=True)
    table = np.full((PLACES, len(known)), np.nan)
    table[all_places.place[chosen], column] = slope
    exceeded = _exceeded(slope)
    levels = np.maximum(exceeded[:-1], ROTATIONS.min_slope)
    scatter = max(clumping(table, known, sets, float(level)) for level in levels)
    return Chance.of(known, table, np.maximum(exceeded[1:], strong), scatter)


def _exceeded(slope: FloatArray) -> FloatArray:
    """Slopes that the shares `often` and `rare` of slopes (C,) exceed; 0 without any."""
    wanted = np.array((ROTATIONS.often, *ROTATIONS.rare))
    if not len(slope):
        return np.zeros(len(wanted))
    ranks = np.ceil((1.0 - wanted) * len(slope)).astype(int) - 1
    return np.asarray(np.partition(slope, ranks)[ranks])


def _chosen(all_places: FacePlaces, points: Flags) -> I64:
    """Indices of the points to look at: curves as whole as possible, at as many places as time allows."""
    # the model's points come in random order: the first ones are as good as any
    some = points & (np.cumsum(points) <= ROTATIONS.max_points)
    found = np.flatnonzero(some[all_places.of])
    scattered = all_places.place[found] * ROTATIONS.stride % PLACES
    return np.asarray(found[np.argsort(scattered, kind="stable")][: ROTATIONS.max_looks])


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
    for place in range(1, PLACES):
        turn = rotation_2d(2 * math.pi * place / PLACES)
        moved = (points - centre) @ turn.T + centre
        x, y = np.rint(moved - low).astype(np.int64).T
        there = np.flatnonzero((x >= 0) & (x < width) & (y >= 0) & (y < height))
        there = there[clear[y[there], x[there]]]
        found.append((moved[there], (normals @ turn.T)[there], there, np.full(len(there), place)))
    return FacePlaces(*(np.ascontiguousarray(np.concatenate(column)) for column in zip(*found, strict=True)))
