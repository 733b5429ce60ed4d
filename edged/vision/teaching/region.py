"""Regions of the left picture that hold the part: rectangles, circles, polygons, brush strokes and masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.teaching.coverage import coverage

MIN_WIDTH_PX = 16
"""A smaller region shows no shape."""
MAX_CORNERS, MAX_STROKE = 1000, 2000  # limits of a request
MIN_BRUSH_PX, MAX_BRUSH_PX = 2.0, 1000.0  # limits of a request
FARTHEST_PX = 1e6  # limit of a request


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of the raw left image, px: x, y of its upper left corner, width, height."""

    x: float
    y: float
    width: float
    height: float

    def painted(self, width: int, height: int) -> Image:
        """(height, width) uint8, 255 inside."""
        numbers = (self.x, self.y, self.width, self.height)
        if not all(np.isfinite(numbers)) or min(self.width, self.height) < MIN_WIDTH_PX:
            raise TeachError(
                f"region {numbers}: expected X,Y,W,H with a width and height of at least {MIN_WIDTH_PX} px",
                "small_region",
            )
        columns, rows = np.arange(width), np.arange(height)[:, None]
        inside = (columns >= self.x) & (columns <= self.x + self.width)
        return _as_mask(inside & (rows >= self.y) & (rows <= self.y + self.height))


@dataclass(frozen=True, slots=True)
class CircleRegion:
    """A disc of the raw left image, px."""

    x: float
    y: float
    radius: float

    def painted(self, width: int, height: int) -> Image:
        """(height, width) uint8, 255 inside."""
        numbers = (self.x, self.y, self.radius)
        if not all(np.isfinite(numbers)) or self.radius < MIN_WIDTH_PX / 2:
            raise TeachError(
                f"region circle {numbers}: expected X,Y,R with a radius of at least {MIN_WIDTH_PX // 2} px",
                "small_region",
            )
        columns, rows = np.arange(width), np.arange(height)[:, None]
        return _as_mask(np.hypot(columns - self.x, rows - self.y) <= self.radius)


@dataclass(frozen=True, slots=True, eq=False)
class PolygonRegion:
    """corners (N, 2) of a polygon in the raw left image, px, in order, either way round."""

    corners: FloatArray

    def painted(self, width: int, height: int) -> Image:
        """(height, width) uint8, 255 where at least half of a pixel is inside."""
        corners = np.asarray(self.corners, np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or not 3 <= len(corners) <= MAX_CORNERS:
            raise TeachError(f"region polygon: expected 3 to {MAX_CORNERS} corners X,Y")
        if not np.isfinite(corners).all() or np.abs(corners).max() > FARTHEST_PX:
            raise TeachError("region polygon: expected corners X,Y in pixels of the left image")
        corners = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]  # the last is often the first
        if (crossing := first_crossing(corners)) is not None:
            first, second = crossing
            raise TeachError(
                f"region polygon: the side after corner {first + 1} crosses the one after corner "
                f"{second + 1}; expected the corners in order around the part",
                "crossing",
            )
        return _as_mask(coverage(corners, height, width) >= 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """mask (H, W) uint8 of the size of the left image, bright where the part is."""

    mask: Image

    def painted(self, width: int, height: int) -> Image:
        """(height, width) uint8, 255 where above half of the brightest value; 0/1 masks count as 0/255."""
        if self.mask.ndim != 2 or self.mask.shape != (height, width):
            raise TeachError(
                f"region mask: {'x'.join(map(str, self.mask.shape[::-1]))} px, expected the size of the left "
                f"image, {width}x{height}"
            )
        return _as_mask(self.mask > 0.5 * max(float(self.mask.max()), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """points (N, 2) along the path of a round brush in the raw left image, px; a single point is a dot."""

    points: FloatArray
    radius: float

    def painted(self, width: int, height: int) -> Image:
        """(height, width) uint8, 255 within the radius of the path."""
        points = np.asarray(self.points, np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or not 1 <= len(points) <= MAX_STROKE:
            raise TeachError(f"region brush: expected 1 to {MAX_STROKE} points X,Y")
        if not np.isfinite(points).all() or np.abs(points).max() > FARTHEST_PX:
            raise TeachError("region brush: expected points X,Y in pixels of the left image")
        if not MIN_BRUSH_PX <= self.radius <= MAX_BRUSH_PX:
            raise TeachError(
                f"region brush: expected a radius of {MIN_BRUSH_PX:g} to {MAX_BRUSH_PX:g} px, "
                f"got {self.radius:g}"
            )
        painted = np.zeros((height, width), np.uint8)
        way = np.rint(points).astype(np.int32)
        cv2.polylines(painted, [way], False, 255, round(2 * self.radius) + 1)
        return painted


Area = Region | CircleRegion | PolygonRegion | Stroke | Painted


def painted_region(region: Area, exclude: Sequence[Area], width: int, height: int) -> Image:
    """Mask (height, width) uint8 of the raw left image: 255 in the region but outside its exclusions.

    Raises `TeachError` for a region that is invalid, outside of the image, or left empty.
    """
    inside = region.painted(width, height)
    _check_content(inside, f"outside the {width}x{height} image, or empty")
    for area in exclude:
        inside[area.painted(width, height) > 0] = 0
    _check_content(inside, "all of it is excluded")
    return inside


def _check_content(inside: Image, otherwise: str) -> None:
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows) or min(np.ptp(rows), np.ptp(columns)) + 1 < MIN_WIDTH_PX:
        raise TeachError(
            f"region: {otherwise}; expected at least {MIN_WIDTH_PX} px of the left image", "small_region"
        )


def _as_mask(inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Image:
    return np.asarray(inside, np.uint8) * np.uint8(255)


def first_crossing(corners: FloatArray) -> tuple[int, int] | None:
    """Two sides of a closed polygon that meet although they are not neighbours; None if there are none."""
    ahead = np.roll(corners, -1, axis=0)
    count = len(corners)

    def side(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
        """Sign of the side of the line from a to b on which the point c lies."""
        along, aside = b - a, c - a
        return np.asarray(np.sign(along[..., 0] * aside[..., 1] - along[..., 1] * aside[..., 0]))

    for first in range(count):
        others = np.arange(first + 1, count)
        if first == 0:
            others = others[:-1]  # the last side is the first one's neighbour, too
        others = others[1:]
        a, b, c, d = corners[first], ahead[first], corners[others], ahead[others]
        apart = (np.minimum(a, b) > np.maximum(c, d)) | (np.maximum(a, b) < np.minimum(c, d))
        meets = (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)
        hits = np.flatnonzero(meets & ~apart.any(axis=1))
        if len(hits):
            return first, int(others[hits[0]])
    return None
