"""Propose where a part may be in a picture: anything with a strong closed outline.

Level sets of three pictures are examined: the grey values, for parts that are brighter or darker than the
table; their difference from the table's grey value, for parts that are both; and the slope, morphologically
closed, for parts whose faces are as bright as the table. An outline is judged by its weakest stretch: those
of a table's texture have gaps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, F32, I32, FloatArray, Image
from edged.errors import TeachError
from edged.vision.teaching.params import TEACHING
from edged.vision.teaching.region import MAX_CORNERS, MIN_WIDTH_PX, first_crossing


@dataclass(frozen=True, slots=True, eq=False)
class _Outline:
    """A closed outline.  points (N, 2) int : px of the small picture.  strength : grey values per px."""

    points: I32
    area: float
    strength: float

    def is_beside(self, other: _Outline) -> bool:
        """Whether both outlines follow one edge, one inside the other."""
        radii = [np.sqrt(outline.area / np.pi) for outline in (self, other)]
        return bool(abs(radii[0] - radii[1]) <= max(TEACHING.same_px, TEACHING.same_share * max(radii)))


def likely_part(left: Image) -> FloatArray | None:
    """Corners (N, 2) around the most likely part, px of the raw left image; None if there is none."""
    small, scale = _shrunk(left)
    found = _outlines(small)
    if not found:
        return None
    best = max(found, key=lambda outline: outline.strength * np.sqrt(outline.area))
    return _around(best, scale, small.shape)


def parts_at(left: Image, x: float, y: float) -> tuple[FloatArray, ...]:
    """Corners (N, 2) around each object that a point is inside of, the largest first; all raw px, left.

    Raises `TeachError` where no outline goes around the point.
    """
    small, scale = _shrunk(left)
    place = (x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5
    around = [
        outline for outline in _outlines(small) if cv2.pointPolygonTest(outline.points, place, False) >= 0
    ]
    if not around:
        raise TeachError(
            f"nothing with a clear outline was tapped at {x:.0f}, {y:.0f} px: draw the region around the "
            "part, or light it so that it differs from the table",
            "nothing_there",
        )
    least = TEACHING.rival * max(outline.strength for outline in around)
    nested: list[_Outline] = []
    # among outlines of nearly the same size, the strongest is the edge itself
    strong = [outline for outline in around if outline.strength >= least]
    for outline in sorted(strong, key=lambda outline: -outline.strength):
        if not any(outline.is_beside(other) for other in nested):
            nested.append(outline)
    nested.sort(key=lambda outline: -outline.area)
    return tuple(_around(outline, scale, small.shape) for outline in nested)


def _shrunk(left: Image) -> tuple[Image, float]:
    """The left image scaled down and smoothed, and its scale."""
    height, width = left.shape
    scale = min(1.0, TEACHING.width_px / width)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    small = left if scale == 1.0 else cv2.resize(left, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 1.2), np.uint8), size[0] / width


def _outlines(small: Image) -> list[_Outline]:
    """All outlines that are strong all round."""
    grey = small.astype(np.float32)
    slope = np.hypot(
        cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.125)
    )
    near = np.asarray(cv2.dilate(slope, np.ones((3, 3), np.uint8)), np.float32)
    least = max(TEACHING.min_slope, TEACHING.over_texture * float(np.median(near)))
    found = []
    for points in _level_sets(small, slope, least):
        area = float(cv2.contourArea(points))
        if not TEACHING.min_area * small.size <= area <= TEACHING.max_area * small.size:
            continue
        x, y, width, height = cv2.boundingRect(points)
        if min(x, y) < 1 or x + width > small.shape[1] - 1 or y + height > small.shape[0] - 1:
            continue
        strength = float(np.quantile(near[points[:, 1], points[:, 0]], TEACHING.weakest))
        if strength >= least:
            found.append(_Outline(points, area, strength))
    return found


def _level_sets(small: Image, slope: FloatArray | F32, least: float) -> Iterator[I32]:
    """Outer borders (N, 2) of the connected parts of every level set, holes filled."""
    border = np.concatenate([small[0], small[-1], small[:, 0], small[:, -1]])
    table = float(np.median(border))
    apart = np.abs(small.astype(np.int16) - round(table)).astype(np.uint8)
    for picture, both in ((small, True), (apart, False)):
        low, high = np.quantile(picture, (0.005, 0.995))
        for level in np.unique(
            np.linspace(float(low), float(high), TEACHING.levels + 2)[1:-1].astype(np.uint8)
        ):
            yield from _borders(picture > level)
            if both:
                yield from _borders(picture <= level)
    for factor in (1.0, 2.0, 4.0):
        edges = np.asarray(slope >= factor * least, np.uint8)
        yield from _borders(cv2.morphologyEx(edges, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0)


def _borders(inside: B8) -> Iterator[I32]:
    # opened, to remove bridges of texture
    mask = cv2.morphologyEx(inside.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    for contour in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        if len(contour) >= MIN_WIDTH_PX:
            yield np.asarray(contour[:, 0], np.int32)


def _around(outline: _Outline, scale: float, shape: tuple[int, ...]) -> FloatArray:
    """Corners (N, 2) of a polygon around an outline of a small picture (h, w), with a margin; raw px."""
    inside = np.zeros(shape, np.uint8)
    cv2.fillPoly(inside, [outline.points], 255)
    wide = cv2.dilate(inside, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * TEACHING.margin_px + 1,) * 2))
    border = max(cv2.findContours(wide, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=cv2.contourArea)
    corners = np.asarray(cv2.convexHull(border)[:, 0], np.float64)
    for step in (1, 2, 4, 8):
        found = np.asarray(cv2.approxPolyDP(border, step * TEACHING.corner_px, True)[:, 0], np.float64)
        # simplifying may let two sides cross
        if 3 <= len(found) <= MAX_CORNERS // 4 and first_crossing(found) is None:
            corners = found
            break
    return (corners + 0.5) / scale - 0.5
