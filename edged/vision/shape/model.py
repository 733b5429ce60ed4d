"""The taught shape: edge points with directions on every pyramid level (paper, 4.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.errors import TeachError
from edged.vision.edges import edges_along_normals
from edged.vision.shape.levels import surviving_levels
from edged.vision.shape.symmetry import find_symmetry

MAX_POINTS = (600, 400, 240, 160, 160)
"""Points kept on each level: enough for the precision of the finest, few for the exhaustive top."""
MIN_POINTS = 24
SMOOTHING_PX = (2.0, 1.2, 0.7)
"""Before the edges of a level are chosen: coarse levels are averages already, and their parts are small."""
MIN_TOP_RADIUS_PX = 14.0
MAX_LEVELS = 5
SAME_SCORE = 0.985
"""Above it, what differs is less than what noise and sampling change."""
EDGE_SHARE = 0.5
"""Contrast threshold as a share of the strong edges of the region (their 95th percentile)."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapeLevel:
    """points (N, 2) relative to the origin, px of this level; normals (N, 2) unit, along the gradient."""

    points: FloatArray
    normals: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModel:
    """A shape to look for.

    levels : finest first.  origin_px (2,) : where the origin was in the teaching image.
    radius_px : farthest point from the origin.  contrast : median slope of the model's edges, grey
    values per px.
    symmetries (K, 4) : dx, dy, angle, similarity: motions after which the shape looks (nearly) the same.
    centre_px (2,) : about which they turn, relative to the origin.  round : any rotation looks the same.
    repetition : how many points share the noise of one pixel; the covariance of a match is that much larger.
    """

    levels: tuple[ShapeLevel, ...]
    origin_px: FloatArray
    radius_px: float
    contrast: float
    symmetries: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))
    centre_px: FloatArray = field(default_factory=lambda: np.zeros(2))
    round: bool = False
    repetition: float = 1.0

    @property
    def same_score(self) -> float:
        """Similarity from which two rotations cannot be told apart."""
        return SAME_SCORE

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Plain arrays for a file."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "origin_px": self.origin_px,
            "numbers": np.array([self.radius_px, self.contrast, len(self.levels)], np.float64),
            "symmetries": self.symmetries,
            "centre_px": self.centre_px,
            "round": np.array([float(self.round)]),
            "repetition": np.array([self.repetition]),
        }
        for index, level in enumerate(self.levels):
            arrays[f"points{index}"], arrays[f"normals{index}"] = level.points, level.normals
        return arrays

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> ShapeModel:
        """Inverse of `to_arrays`; raises `ValueError` that names what is wrong."""
        numbers = _checked(arrays, "numbers", (3,))
        origin = _checked(arrays, "origin_px", (2,))
        radius, contrast, count = (float(number) for number in numbers)
        if not (0 < radius < 1e5 and 0 < contrast < 1e4 and count in range(1, MAX_LEVELS + 1)):
            raise ValueError(f"numbers: impossible values {numbers.tolist()}")
        levels = []
        for index in range(int(count)):
            points = _checked(arrays, f"points{index}", (-1, 2))
            normals = _checked(arrays, f"normals{index}", (len(points), 2))
            if len(points) < MIN_POINTS or np.abs(points).max() > 1e5:
                raise ValueError(f"points{index}: too few or too far points")
            if np.abs(np.linalg.norm(normals, axis=1) - 1).max() > 1e-6:
                raise ValueError(f"normals{index}: not unit vectors")
            levels.append(ShapeLevel(points, normals))
        symmetries = _checked(arrays, "symmetries", (-1, 4))
        if len(symmetries) > 360 or (np.abs(symmetries) > 1e5).any():
            raise ValueError("symmetries: impossible values")
        centre, is_round = _checked(arrays, "centre_px", (2,)), _checked(arrays, "round", (1,))
        if np.abs(centre).max() > 1e5 or np.abs(origin).max() > 1e6:
            raise ValueError("centre_px, origin_px: impossible values")
        (repetition,) = _checked(arrays, "repetition", (1,))
        if not 1 <= repetition <= 100:
            raise ValueError(f"repetition: impossible value {repetition}")
        return ShapeModel(
            tuple(levels), origin, radius, contrast, symmetries, centre, bool(is_round[0]), float(repetition)
        )


def _checked(arrays: Mapping[str, npt.NDArray[Any]], name: str, shape: tuple[int, ...]) -> FloatArray:
    if name not in arrays:
        raise ValueError(f"{name}: missing")
    value = arrays[name]
    fits = value.ndim == len(shape) and all(
        want in (-1, have) for want, have in zip(shape, value.shape, strict=True)
    )
    if not fits or value.dtype != np.float64 or not np.isfinite(value).all():
        raise ValueError(
            f"{name}: expected finite float64 of the shape {shape}, got {value.dtype} {value.shape}"
        )
    return np.ascontiguousarray(value)


def create_model(image: Image, mask: Image, origin_px: FloatArray | None = None) -> ShapeModel:
    """Learn the shape inside a mask.

    image : (H, W) uint8, rectified.  mask : (H, W) uint8, non-zero where the part is.
    origin_px (2,) : the point whose position a match reports; default: the centre of the mask.
    Raises `TeachError` when there are too few edges.
    """
    if image.dtype != np.uint8 or image.ndim != 2 or image.shape != mask.shape:
        raise TeachError(
            f"a model needs an 8-bit grey image and a mask of its size, got {image.shape}, {mask.shape}"
        )
    if np.count_nonzero(mask) < 64:
        raise TeachError("the region is empty or tiny: expected at least 64 pixels")
    if origin_px is None:
        ys, xs = np.nonzero(mask)
        origin_px = np.array([(xs.min() + xs.max()) / 2, (ys.min() + ys.max()) / 2])
    origin = np.asarray(origin_px, dtype=np.float64)
    levels: list[ShapeLevel] = []
    contrast = 0.0
    level_image, level_mask = image, mask
    for index in range(MAX_LEVELS):
        extracted = _edge_points(level_image, level_mask, SMOOTHING_PX[min(index, 2)])
        if extracted is None or len(extracted[0]) < MIN_POINTS:
            break
        points, normals, slope = extracted
        level_origin = (origin + 0.5) / 2**index - 0.5
        relative = points - level_origin
        if levels and np.linalg.norm(relative, axis=1).max() < MIN_TOP_RADIUS_PX:
            break
        keep = _spread(relative, MAX_POINTS[index])
        levels.append(ShapeLevel(np.ascontiguousarray(relative[keep]), np.ascontiguousarray(normals[keep])))
        contrast = contrast or slope
        height, width = level_image.shape
        if min(height, width) < 32:
            break
        # as the search builds its pyramid: a last odd row or column is left out
        half = (width // 2, height // 2)
        even = level_image[: 2 * half[1], : 2 * half[0]]
        level_image = np.asarray(cv2.resize(even, half, interpolation=cv2.INTER_AREA), np.uint8)
        level_mask = np.asarray(level_mask[: 2 * half[1] : 2, : 2 * half[0] : 2], np.uint8)
    if not levels:
        raise TeachError(
            f"the region shows too few edges for a model: expected at least {MIN_POINTS} edge points; "
            "is the part inside the region, lit and in focus?"
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
        _repetition(levels[0].points),
    )


def _repetition(points: FloatArray) -> float:
    """Sum of the correlations of a point's noise with all points', averaged; 1 for points far apart.

    Bicubic samples of white noise half a pixel apart correlate by about 0.6: a Gaussian of sigma 0.5 px.
    """
    squared = np.zeros((len(points), len(points)))
    for column in points.T:
        apart = np.subtract.outer(column, column)
        squared += np.square(apart, out=apart)
    squared *= -2
    return float(np.exp(squared, out=squared).sum(axis=1).mean())


@dataclass(frozen=True, slots=True, eq=False)
class StrongEdges:
    """thin (H, W) uint8, 1 on the edges that were kept; gx, gy (H, W) int16, Sobel (8 x the slope per px)."""

    thin: Image
    gx: npt.NDArray[np.int16]
    gy: npt.NDArray[np.int16]


def strong_edges(image: Image, mask: Image, smoothing_px: float = 2.0) -> StrongEdges | None:
    """The strong, connected edges inside a mask; None when there are nearly none.

    Texture is weak and machining marks are narrow; what outlines a part is strong and connected.
    """
    # wider than the measuring operator: narrow marks average out, outlines stay
    smooth = cv2.GaussianBlur(image, (0, 0), smoothing_px)
    gx = cv2.Sobel(smooth, cv2.CV_16S, 1, 0, ksize=3)
    gy = cv2.Sobel(smooth, cv2.CV_16S, 0, 1, ksize=3)
    thin = cv2.Canny(gx, gy, 8, 16, L2gradient=True)
    thin[mask == 0] = 0
    at = np.nonzero(thin)
    slopes = np.hypot(gx[at].astype(np.float64), gy[at]) / 8
    if len(slopes) < MIN_POINTS:
        return None
    # hysteresis with thresholds from the region itself
    high = EDGE_SHARE * float(np.percentile(slopes, 95))
    linked = np.zeros_like(thin)
    linked[at] = slopes > 0.6 * high
    _, labels, stats, _ = cv2.connectedComponentsWithStats(linked, connectivity=8)
    strong = np.bincount(labels[at][slopes > high], minlength=len(stats))
    keep = (stats[:, cv2.CC_STAT_AREA] >= 0.08 * np.sqrt(np.count_nonzero(mask))) & (strong >= 4)
    keep[0] = False
    return StrongEdges(keep[labels].astype(np.uint8), gx, gy)  # type: ignore[arg-type]


def _edge_points(
    image: Image, mask: Image, smoothing_px: float
) -> tuple[FloatArray, FloatArray, float] | None:
    """Sub-pixel edge points, unit gradients and median slope of the strong edges in the mask."""
    edges = strong_edges(image, mask, smoothing_px)
    if edges is None:
        return None
    ys, xs = np.nonzero(edges.thin)
    if len(xs) < MIN_POINTS:
        return None
    points = np.column_stack([xs, ys]).astype(np.float64)
    normals = np.column_stack([edges.gx[ys, xs], edges.gy[ys, xs]]).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # measured with the operator that will measure the image: its bias at corners and arcs cancels
    offsets, slopes = edges_along_normals(image, points, normals, 1.5, 1)
    good = np.isfinite(offsets)
    if good.sum() < MIN_POINTS:
        return None
    points = points[good] + normals[good] * offsets[good, None]
    return points, normals[good], float(np.median(slopes[good]))


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
