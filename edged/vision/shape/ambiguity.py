"""Decide between rotations of a part for which its outline may be mistaken.

A shape coincides with part of itself at every rotation: the rim of a disc at any, its holes at some. Only the
edges that one of two rotations expects and the other does not can decide. Each of them is seen, or denied by
the bare face of the part or the bare table, or hidden; hidden ones count for neither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import B8, F64, I64, FloatArray, Image
from edged.vision.geometry.rigid import angle_between, rotation_2d, wrapped
from edged.vision.kernels.jit import for_kernel, kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN
from edged.vision.shape import refine
from edged.vision.shape.chance import (
    EVIDENCE,
    Chance,
    FacePlaces,
    chance_evidence,
    chance_of,
    chosen_places,
    elsewhere,
    look_elsewhere,
)
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import ROTATIONS

# numba freezes globals when it compiles: kernels read these by name
MIN_APART = ROTATIONS.min_apart
TEXTURED_SHARE = ROTATIONS.textured_share
WEAKER_PERCENT = ROTATIONS.weaker_percent
SURFACE_SHARE = ROTATIONS.surface_share
SPREADS = ROTATIONS.spreads
EVEN_SHARE = ROTATIONS.even_share
STRONG_SHARE = ROTATIONS.strong_share
SEEN_PERCENT = ROTATIONS.seen_percent
ACCIDENTS = ROTATIONS.accidents
ACCIDENT_SPREAD = ROTATIONS.accident_spread

Array = npt.NDArray[Any]
Flags = B8


@dataclass(frozen=True, eq=False)  # no slots: cached properties live in the instance's dictionary
class RivalTurns:
    """Rotations of a shape, most similar first.

    motions (K, 3) : dx, dy, angle in the model's plane.  own (K, N) : points of the model that lie off the
    turned outline; foreign (K, N) : points that, after the turn, lie off the model's outline.
    """

    motions: FloatArray
    own: Flags
    foreign: Flags

    @cached_property
    def counts(self) -> tuple[I64, I64]:
        """(K,) number of points of each kind, own and foreign."""
        return self.own.sum(axis=1), self.foreign.sum(axis=1)

    @property
    def similarity(self) -> FloatArray:
        """(K,) share of the outline that both have in common."""
        return np.asarray(1.0 - self.foreign.mean(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class EdgeObservation:
    """Evidence in the image where a pose expects edges.

    placed (N, 4) : x, y, nx, ny of the model's points.  slope (N,) : at the edge there, grey values per px,
    signed, 0 without one.  beside (N, 3) : grey values before, at and behind the place of the edge, NaN
    outside the image.  inward (N,) : 1 or -1 on the rim of the part, if the part lies along or against the
    normal, 0 elsewhere.  gap_px : between neighbouring points.
    """

    placed: FloatArray
    slope: FloatArray
    beside: FloatArray
    inward: I64
    gap_px: float


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Thresholds for an edge of the part, and for bare surface, in the light of one image.

    strong : slope, grey values per px.  face, around : grey value, and how much it may vary, of the part's
    face and of its surroundings; NaN where they are not even.
    """

    strong: float
    face: tuple[float, float]
    around: tuple[float, float]

    def verdicts(self, sight: EdgeObservation) -> I64:
        """(N,) 1 for points with an edge, 0 for hidden ones, -1 for those denied.

        Denied are points without an edge that show the bare face or, at the rim, the bare table.
        """
        return weigh_points(sight.slope, sight.beside, sight.inward, self.strong, *self.face, *self.around)


@kernel("i8[::1](f8[::1], f8[:, ::1], i8[::1], f8, f8, f8, f8, f8)")
def weigh_points(
    slope: F64, beside: F64, inward: I64, strong: float, face: float, face_varies: float, around: float,
    around_varies: float,
) -> I64:  # fmt: skip
    """`Surroundings.verdicts`."""
    verdicts = np.zeros(len(slope), np.int64)
    for n in range(len(slope)):
        if abs(slope[n]) >= strong:
            verdicts[n] = 1
            continue
        bare, empty = True, inward[n] != 0
        for i in range(3):  # False for NaN
            bare = bare and abs(beside[n, i] - face) < face_varies
            empty = empty and abs(beside[n, i] - around) < around_varies
        verdicts[n] = -1 if bare or empty else 0
    return verdicts


@dataclass(frozen=True, slots=True, eq=False)
class Odds:
    """Chance edges on the face of a part.

    own, foreign (T, K) : shares of these points of K `turns` that show an edge by chance.
    """

    chance: Chance
    own: FloatArray
    foreign: FloatArray


def look(
    image: Image, model: ShapeModel, pose: FloatArray, sign: int, points: npt.NDArray[Any] | None = None
) -> EdgeObservation:
    """Look for the model's edges in an image (H, W) uint8 at a pose; sign as in `edges_along_normals`.

    points : indices of the model's points that are looked for; None: all.
    """
    level = model.levels[0]
    chosen = slice(None) if points is None else points
    expected, normals = level.points[chosen], level.normals[chosen]
    placed = np.empty((len(expected), 4))
    refine.place(expected, normals, pose, placed)
    return look_at(image, model, placed, sign, chosen, _scale(pose))


def _scale(pose: FloatArray) -> float:
    """Magnification of a pose: px of the image per px of the model."""
    return float(np.sqrt(abs(pose[2] * pose[5] - pose[3] * pose[4])))


def look_at(
    image: Image,
    model: ShapeModel,
    placed: FloatArray,
    sign: int,
    points: npt.NDArray[Any] | slice,
    scale: float,
) -> EdgeObservation:
    """Look for the model's edges, or those of `points`, where they are placed (N, 4): x, y, nx, ny.

    scale : px of the image per px of the model.
    """
    slope, beside = np.empty(len(placed)), np.empty((len(placed), 3))
    refine.look_along(for_kernel(image, np.uint8), placed, sign, slope, beside)
    return EdgeObservation(placed, slope, beside, _inward(model)[points], scale * gap_px(model))


def surroundings(sight: EdgeObservation, min_contrast: float, by_chance: float = 0.0) -> Surroundings:
    """Estimate thresholds for the part's edges and bare surface from the edges that a pose shows.

    by_chance : slope of edges that the face occasionally shows where the part has none.
    """
    strong, face, face_varies, around, around_varies = light_of(
        sight.slope, sight.beside, sight.inward, min_contrast, by_chance
    )
    return Surroundings(strong, (face, face_varies), (around, around_varies))


@kernel("UniTuple(f8, 5)(f8[::1], f8[:, ::1], i8[::1], f8, f8)")
def light_of(
    slope: F64, beside: F64, inward: I64, min_contrast: float, by_chance: float
) -> tuple[float, float, float, float, float]:
    """The numbers of `surroundings`: strong, then level and variation of the face and around it."""
    strong = strong_slope(slope, min_contrast)
    inside, outside, step = _beside_rim(slope, beside, inward, strong)
    strong = max(strong, by_chance)
    if len(inside) == 0:
        return strong, np.nan, 0.0, np.nan, 0.0
    face, face_varies = _even(inside, step)
    around, around_varies = _even(outside, step)
    return strong, face, face_varies, around, around_varies


@kernel("UniTuple(f8, 2)(f8[::1], f8[:, ::1], i8[::1], f8)")
def face_greys(slope: F64, beside: F64, inward: I64, strong: float) -> tuple[float, float]:
    """Range of grey values of the face, texture included; unlimited where little is seen."""
    inside, _, step = _beside_rim(slope, beside, inward, strong)
    if len(inside) == 0:
        return -np.inf, np.inf
    level = median(inside)
    return level - TEXTURED_SHARE * step, level + TEXTURED_SHARE * step


@kernel()
def _beside_rim(slope: F64, beside: F64, inward: I64, strong: float) -> tuple[F64, F64, float]:
    """Grey values inside and outside of the rim, and the step of a weaker edge; none where little is seen."""
    inside, outside, steps = np.empty(len(slope)), np.empty(len(slope)), np.empty(len(slope))
    seen = many = 0
    for n in range(len(slope)):
        if not (abs(slope[n]) >= strong and np.isfinite(beside[n]).all()):
            continue
        steps[seen] = abs(beside[n, 2] - beside[n, 0])
        seen += 1
        if inward[n] != 0:
            ahead = inward[n] > 0
            inside[many], outside[many] = beside[n, 2 if ahead else 0], beside[n, 0 if ahead else 2]
            many += 1
    if many < MIN_APART:
        return inside[:0], outside[:0], np.nan
    return inside[:many], outside[:many], _percentile(steps[:seen], WEAKER_PERCENT)


@kernel()
def _even(greys: F64, step: float) -> tuple[float, float]:
    """The grey value of a surface beside edges of a step, and how much it may vary; NaN if it is not even."""
    level = median(greys)
    sigma = SIGMA_PER_MEDIAN * median(np.abs(greys - level))
    if 1.35 * sigma >= SURFACE_SHARE * step:
        return np.nan, 0.0
    return level, min(max(SPREADS * sigma, EVEN_SHARE * step), SURFACE_SHARE * step)


def odds_on_face(
    image: Image, model: ShapeModel, pose: FloatArray, sign: int, min_contrast: float, slopes: FloatArray
) -> Odds:
    """Measure chance edges on the face at a pose, by the points that distinguish its rotations.

    slopes (N,) : at the edges where the pose expects them, 0 where there is none.
    """
    found, pixels = _telling(model), for_kernel(image, np.uint8)
    placed, beside = np.empty((len(found.rim), 4)), np.empty((len(found.rim), 3))
    refine.place(found.rim_points, found.rim_normals, pose, placed)
    refine.look_along(pixels, placed, sign, np.empty(len(placed)), beside)
    strong = strong_slope(slopes, min_contrast)
    darkest, brightest = face_greys(slopes[found.rim], beside, found.inward, strong)
    elsewhere_slopes = np.empty(len(found.places.of))
    look_elsewhere(pixels, found.places, pose, sign, darkest, brightest, elsewhere_slopes)
    chance = chance_of(elsewhere_slopes, found.places, found.sets, strong)
    shares = chance.shares(found.sets)
    return Odds(chance, shares.take(found.own, axis=1), shares.take(found.foreign, axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class _Telling:
    """Points of a model that tell its rotations apart, and where to look for them by chance.

    sets (S, N) : of points, see `_distinguishing_points`.  own, foreign (K,) : set of each of K `turns`.
    places : where they are looked at elsewhere.  rim (R,) : points of the part's rim, with their
    rim_points, rim_normals (R, 2) and inward (R,), see `EdgeObservation`.
    """

    sets: Flags
    own: I64
    foreign: I64
    places: FacePlaces
    rim: I64
    rim_points: FloatArray
    rim_normals: FloatArray
    inward: I64


@lru_cache(maxsize=16)
def _telling(model: ShapeModel) -> _Telling:
    level, sets, inward = model.levels[0], _distinguishing_points(model), _inward(model)
    near = len(sets) // 2
    rest = np.full(len(turns(model).motions) - near, 2 * near)
    own, foreign = (np.append(first + np.arange(near), rest) for first in (0, near))
    places, rim = chosen_places(elsewhere(model), np.asarray(sets.any(axis=0))), np.flatnonzero(inward)
    return _Telling(sets, own, foreign, places, rim, level.points[rim], level.normals[rim], inward[rim])


def _distinguishing_points(model: ShapeModel) -> Flags:
    """Sets of points (2 K + 1, N) that distinguish the model from the K rotations that are most like it.

    Its own points against each, then theirs; then an empty set for rotations that are less alike and differ
    all over: these are judged by all points that were looked at.
    """
    found = turns(model)
    nothing = np.zeros((1, len(model.levels[0].points)), np.bool_)
    return np.concatenate([found.own[: ROTATIONS.telling], found.foreign[: ROTATIONS.telling], nothing])


def unresolved_rotations(
    image: Image,
    model: ShapeModel,
    pose: FloatArray,
    sign: int,
    min_contrast: float,
    slopes: FloatArray,
    odds: Odds,
) -> list[int]:
    """Indices of `turns` that the image does not rule out against a pose, the most likely ones first.

    slopes (N,) : at the edges where the pose expects them, 0 where there is none.
    First by the edges that only the pose expects: if the image shows enough of them, no other rotation is
    possible. Where some of them are hidden, by the edges that only the other rotation expects, too.
    """
    all_turns, chance = turns(model), odds.chance
    own, (count, _) = all_turns.own, all_turns.counts
    strong = max(strong_slope(slopes, min_contrast), chance.thresholds[0])
    doubtful = doubtful_turns(own, chance, np.abs(slopes), strong, odds.own)
    if not len(doubtful):
        return []
    sight = look(image, model, pose, sign)
    light = surroundings(sight, min_contrast, chance.thresholds[0])
    seen = light.verdicts(sight)
    foreign = [np.flatnonzero(all_turns.foreign[k]) for k in doubtful]
    turned_poses = [turned(pose, all_turns.motions[k]) for k in doubtful]
    others = _look_at_each(image, model, turned_poses, sign, foreign)
    others_seen = light.verdicts(others)
    ends = np.cumsum([len(points) for points in foreign])
    theirs = np.zeros(all_turns.foreign[doubtful].shape)
    theirs[all_turns.foreign[doubtful]] = np.abs(others.slope)
    mine, yours = odds.own[:, doubtful], odds.foreign[:, doubtful]
    credit = chance.evidence(own[doubtful], np.abs(sight.slope), light.strong, mine)
    credit -= chance.evidence(all_turns.foreign[doubtful], theirs, light.strong, yours)
    left: list[tuple[float, int]] = []
    for k, points, end, nats in zip(doubtful, foreign, ends, credit, strict=True):
        part = slice(end - len(points), end)
        mine_seen, theirs_seen = seen[own[k]], others_seen[part]
        beyond_chance = (mine_seen > 0) & (nats >= EVIDENCE)
        ahead = _lead(beyond_chance, mine_seen < 0, theirs_seen > 0, theirs_seen < 0)
        if ahead < 0 or max(len(points), count[k]) < ROTATIONS.min_apart:
            left.append((ahead, int(k)))
    return [k for _, k in sorted(left)]


def _look_at_each(
    image: Image, model: ShapeModel, poses: list[FloatArray], sign: int, points: list[I64]
) -> EdgeObservation:
    """`look` at several poses of one size, each at points of its own, all of them one after the other.

    Forty rotations of a dozen points each, looked at together, take a fifth of the time.
    """
    level, size = model.levels[0], [len(indices) for indices in points]
    placed = np.empty((sum(size), 4))
    for pose, chosen, end in zip(poses, points, np.cumsum(size), strict=True):
        rows = placed[end - len(chosen) : end]
        refine.place(level.points[chosen], level.normals[chosen], pose, rows)
    return look_at(image, model, placed, sign, np.concatenate(points), _scale(poses[0]))


@kernel("f8(f8[::1], f8)")
def strong_slope(slopes: F64, min_contrast: float) -> float:
    """Slope, grey values per px, from which an edge may be the part's; slopes (N,) at all of its points."""
    return max(STRONG_SHARE * _percentile(np.abs(slopes), SEEN_PERCENT), min_contrast)


@kernel()
def _percentile(values: F64, percent: int) -> float:
    """The value below which this percentage of values lies, by rank."""
    return float(np.sort(values)[len(values) * percent // 100])


@kernel("i8[::1](b1[:, ::1], Chance, f8[::1], f8, f8[:, ::1])", tuples=(Chance,))
def doubtful_turns(own: Flags, chance: Chance, slopes: F64, strong: float, shares: F64) -> I64:
    """Indices of the turns of whose points, own (K, N), too few show an edge for certain; slopes (N,)."""
    nats = chance_evidence(chance, own, slopes.reshape((1, len(slopes))), strong, shares)
    for k in range(len(own)):
        count = speaking = 0
        for n in range(len(slopes)):
            count += own[k, n]
            speaking += own[k, n] and slopes[n] >= strong
        if speaking < ACCIDENTS * count + ACCIDENT_SPREAD * np.sqrt(count):
            nats[k] = -np.inf
    return np.flatnonzero(nats < EVIDENCE)


def decides(
    image: Image,
    model: ShapeModel,
    poses: tuple[FloatArray, FloatArray],
    signs: tuple[int, int],
    min_contrast: float,
    odds: Odds,
) -> bool | None:
    """Whether an image favours the first of two poses of a model; None where they hardly differ.

    signs : as in `edges_along_normals`, one for each.  odds : of the part at this place.
    """
    first, second = (look(image, model, pose, sign) for pose, sign in zip(poses, signs, strict=True))
    only_first = ~lies_on(first.placed, second.placed, second.gap_px)
    only_second = ~lies_on(second.placed, first.placed, first.gap_px)
    if max(only_first.sum(), only_second.sum()) < ROTATIONS.min_apart:
        return None
    light = surroundings(first, min_contrast, odds.chance.thresholds[0])
    first_seen, second_seen = light.verdicts(first)[only_first], light.verdicts(second)[only_second]
    slopes = np.abs(np.array([first.slope, second.slope]))
    sets = np.array([only_first, only_second])
    nats = odds.chance.evidence(sets, slopes, light.strong, odds.chance.shares(sets))
    ahead = _lead(
        (first_seen > 0) & (nats[0] - nats[1] >= EVIDENCE),
        first_seen < 0,
        second_seen > 0,
        second_seen < 0,
    )
    return ahead >= 0


def _lead(shown: Flags, denied: Flags, others_shown: Flags, others_denied: Flags) -> float:
    """Margin by which edges expected by only one of two rotations outweigh those expected only by the other.

    Negative if it is smaller than required. Texture and clutter show edges to both alike: the difference
    counts.
    """
    excess, fewest = 0.0, math.inf
    for there, bare, side in ((shown, denied, 1), (others_shown, others_denied, -1)):
        if len(there):
            excess += side * (np.count_nonzero(there) - np.count_nonzero(bare)) / len(there)
            fewest = min(fewest, len(there))
    return excess - ROTATIONS.decided - ROTATIONS.chance / math.sqrt(fewest)


def turned(pose: FloatArray, motion: FloatArray) -> FloatArray:
    """The pose after a motion dx, dy, angle in the model's own plane; the tilt turns with it."""
    turn = rotation_2d(motion[2])
    linear = pose[2:6].reshape(2, 2)
    moved = pose.copy()
    moved[:2] = pose[:2] + linear @ motion[:2]
    moved[2:6] = (linear @ turn).ravel()
    moved[6:] = pose[6:] @ turn
    return moved


@lru_cache(maxsize=16)
def turns(model: ShapeModel) -> RivalTurns:
    """Every rotation at which the outline of a model can be laid on itself, from its points alone.

    The rotations that teaching found similar are only some of the starts: the search allows perspective and
    edges of either sign, and so it may accept a rotation that teaching did not list.
    """
    level = model.levels[0]
    grid = np.arange(1, ROTATIONS.turns) * (2 * math.pi / ROTATIONS.turns)
    starts = [np.array(row[:3]) for row in model.symmetries]
    starts += [about(model.centre_px, float(angle)) for angle in grid]
    at_rest = np.column_stack([level.points, level.normals])
    order = np.argsort(level.points[:, 0], kind="stable")
    outline = np.ascontiguousarray(at_rest[order])
    gap = gap_px(model)
    motions: list[FloatArray] = []
    flags: list[tuple[Flags, Flags]] = []
    for start in starts:
        motion = _settled(model, start, outline, gap)
        angle = wrapped(float(motion[2]))
        if abs(angle) < ROTATIONS.min_turn_rad or any(
            angle_between(angle, m[2]) < ROTATIONS.same_turn_rad for m in motions
        ):
            continue
        placed = np.empty((len(level.points), 4))
        refine.place(level.points, level.normals, turned(_IDENTITY, motion), placed)
        motions.append(np.array([motion[0], motion[1], angle]))
        flags.append((~lies_on(at_rest, placed, gap), ~lies_on(placed, at_rest, gap)))
    if not motions:
        none = np.zeros((0, len(level.points)), np.bool_)
        return RivalTurns(np.zeros((0, 3)), none, none)
    own, foreign = np.array([own for own, _ in flags]), np.array([foreign for _, foreign in flags])
    best = np.argsort(foreign.sum(axis=1), kind="stable")
    return RivalTurns(np.array(motions)[best], own[best], foreign[best])


_IDENTITY = refine.start_pose(0.0, 0.0, 0.0, 1.0, 1.0)  # no motion, no turn, same size


def about(centre: FloatArray, angle_rad: float) -> FloatArray:
    """The motion dx, dy, angle of a turn about a point."""
    return np.array([*(centre - rotation_2d(angle_rad) @ centre), angle_rad])


def _settled(model: ShapeModel, motion: FloatArray, outline: FloatArray, gap: float) -> FloatArray:
    """The motion near this one that lays most of the outline on itself; unchanged if there is none."""
    points, normals = model.levels[0].points, model.levels[0].normals
    pose = turned(_IDENTITY, motion)
    placed, edges = np.empty((len(points), 4)), np.empty((len(points), 2))
    result = refine.no_step()
    for reach in ROTATIONS.meeting_px:
        refine.place(points, normals, pose, placed)
        meet(placed, outline, reach, 3.0 * max(gap, 1.0), ROTATIONS.alike, edges)
        if not refine.robust_step(points, placed, edges, pose, refine.RIGID, 1.0, 8, result):
            return motion
    return np.array([pose[0], pose[1], math.atan2(pose[4], pose[2])])


def lies_on(placed: FloatArray, other: FloatArray, gap_px: float) -> Flags:
    """Which of placed points (N, 4), x, y, nx, ny, lie on the outline that `other` (M, 4) samples sparsely.

    gap_px : between neighbours on that outline.
    """
    edges = np.empty((len(placed), 2))
    outline = np.ascontiguousarray(other[np.argsort(other[:, 0], kind="stable")])
    meet(placed, outline, ROTATIONS.apart_px, 3.0 * max(gap_px, 1.0), ROTATIONS.alike, edges)
    return np.isfinite(edges[:, 0])


@lru_cache(maxsize=16)
def _inward(model: ShapeModel) -> I64:
    """1 or -1 for points (N,) on the convex hull, if the part lies along or against the normal; else 0."""
    points, normals = model.levels[0].points, model.levels[0].normals
    hull = points[cv2.convexHull(points.astype(np.float32), returnPoints=False)[:, 0]]
    along = np.roll(hull, -1, axis=0) - hull
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    distance = np.abs(np.einsum("nmk,mk->nm", points[:, None] - hull[None], across)).min(axis=1)
    faces = np.sign(np.einsum("nk,nk->n", normals, hull.mean(axis=0) - points))
    return np.where(distance < ROTATIONS.apart_px, faces, 0).astype(np.int64)


@lru_cache(maxsize=16)
def gap_px(model: ShapeModel) -> float:
    """Median distance of a model point to its nearest neighbour."""
    points = model.levels[0].points
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    np.fill_diagonal(gaps, np.inf)
    return float(np.median(gaps.min(axis=1)))


@kernel("void(f8[:, ::1], f8[:, ::1], f8, f8, f8, f8[:, ::1])")
def meet(
    points: Array, outline: Array, across_px: float, along_px: float, alike: float, edges: Array
) -> None:
    """Write for each of points (N, 4), x, y, nx, ny, how it meets an outline (M, 4), sorted by x.

    edges (N, 2) : offset px along its normal to the nearest point of the outline that lies within across_px
    along its normal and along_px along its tangent, with a normal whose cosine to its own is more than
    `alike`, either sign, and that cosine; NaN and 0 where there is none.
    """
    reach = np.sqrt(across_px * across_px + along_px * along_px)
    for n in range(points.shape[0]):
        x, y, nx, ny = points[n, 0], points[n, 1], points[n, 2], points[n, 3]
        edges[n, 0], edges[n, 1] = np.nan, 0.0
        nearest = np.inf
        m, end = 0, outline.shape[0]
        while m < end:  # binary search: the first one that is not farther left than reach
            middle = (m + end) // 2
            if outline[middle, 0] < x - reach:
                m = middle + 1
            else:
                end = middle
        while m < outline.shape[0] and outline[m, 0] <= x + reach:
            dx, dy = outline[m, 0] - x, outline[m, 1] - y
            off, beside = dx * nx + dy * ny, dx * ny - dy * nx
            cosine = abs(nx * outline[m, 2] + ny * outline[m, 3])
            distance = off * off + beside * beside
            if abs(off) < across_px and abs(beside) < along_px and cosine > alike and distance < nearest:
                nearest = distance
                edges[n, 0], edges[n, 1] = off, cosine
            m += 1
