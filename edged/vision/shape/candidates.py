"""Choose the few poses of the top level's exhaustive scan to refine, and the matches that remain.

One part remains at each place, and each edge belongs to one part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from edged.domain.arrays import B8, I32, I64, FloatArray, Image
from edged.vision.geometry.rigid import wrapped
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape import refine, scan
from edged.vision.shape.ambiguity import Odds
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import CLIMB, EACH_EDGE_ITSELF, SCAN, SearchParams
from edged.vision.shape.workspace import Workspace


@dataclass(frozen=True, eq=False)
class ShapeViews:
    """Views of one shape, the taught one first.

    linear (V, 2, 2), tilt (V, 2) : image of a model point p, linear p / (1 + tilt . p), px of the finest
    level; linear has no turn of its own.  turns (V, 2) : middle and half width, rad, of the range of
    rotations at which a view can occur.
    """

    linear: FloatArray
    tilt: FloatArray
    turns: FloatArray

    @cached_property
    def max_stretch(self) -> float:
        """Largest ratio of the scales of a view."""
        sizes = np.linalg.svd(self.linear, compute_uv=False)
        return float((sizes[:, 0] / sizes[:, 1]).max())

    @cached_property
    def groups(self) -> I64:
        """(V,) number of the quadrant to which a view leans: leans to opposite sides look much alike."""
        return np.asarray(np.floor(-self.turns[:, 0] / (0.5 * np.pi) + 0.5).astype(np.int64) % 4)

    def on_level(self, view: int, level: int) -> FloatArray:
        """(6,) linear part and tilt of a view, px of a level."""
        return np.concatenate([self.linear[view].ravel(), self.tilt[view] * 2.0**level])

    def meets(self, view: int, angles_rad: FloatArray) -> B8:
        """Whether a view can occur at rotations (N,)."""
        middle, half = self.turns[view]
        return np.asarray(np.abs(wrapped(angles_rad - middle)) <= half + 1e-9)


MAX_PEAKS = 1024  # rows of a kernel's array


@dataclass(frozen=True, slots=True, eq=False)
class ShapeMatch:
    """One found shape, in px of the searched image.

    x_px, y_px : the model's origin.  angle_rad : from x to y.  scale_x, scale_y : along the model's axes.
    linear (2, 2), tilt (2,) : the map that was fitted, see `apply`; score in [0, 1].
    inverted : all contrasts are opposite to the taught ones.
    ambiguous : another rotation explains the image nearly as well.
    model : index of the model among those looked for.
    symmetric : the taught shape looks the same at other angles; this is the one nearest to the taught.
    covariance (5, 5) : of x_px, y_px, angle_rad, scale_x, scale_y, from the residuals of the edges; NaN
        for those that the mode does not fit, or if nothing was refined.
    """

    x_px: float
    y_px: float
    angle_rad: float
    scale_x: float
    scale_y: float
    score: float
    linear: FloatArray
    tilt: FloatArray
    inverted: bool
    ambiguous: bool
    model: int
    symmetric: bool
    covariance: FloatArray

    def apply(self, points_px: FloatArray) -> FloatArray:
        """Image points (N, 2) of model points (N, 2): origin + linear p / (1 + tilt . p)."""
        depth = 1 + points_px @ self.tilt
        return np.asarray(points_px @ self.linear.T / depth[:, None] + (self.x_px, self.y_px))

    def transform(self) -> FloatArray:
        """(2, 3) affine map from model points (relative to its origin) to the image."""
        return np.column_stack([self.linear, (self.x_px, self.y_px)])


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose vector (see `refine`) in px of its level, the sign of the contrast, the score so far.

    scanned : its score in the scan.  slopes (N,) : of the edges that agree with it on the finest level, 0
    elsewhere.  ambiguous : another rotation explains the image as well.  view : number of the view it was
    found in.  odds : of chance edges on the face, if measured.
    """

    pose: FloatArray
    sign: int
    score: float
    covariance: FloatArray | None = None
    scanned: float = 0.0  # not scanned
    slopes: FloatArray | None = None
    ambiguous: bool = False
    view: int = 0  # the first
    odds: Odds | None = None

    @cached_property
    def origin(self) -> tuple[float, float]:
        """Position of the model's origin, px of the level."""
        return float(self.pose[0]), float(self.pose[1])

    @cached_property
    def angle(self) -> float:
        """Rotation of the affine part, rad in (-pi, pi]."""
        a, b, c, d = self.pose[2:6].tolist()
        return math.atan2(c - b, a + d)

    def at(self, pose: FloatArray, score: float | None = None, odds: Odds | None = None) -> Hypothesis:
        """This hypothesis at another pose, with a new score and odds if there are any.

        Written out: `replace` reads every field by its name, and a search moves each hypothesis often.
        """
        return Hypothesis(
            pose,
            self.sign,
            self.score if score is None else score,
            self.covariance,
            self.scanned,
            self.slopes,
            self.ambiguous,
            self.view,
            self.odds if odds is None else odds,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Poses (N, 8) of the top level that may be the model, best first, each with the sign of its contrast.

    scores, views (N,) : from the scan, and number of the view that was found.
    """

    poses: FloatArray
    signs: I64
    scores: FloatArray
    views: I64

    def hypothesis(self, number: int) -> Hypothesis:
        """One of them, to be refined."""
        score = float(self.scores[number])
        return Hypothesis(
            self.poses[number], int(self.signs[number]), score, scanned=score, view=int(self.views[number])
        )


def scan_top(
    work: Workspace,
    model: ShapeModel,
    top: int,
    params: SearchParams,
    valid: Image | None,
    views: ShapeViews | None = None,
) -> Candidates:
    """Poses of the top level that may be the model, best first; views : how it may look, None: as taught."""
    height, width = work.images[top].shape
    plan = _plan(model, top, params, height, width, views)
    shape = (scan.ORIENTATIONS, 2, 2, plan.rows, plan.columns)
    maps = work.buffer("maps", shape, np.int8, top)
    gx, gy = work.gradient(top)
    unsigned = params.polarity in EACH_EDGE_ITSELF
    scratch = work.buffer("directions", (2, *shape[1:]), np.float32, top)
    minimum = int((8 * params.min_contrast) ** 2)
    scan.fill_responses(gx, gy, work.mask(valid, top), minimum, unsigned, plan.pad, scratch, maps)
    share, polished_share = (
        (SCAN.large_share, SCAN.large_polished_share) if plan.coarse else (SCAN.share, SCAN.polished_share)
    )
    threshold = int(share * params.min_score * scan.PEAK * len(plan.looks[0].points))
    used_rows, used_columns = (height + 1) // 2, (width + 1) // 2
    positions = used_rows * plan.columns
    best = work.buffer("best", (2, plan.groups * scan.SECTORS, positions), np.int16, top)
    pose = work.buffer("pose", (2, plan.groups * scan.SECTORS, positions), np.int32, top)
    best[:] = 0
    inverted = params.polarity == "global"
    scan.scan(maps.reshape(-1), plan.offsets, plan.sectors, positions, threshold, inverted, best, pose)
    peaks = work.buffer("peaks", (MAX_PEAKS, 5), np.int64)
    number = scan.collect_peaks(best, used_rows, used_columns, plan.columns, threshold, peaks)
    limit = SCAN.max_polished + 2 * params.max_matches
    found, apart_rad = peaks[:number], 3.2 * float(plan.steps[0])
    each = [
        _choose(found[found[:, 2] // scan.SECTORS == k], pose, plan.poses, plan.columns, apart_rad, limit)
        for k in range(plan.groups)
    ]
    chosen, grid = (np.concatenate(rows) for rows in zip(*each, strict=True))
    values, view = np.zeros(len(chosen)), plan.views[grid]
    for k in sorted(set(view.tolist())):
        look, of_view = plan.looks[k], view == k
        rows, reached = chosen[of_view], values[of_view]
        for steps in (plan.steps, 0.5 * plan.steps) if plan.coarse else (plan.steps,):
            scan.polish(maps, look.points, look.directions, plan.pad, steps, rows, reached)
        chosen[of_view], values[of_view] = rows, reached
    order = np.argsort(-values, kind="stable")[: 24 + 2 * params.max_matches]
    good = order[values[order] >= polished_share * params.min_score]
    found_view, (x, y, angle, scale_x, scale_y, sign) = view[good], chosen[good].T
    poses = refine.start_poses(x, y, angle, scale_x, scale_y)
    if views is not None:
        poses[:, 2:6] = (poses[:, 2:6].reshape(-1, 2, 2) @ plan.linear[found_view]).reshape(-1, 4)
        poses[:, 6:] = plan.tilt[found_view]
    return Candidates(poses, sign.astype(np.int64), values[good], found_view)


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """A shape as one view shows it on the top level: points (N, 2), directions (N,) rad."""

    points: FloatArray
    directions: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """The part of a scan that does not depend on the image.

    looks : one of each of V views, all with the same number of points; linear (V, 2, 2), tilt (V, 2) : of the
    views, px of the level.  poses (P, 3), steps (3,): see `pose_grid`;
    views (P,) : view of each pose; sectors (P,) : numbered separately in each of the `groups` of views;
    offsets (P, N) of the points in the flat maps, whose grids have rows x columns with `pad` px of zeros.
    coarse : with the steps of a large top level.
    """

    looks: tuple[_Look, ...]
    linear: FloatArray
    tilt: FloatArray
    poses: FloatArray
    steps: FloatArray
    views: I64
    sectors: I64
    groups: int
    offsets: I64
    rows: int
    columns: int
    pad: int
    coarse: bool


@lru_cache(maxsize=16)  # a job has a few models, which stay the same from image to image
def _plan(
    model: ShapeModel, top: int, params: SearchParams, height: int, width: int, views: ShapeViews | None
) -> _Plan:
    looks = _looks(model, top, views)
    radius = float(np.linalg.norm(looks[0].points, axis=1).max())
    coarse = views is None and top <= SCAN.large_top
    step_px = SCAN.large_step_px if coarse else SCAN.step_px if views is None else SCAN.view_step_px
    grid, steps = pose_grid(radius, params, step_px)
    kept = [grid if views is None else grid[views.meets(k, grid[:, 0])] for k in range(len(looks))]
    poses = np.concatenate(kept)
    farthest = max(float(np.linalg.norm(look.points, axis=1).max()) for look in looks)
    reach = int(np.ceil(farthest * poses[:, 1:].max())) + 2
    rows, columns, pad = scan.map_geometry(height, width, reach)
    offsets = np.empty((len(poses), len(looks[0].points)), np.int64)
    ends = np.cumsum([len(own) for own in kept])
    for look, own, end in zip(looks, kept, ends, strict=True):
        part = offsets[end - len(own) : end]
        scan.pose_offsets(look.points, look.directions, own, rows, columns, pad, part)
    sectors = np.floor(poses[:, 0] * (scan.SECTORS / (2 * np.pi))).astype(np.int64) % scan.SECTORS
    of_pose = np.repeat(np.arange(len(looks)), [len(own) for own in kept])
    groups = 1
    if views is not None:
        groups = int(views.groups.max()) + 1
        sectors = sectors + views.groups[of_pose] * scan.SECTORS
    linear, tilt = (
        (np.eye(2)[None], np.zeros((1, 2))) if views is None else (views.linear, views.tilt * 2.0**top)
    )
    return _Plan(
        looks, linear, tilt, poses, steps, of_pose, sectors, groups, offsets, rows, columns, pad, coarse
    )


def _looks(model: ShapeModel, top: int, views: ShapeViews | None) -> tuple[_Look, ...]:
    level = model.levels[top]
    count = max(scan.GROUP, min(scan.TOP_POINTS, len(level.points)) // scan.GROUP * scan.GROUP)
    points, normals = level.points[:count], level.normals[:count]
    if views is None:
        return (_Look(points, np.arctan2(normals[:, 1], normals[:, 0])),)
    looks = []
    for linear, tilt in zip(views.linear, views.tilt * 2.0**top, strict=True):
        placed = np.empty((count, 4))
        refine.place(points, normals, np.array([0.0, 0.0, *linear.ravel(), *tilt]), placed)
        seen = np.ascontiguousarray(placed[:, :2])
        looks.append(_Look(seen, np.arctan2(placed[:, 3], placed[:, 2])))
    return tuple(looks)


def pose_grid(
    radius: float, params: SearchParams, step_px: float = SCAN.step_px
) -> tuple[FloatArray, FloatArray]:
    """Poses (P, 3): angle, scale x, scale y, and the half steps (3,) between them (see `scan.polish`)."""
    step = step_px / max(radius, 1.0)
    full = params.angle_extent_rad >= 2 * np.pi - 1e-9
    number = max(1, int(np.ceil(params.angle_extent_rad / step)) + (0 if full else 1))
    angles = params.angle_start_rad + np.linspace(0, params.angle_extent_rad, number, endpoint=not full)
    half_angle = 0.5 * params.angle_extent_rad / max(number, 1)
    scales_x, half_x = _scales(params.scale_min, params.scale_max, step)
    if params.scale_y_min is None or params.scale_y_max is None:
        pairs = np.column_stack([scales_x, scales_x])
        steps = np.array([half_angle, half_x, -1.0])
    else:
        scales_y, half_y = _scales(params.scale_y_min, params.scale_y_max, step)
        pairs = np.column_stack([np.repeat(scales_x, len(scales_y)), np.tile(scales_y, len(scales_x))])
        steps = np.array([half_angle, half_x, half_y])
    poses = np.column_stack([np.repeat(angles, len(pairs)), np.tile(pairs, (len(angles), 1))])
    return poses, steps


def _scales(low: float, high: float, step: float) -> tuple[FloatArray, float]:
    number = max(1, int(np.ceil(np.log(high / low) / step)))
    spacing = (high / low) ** (1 / number)
    return low * spacing ** (np.arange(number) + 0.5), 0.5 * (spacing - 1)


def _choose(
    peaks: I64,
    pose: I32,
    poses: FloatArray,
    columns: int,
    apart_rad: float,
    limit: int,
) -> tuple[FloatArray, I64]:
    """(N <= limit, 6) x, y, angle, scale x, scale y, sign: the best peak of each place and rotation.

    Also (N,) index of each one's pose in the grid.
    """
    order = np.lexsort((peaks[:, 4], peaks[:, 3], peaks[:, 2], peaks[:, 1], -peaks[:, 0]))
    _, sign, sector, y, x = peaks[order].T
    grid = pose[sign, sector, y * columns + x].astype(np.int64)
    rows = np.empty((len(grid), 6))
    rows[:, 0], rows[:, 1], rows[:, 2:5], rows[:, 5] = 2.0 * x, 2.0 * y, poses[grid], 1.0 - 2.0 * sign
    kept = np.empty(limit, np.int64)
    number = scan.best_of_each_place(rows, limit, apart_rad, kept)
    return np.ascontiguousarray(rows[kept[:number]]), grid[kept[:number]]


@dataclass(frozen=True, eq=False)
class PlacedMatch:
    """A match and its model."""

    match: ShapeMatch
    model: ShapeModel

    @cached_property
    def outline(self) -> FloatArray:
        """(N, 4) x, y, nx, ny of the model's points in the image."""
        match, level = self.match, self.model.levels[0]
        placed = np.empty((len(level.points), 4))
        pose = np.array([match.x_px, match.y_px, *match.linear.ravel(), *match.tilt])
        refine.place(level.points, level.normals, pose, placed)
        return placed

    @property
    def size(self) -> float:
        """Mean magnification."""
        return float(np.sqrt(abs(np.linalg.det(self.match.linear))))


def without_overlap(matches: Iterable[PlacedMatch], params: SearchParams) -> list[ShapeMatch]:
    """Keep the best match at each place, best first.

    A match is dropped if it shares more than max_overlap of its area with a better one, or if it consists of
    edges that better matches of its model explain already.
    """
    kept: list[PlacedMatch] = []
    for placed in sorted(matches, key=lambda p: (-p.match.score, p.match.model, p.match.x_px, p.match.y_px)):
        if any(_share(placed, better) > params.max_overlap for better in kept):
            continue
        if _claimed(placed, kept) <= CLIMB.claimed_share * placed.match.score:
            kept.append(placed)
    return [placed.match for placed in kept[: params.max_matches]]


def disc_overlap(distance: float, radius: float) -> float:
    """Share of the area of two discs of one radius that both cover."""
    half = distance / (2 * radius)
    if half >= 1:
        return 0.0
    return 2 / math.pi * (math.acos(half) - half * math.sqrt(1 - half**2))


def _share(first: PlacedMatch, second: PlacedMatch) -> float:
    """Share of their area, taken as discs about the origins, that two matches have in common."""
    distance = np.hypot(first.match.x_px - second.match.x_px, first.match.y_px - second.match.y_px)
    return disc_overlap(float(distance), 0.5 * (first.model.radius_px + second.model.radius_px))


def _claimed(placed: PlacedMatch, kept: list[PlacedMatch]) -> float:
    """Share of a match's points that lie on the outlines of better matches of the same model."""
    if not kept:
        return 0.0
    claimed = np.zeros(len(placed.outline), np.bool_)
    for better in kept:
        reach = placed.model.radius_px * (placed.size + better.size)
        distance = math.hypot(placed.match.x_px - better.match.x_px, placed.match.y_px - better.match.y_px)
        if placed.match.model == better.match.model and distance < reach:
            gap_px = better.size * rivals.gap_px(better.model)
            claimed |= rivals.lies_on(placed.outline, better.outline, gap_px)
    return float(claimed.mean())
