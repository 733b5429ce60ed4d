"""Learn a shape from a picture: which edges, on which levels, and what it may be mistaken for.

Thin lines vanish in the averages of the pyramid: their two edges come so close that a pose half a grid step
off meets the wrong one. The exhaustive scan must not begin on a level on which the shape is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import I64, FloatArray, Image
from edged.errors import TeachError
from edged.vision.edges.hysteresis import EdgeThresholds, strong_edges
from edged.vision.edges.params import OUTLINES
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.kernels.jit import kernel
from edged.vision.shape import scan
from edged.vision.shape.model import ShapeLevel, ShapeModel
from edged.vision.shape.params import LEARNING, MAX_LEVELS, ROTATIONS, SCAN, ModelParams
from edged.vision.shape.symmetry import Level, find_symmetry
from edged.vision.shape.workspace import Workspace


def create_model(
    image: Image, mask: Image, origin_px: FloatArray | None = None, params: ModelParams | None = None
) -> ShapeModel:
    """Learn the shape inside a mask.

    image : (H, W) uint8, rectified.  mask : (H, W) uint8, non-zero where the part is.
    origin_px (2,) : the point whose position a match reports; default: the centre of the mask.
    params : thresholds and levels; by default all follow from the region.
    Raises `TeachError` when there are too few edges.
    """
    if image.dtype != np.uint8 or image.ndim != 2 or image.shape != mask.shape:
        raise TeachError(
            f"a model needs an 8-bit grey image and a mask of its size, got {image.shape}, {mask.shape}"
        )
    ys, xs = np.nonzero(mask)
    if len(xs) < LEARNING.min_pixels:
        raise TeachError(
            f"the region is empty or tiny: expected at least {LEARNING.min_pixels} pixels", "small_region"
        )
    low, high = np.array([xs.min(), ys.min()], float), np.array([xs.max(), ys.max()], float)
    middle, half = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
    origin = middle if origin_px is None else np.asarray(origin_px, dtype=np.float64)
    if not (origin.shape == (2,) and np.linalg.norm(origin - middle) <= LEARNING.max_origin * half):
        raise TeachError(f"origin {origin.tolist()}: expected a pixel x, y in the region or near it")
    corner = _corner(middle - half)
    x1, y1 = np.ceil(middle + half).astype(int) + LEARNING.margin_px
    image = np.ascontiguousarray(image[corner[1] : y1, corner[0] : x1])
    mask = np.ascontiguousarray(mask[corner[1] : y1, corner[0] : x1])
    model = _learnt(image, mask, origin - corner, params or ModelParams())
    return replace(model, origin_px=origin)


def _corner(low: FloatArray) -> I64:
    """Upper left corner of the picture around a region, aligned with the pixels of every level."""
    step = 2 ** (MAX_LEVELS - 1)
    return np.asarray(np.maximum(np.floor((low - LEARNING.margin_px) / step), 0) * step, np.int64)


def _learnt(image: Image, mask: Image, origin: FloatArray, params: ModelParams) -> ShapeModel:
    """Learn the model of a region from the picture around it."""
    levels, contrast = _levels(image, mask, origin, params)
    if not levels:
        raise TeachError(
            "the region shows too few edges for a model: expected at least "
            f"{OUTLINES.min_points} edge points; is the part inside the region, lit and in focus?",
            "few_edges",
        )
    levels = levels[: surviving_levels(image, origin, levels)]
    radius = float(np.linalg.norm(levels[0].points, axis=1).max())
    symmetry = find_symmetry(image, origin, levels, contrast)
    return ShapeModel(
        tuple(levels),
        origin,
        radius,
        contrast,
        symmetry.rotations,
        symmetry.centre_px,
        symmetry.round,
        repetition(levels[0].points),
    )


def _levels(
    image: Image, mask: Image, origin: FloatArray, params: ModelParams
) -> tuple[list[ShapeLevel], float]:
    """Points of each level, finest first, as far up as there are enough; also the finest's median slope."""
    levels: list[ShapeLevel] = []
    contrast = 0.0
    apart_px = np.zeros(image.shape, np.float32)  # to the nearest edge of the finest level, once it is known
    for index in range(params.levels or MAX_LEVELS):
        seen = np.asarray(mask * (apart_px <= LEARNING.support_px * 2**index), np.uint8)
        extracted = _edge_points(
            image, seen, LEARNING.smoothing_px[min(index, 2)], params.edges if index == 0 else None
        )
        if extracted is None:
            break
        level_origin = (origin + 0.5) / 2**index - 0.5
        relative = extracted.points - level_origin
        if levels and np.linalg.norm(relative, axis=1).max() < LEARNING.min_top_radius_px:
            break
        keep = _spread(relative, LEARNING.max_points[index])
        normals = extracted.normals[keep]
        levels.append(ShapeLevel(np.ascontiguousarray(relative[keep]), np.ascontiguousarray(normals)))
        if index == 0:
            contrast = extracted.slope
            apart_px = np.asarray(cv2.distanceTransform(1 - extracted.thin, cv2.DIST_L2, 3), np.float32)
        height, width = image.shape
        if min(height, width) < 32:
            break
        # as the search builds its pyramid: a last odd row or column is left out
        half = (width // 2, height // 2)
        image = np.asarray(
            cv2.resize(image[: 2 * half[1], : 2 * half[0]], half, interpolation=cv2.INTER_AREA), np.uint8
        )
        mask = np.asarray(mask[: 2 * half[1] : 2, : 2 * half[0] : 2], np.uint8)
        apart_px = apart_px[: 2 * half[1] : 2, : 2 * half[0] : 2]
    return levels, contrast


@kernel("f8(f8[:, ::1])")
def repetition(points: FloatArray) -> float:
    """Sum of correlations of a point's noise with that of all points, averaged; 1 for points far apart.

    Bicubic samples of white noise half a pixel apart correlate by about 0.6: a Gaussian of sigma 0.5 px.
    """
    total = 0.0
    for n in range(len(points)):
        for m in range(n):
            dx, dy = points[n, 0] - points[m, 0], points[n, 1] - points[m, 1]
            squared = dx * dx + dy * dy
            if squared < 9.0:  # beyond it the correlation is below 2e-8
                total += np.exp(-2.0 * squared)
    return 1.0 + 2.0 * total / len(points)


@dataclass(frozen=True, slots=True, eq=False)
class _EdgePoints:
    """points (N, 2), normals (N, 2) unit gradients; slope : median there; thin (H, W) : their pixels."""

    points: FloatArray
    normals: FloatArray
    slope: float
    thin: Image


def _edge_points(
    image: Image, mask: Image, smoothing_px: float, thresholds: EdgeThresholds | None
) -> _EdgePoints | None:
    """The strong edges in the mask, measured; None when there are too few for a level."""
    edges = strong_edges(image, mask, thresholds, smoothing_px)
    if edges is None:
        return None
    ys, xs = np.nonzero(edges.thin)
    points = np.column_stack([xs, ys]).astype(np.float64)
    normals = np.column_stack([edges.gx[ys, xs], edges.gy[ys, xs]]).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # measured with the operator that will measure the image: its bias at corners and arcs cancels
    offsets, slopes = _measured(image, points, normals)
    good = np.isfinite(offsets)
    if good.sum() < OUTLINES.min_points:
        return None
    points = points[good] + normals[good] * offsets[good, None]
    return _EdgePoints(points, normals[good], float(np.median(slopes[good])), edges.thin)


def _measured(image: Image, points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`edges_along_normals`; at the border of a tightly cut template, with its border pixels replicated."""
    offsets, slopes = edges_along_normals(image, points, normals, 1.5, 1)
    height, width = image.shape
    inside = np.minimum(points, np.array([width - 1.0, height - 1.0]) - points).min(axis=1)
    cut = np.flatnonzero((inside < LEARNING.padding_px) & ~np.isfinite(offsets))
    if len(cut):
        padded = np.asarray(
            cv2.copyMakeBorder(image, *(LEARNING.padding_px,) * 4, cv2.BORDER_REPLICATE), np.uint8
        )
        offsets[cut], slopes[cut] = edges_along_normals(
            padded, points[cut] + LEARNING.padding_px, normals[cut], 1.5, 1
        )
    return offsets, slopes


def _spread(points: FloatArray, count: int) -> npt.NDArray[np.intp]:
    """Indices of at most `count` points, spread evenly along the edges, in a fixed random order."""
    order = np.random.default_rng(0).permutation(len(points))
    if len(points) <= count:
        return order
    # the largest distance at which enough points remain: points closer than that repeat each other
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    best, shuffled = order[:count], points[order]
    for _ in range(12):
        middle = 0.5 * (low + high)
        columns, rows = np.floor(shuffled / max(middle, 1e-9)).astype(np.int64).T
        numbers = (rows - rows.min()) * (int(np.ptp(columns)) + 1) + columns - columns.min()
        cells = np.unique(numbers, return_index=True)[1]
        if len(cells) >= count:
            low, best = middle, order[np.sort(cells)][:count]
        else:
            high = middle
    return best


def surviving_levels(image: Image, origin_px: FloatArray, levels: Sequence[Level]) -> int:
    """Number of levels (at least 1) up to the highest whose edges are found again on the turned image.

    image : (H, W) uint8, taught.  origin_px (2,).  levels : finest first.
    """
    for count in range(len(levels), 1, -1):
        level = levels[count - 1]
        trials = np.array(
            [_similarity(image, origin_px, level, count - 1, pose) for pose in SCAN.trial_poses]
        )
        on_grid, off_grid = trials.mean(axis=0)
        if on_grid > SCAN.on_grid and off_grid > SCAN.off_grid:
            return count
    return 1


def _similarity(
    image: Image, origin_px: FloatArray, level: Level, index: int, pose: tuple[float, float, float]
) -> tuple[float, float]:
    """Similarity of a level's edges with the image after a known motion: at it, and half a grid step off."""
    angle, shift = pose[0], 2.0**index * np.array(pose[1:])
    reach = int(np.ceil(2.0**index * (np.linalg.norm(level.points, axis=1).max() + 8)))
    centre = reach + shift
    turn = rotation_2d(angle)
    motion = np.column_stack([turn, centre - turn @ origin_px])
    moved = cv2.warpAffine(
        image, motion, (2 * reach + 1, 2 * reach + 1), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    work = Workspace()
    work.load(np.asarray(moved, np.uint8), index + 1)
    if len(work.images) <= index:
        return 0.0, 0.0
    height, width = work.images[index].shape
    rows, columns, pad = scan.map_geometry(height, width, int(np.linalg.norm(level.points, axis=1).max()) + 2)
    maps = np.zeros((scan.ORIENTATIONS, 2, 2, rows, columns), np.int8)
    scratch = np.empty((2, 2, 2, rows, columns), np.float32)
    gx, gy = work.gradient(index)
    minimum = int((8 * ROTATIONS.min_contrast) ** 2)
    scan.fill_responses(gx, gy, np.ones((1, 1), np.uint8), minimum, False, pad, scratch, maps)
    x, y = np.rint((centre + 0.5) / 2.0**index - 0.5).astype(int)
    directions = np.arctan2(level.normals[:, 1], level.normals[:, 0])
    placed = np.empty((len(level.points), 3), np.int64)
    full = scan.PEAK * len(level.points)
    scan.place_on_maps(level.points, directions, angle, 1.0, 1.0, pad, placed)
    at = scan.response_sum(maps, placed, int(x), int(y)) / full
    half_step = 0.5 * SCAN.step_px / max(float(np.linalg.norm(level.points, axis=1).max()), 1.0)
    beside = 0.0
    for side in (-half_step, half_step):
        scan.place_on_maps(level.points, directions, angle + side, 1.0, 1.0, pad, placed)
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            beside += scan.response_sum(maps, placed, int(x) + dx, int(y) + dy) / full / 8
    return at, beside
