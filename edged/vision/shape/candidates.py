"""The few poses worth refining, from the exhaustive scan of the top level."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.vision.shape import refine, scan
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import EACH_EDGE_ITSELF, SearchParams
from edged.vision.shape.workspace import Workspace

SCAN_SHARE = 0.55
"""Share of min_score that a pose reaches on the grid in the worst case: half a step off in everything."""
POLISHED_SHARE = 0.62
MAX_PEAKS = 1024
MAX_POLISHED = 40
"""... and two more for each match that is asked for."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose vector (see `refine`) in px of its level, the sign of the contrast, the score so far.

    scanned : its score in the scan.  slopes (N,) : of the edges that agree with it on the finest level, 0
    elsewhere.  ambiguous : another rotation explains the image as well.
    """

    pose: FloatArray
    sign: int
    score: float
    covariance: FloatArray | None = None
    scanned: float = 0.0
    slopes: FloatArray | None = None
    ambiguous: bool = False

    @cached_property
    def origin(self) -> tuple[float, float]:
        """Where the model's origin is, px of the level."""
        return float(self.pose[0]), float(self.pose[1])

    @cached_property
    def angle(self) -> float:
        """Rotation of the affine part, rad in (-pi, pi]."""
        a, b, c, d = self.pose[2:6].tolist()
        return math.atan2(c - b, a + d)

    def at(self, pose: FloatArray) -> Hypothesis:
        """The same at another pose."""
        return replace(self, pose=pose)


def scan_top(
    work: Workspace, model: ShapeModel, top: int, params: SearchParams, valid: Image | None
) -> Iterator[Hypothesis]:
    """Poses of the top level that may be the model, best first."""
    height, width = work.images[top].shape
    plan = _plan(model, top, params, height, width)
    shape = (scan.ORIENTATIONS, 2, 2, plan.rows, plan.columns)
    maps = work.buffer("maps", shape, np.int8, top)
    gx, gy = work.gradient(top)
    unsigned = params.polarity in EACH_EDGE_ITSELF
    scratch = work.buffer("directions", (2, *shape[1:]), np.float32, top)
    minimum = int((8 * params.min_contrast) ** 2)
    scan.fill_responses(gx, gy, work.mask(valid, top), minimum, unsigned, plan.pad, scratch, maps)
    threshold = int(SCAN_SHARE * params.min_score * scan.PEAK * len(plan.points))
    used_rows, used_columns = (height + 1) // 2, (width + 1) // 2
    positions = used_rows * plan.columns
    best = work.buffer("best", (2, scan.SECTORS, positions), np.int16, top)
    pose = work.buffer("pose", (2, scan.SECTORS, positions), np.int32, top)
    best[:] = 0
    inverted = params.polarity == "global"
    scan.scan(maps.reshape(-1), plan.offsets, plan.sectors, positions, threshold, inverted, best, pose)
    peaks = work.buffer("peaks", (MAX_PEAKS, 5), np.int64)
    number = scan.collect_peaks(best, used_rows, used_columns, plan.columns, threshold, peaks)
    limit = MAX_POLISHED + 2 * params.max_matches
    chosen = _choose(peaks[:number], pose, plan.poses, plan.columns, 3.2 * float(plan.steps[0]), limit)
    values = np.zeros(len(chosen))
    scan.polish(maps, plan.points, plan.directions, plan.pad, plan.steps, chosen, values)
    order = np.argsort(-values, kind="stable")[: 24 + 2 * params.max_matches]
    good = order[values[order] >= POLISHED_SHARE * params.min_score]
    return (
        Hypothesis(
            refine.start_pose(*chosen[i, :5].tolist()),
            int(chosen[i, 5]),
            float(values[i]),
            scanned=float(values[i]),
        )
        for i in good
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """What a scan needs and no image changes.

    points (N, 2), directions (N,) rad; poses (P, 3), steps (3,): see `pose_grid`; sectors (P,);
    offsets (P, N) of the points in the flat maps, whose grids have rows x columns with `pad` px of zeros.
    """

    points: FloatArray
    directions: FloatArray
    poses: FloatArray
    steps: FloatArray
    sectors: npt.NDArray[np.int64]
    offsets: npt.NDArray[np.int64]
    rows: int
    columns: int
    pad: int


@lru_cache(maxsize=16)  # a job has a few models, which stay the same from image to image
def _plan(model: ShapeModel, top: int, params: SearchParams, height: int, width: int) -> _Plan:
    level = model.levels[top]
    count = max(scan.GROUP, min(scan.TOP_POINTS, len(level.points)) // scan.GROUP * scan.GROUP)
    points, normals = level.points[:count], level.normals[:count]
    directions = np.arctan2(normals[:, 1], normals[:, 0])
    radius = float(np.linalg.norm(points, axis=1).max())
    poses, steps = pose_grid(radius, params)
    reach = int(np.ceil(radius * poses[:, 1:].max())) + 2
    rows, columns, pad = scan.map_geometry(height, width, reach)
    offsets = np.empty((len(poses), count), np.int64)
    scan.pose_offsets(points, directions, poses, rows, columns, pad, offsets)
    sectors = np.floor(poses[:, 0] * (scan.SECTORS / (2 * np.pi))).astype(np.int64) % scan.SECTORS
    return _Plan(points, directions, poses, steps, sectors, offsets, rows, columns, pad)


def pose_grid(radius: float, params: SearchParams) -> tuple[FloatArray, FloatArray]:
    """Poses (P, 3): angle, scale x, scale y, and the half steps (3,) between them (see `scan.polish`)."""
    step = scan.STEP_PX / max(radius, 1.0)
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
    peaks: npt.NDArray[np.int64],
    pose: npt.NDArray[np.int32],
    poses: FloatArray,
    columns: int,
    apart_rad: float,
    limit: int,
) -> FloatArray:
    """(N <= limit, 6) x, y, angle, scale x, scale y, sign: the best peak of each place and rotation."""
    order = np.lexsort((peaks[:, 4], peaks[:, 3], peaks[:, 2], peaks[:, 1], -peaks[:, 0]))
    _, sign, sector, y, x = peaks[order].T
    chosen = poses[pose[sign, sector, y * columns + x]]
    rows = np.ascontiguousarray(np.column_stack([2.0 * x, 2.0 * y, chosen, 1.0 - 2.0 * sign]))
    kept = np.empty(limit, np.int64)
    number = scan.best_of_each_place(rows, limit, apart_rad, kept)
    return np.ascontiguousarray(rows[kept[:number]])
