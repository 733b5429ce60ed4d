"""Two rotations of a nearly symmetric part: does the image tell them apart, or hide the difference?"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.vision.edges import edges_along_normals
from edged.vision.jit import kernel
from edged.vision.shape import refine
from edged.vision.shape.model import ShapeModel

APART_PX = 2.0
"""A model point farther than this from the outline of another rotation is its rotation's own."""
ALIKE = 0.8
"""Cosine between normals of points on one smooth outline."""
MIN_APART = 8
SHOWN, SHOWN_MORE = 0.5, 0.4
"""Share of a rotation's own points that the image must show, and by how much more than the rival's own."""
STRONG_SHARE = 0.3
"""Of the median slope of the part's edges: texture and shadows are weaker."""
REACH_PX = 1.5

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the image shows where a pose expects edges.

    placed (N, 4) : x, y, nx, ny of the model's points.  slope (N,) : magnitude at the edge there, grey
    values per px, 0 without one.  gap_px : between neighbouring points.
    """

    placed: FloatArray
    slope: FloatArray
    gap_px: float


def look(image: Image, model: ShapeModel, pose: FloatArray, sign: int) -> Sight:
    """Look for the model's edges in an image (H, W) uint8 at a pose; sign as in `edges_along_normals`."""
    level = model.levels[0]
    placed = np.empty((len(level.points), 4))
    refine.place(level.points, level.normals, pose, placed)
    offsets, slopes = edges_along_normals(image, placed[:, :2], placed[:, 2:], REACH_PX, sign)
    there = np.abs(offsets) < refine.AGREES_PX  # False for NaN
    scale = float(np.sqrt(abs(pose[2] * pose[5] - pose[3] * pose[4])))
    return Sight(placed, np.where(there, np.abs(slopes), 0.0), scale * _gap_px(model))


def is_told_apart(best: Sight, rival: Sight, min_contrast: float) -> bool:
    """Whether the image shows what only the better of two rotations predicts, and lacks the other's own.

    A hidden detail speaks for neither: then the scores differ by what the occluder happens to show.
    """
    only_best, only_rival = ~_lies_on(best, rival), ~_lies_on(rival, best)
    if min(only_best.sum(), only_rival.sum()) < MIN_APART:
        return True
    seen = best.slope[best.slope > 0]
    strong = max(STRONG_SHARE * float(np.median(seen)) if len(seen) else 0.0, min_contrast)
    shown = float((best.slope[only_best] >= strong).mean())
    return shown >= SHOWN and shown - float((rival.slope[only_rival] >= strong).mean()) >= SHOWN_MORE


def _lies_on(one: Sight, other: Sight) -> npt.NDArray[np.bool_]:
    """Which points (N,) of one lie on the outline that the other's points sample sparsely."""
    found = np.empty(len(one.placed), np.bool_)
    outline = other.placed[np.argsort(other.placed[:, 0], kind="stable")]
    lie_on(one.placed, outline, APART_PX, 3.0 * max(one.gap_px, 1.0), ALIKE, found)
    return found


@lru_cache(maxsize=16)
def _gap_px(model: ShapeModel) -> float:
    """Median distance of a model point to its nearest neighbour."""
    points = model.levels[0].points
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    np.fill_diagonal(gaps, np.inf)
    return float(np.median(gaps.min(axis=1)))


@kernel("void(f8[:, ::1], f8[:, ::1], f8, f8, f8, b1[::1])")
def lie_on(
    points: Array, outline: Array, across_px: float, along_px: float, alike: float, found: Array
) -> None:
    """Whether each of points (N, 4), x, y, nx, ny, has one of the outline (M, 4), sorted by x, beside it.

    Beside: at most across_px along its normal and along_px along its tangent away, with a normal whose
    cosine to its own is more than `alike`, either sign.
    """
    reach = np.sqrt(across_px * across_px + along_px * along_px)
    for n in range(points.shape[0]):
        x, y, nx, ny = points[n, 0], points[n, 1], points[n, 2], points[n, 3]
        found[n] = False
        m = np.searchsorted(outline[:, 0], x - reach)
        while m < outline.shape[0] and outline[m, 0] <= x + reach:
            dx, dy = x - outline[m, 0], y - outline[m, 1]
            if (
                abs(dx * nx + dy * ny) < across_px
                and abs(dx * ny - dy * nx) < along_px
                and abs(nx * outline[m, 2] + ny * outline[m, 3]) > alike
            ):
                found[n] = True
                break
            m += 1
