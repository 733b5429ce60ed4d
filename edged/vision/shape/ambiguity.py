"""Two rotations of a nearly symmetric part: does the image tell them apart, or hide the difference?"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.vision.edges.subpixel import edge_profiles, edges_along_normals
from edged.vision.kernels.jit import kernel
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
BESIDE_PX = 3.0
"""Where the grey values beside an edge are taken: out of its blur, still before the next edge."""
SURFACE_SHARE = 0.35
"""Of the contrast between the part and what is beside it: so much may its surface vary."""
DENIED = 0.1
"""Share of a rotation's own points at which a bare surface is an accident."""

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the image shows where a pose expects edges.

    placed (N, 4) : x, y, nx, ny of the model's points.  slope (N,) : magnitude at the edge there, grey
    values per px, 0 without one.  beside (N, 3) : grey values before, at and behind the place of the
    edge, NaN outside the image.  inward (N,) : on the rim of the part 1 or -1, whichever way along the
    normal is into the part, 0 elsewhere.  gap_px : between neighbouring points.
    """

    placed: FloatArray
    slope: FloatArray
    beside: FloatArray
    inward: npt.NDArray[np.int64]
    gap_px: float


def look(image: Image, model: ShapeModel, pose: FloatArray, sign: int) -> Sight:
    """Look for the model's edges in an image (H, W) uint8 at a pose; sign as in `edges_along_normals`."""
    level = model.levels[0]
    placed = np.empty((len(level.points), 4))
    refine.place(level.points, level.normals, pose, placed)
    offsets, slopes = edges_along_normals(image, placed[:, :2], placed[:, 2:], REACH_PX, sign)
    there = np.abs(offsets) < refine.AGREES_PX  # False for NaN
    scale = float(np.sqrt(abs(pose[2] * pose[5] - pose[3] * pose[4])))
    beside, _ = edge_profiles(image, placed[:, :2], placed[:, 2:], BESIDE_PX, BESIDE_PX)
    return Sight(placed, np.where(there, np.abs(slopes), 0.0), beside, _inward(model), scale * gap_px(model))


def evidence(one: Sight, other: Sight, min_contrast: float) -> tuple[bool, bool]:
    """What in the image speaks for one of two rotations against the other.

    First, it shows what only this one predicts, and lacks the other's own (or the two hardly differ):
    good where the scores agree, as a hidden detail speaks for neither. Second, it shows the bare surface
    of the part where the other has an edge of its own, and not so for this one: that decides, because no
    score counts an edge that is not there against a pose.
    """
    only_one = ~lies_on(one.placed, other.placed, other.gap_px)
    only_other = ~lies_on(other.placed, one.placed, one.gap_px)
    if min(only_one.sum(), only_other.sum()) < MIN_APART:
        return True, False
    seen = one.slope[one.slope > 0]
    strong = max(STRONG_SHARE * float(np.median(seen)) if len(seen) else 0.0, min_contrast)
    shown, others_shown = (
        float((sight.slope[own] >= strong).mean()) for sight, own in ((one, only_one), (other, only_other))
    )
    surface = _surface(one, strong)
    bare = False
    if surface is not None:
        denied, other_denied = (
            float(_is_bare(sight, surface, strong)[own].mean())
            for sight, own in ((one, only_one), (other, only_other))
        )
        bare = other_denied >= SHOWN and denied <= DENIED
    return shown >= SHOWN and shown - others_shown >= SHOWN_MORE, bare


def _surface(sight: Sight, strong: float) -> tuple[float, float] | None:
    """Grey value of the part, from inside its rim, and how much it may vary; None where that is unclear."""
    rim = (sight.inward != 0) & (sight.slope >= strong) & np.isfinite(sight.beside).all(axis=1)
    if rim.sum() < MIN_APART:
        return None
    before, behind = sight.beside[rim, 0], sight.beside[rim, 2]
    inside = np.where(sight.inward[rim] > 0, behind, before)
    level = float(np.median(inside))
    vary = SURFACE_SHARE * abs(level - float(np.median(np.where(sight.inward[rim] > 0, before, behind))))
    return (level, vary) if 2 * float(np.median(np.abs(inside - level))) < vary else None


def _is_bare(sight: Sight, surface: tuple[float, float], strong: float) -> npt.NDArray[np.bool_]:
    """Where (N,) the image shows the part's surface without the edge that the pose expects."""
    level, vary = surface
    return (sight.slope < strong) & (np.abs(sight.beside - level) < vary).all(axis=1)


def lies_on(placed: FloatArray, other: FloatArray, gap_px: float) -> npt.NDArray[np.bool_]:
    """Which of placed points (N, 4), x, y, nx, ny, lie on the outline that `other` (M, 4) samples sparsely.

    gap_px : between neighbours on that outline.
    """
    found = np.empty(len(placed), np.bool_)
    outline = other[np.argsort(other[:, 0], kind="stable")]
    lie_on(placed, outline, APART_PX, 3.0 * max(gap_px, 1.0), ALIKE, found)
    return found


@lru_cache(maxsize=16)
def _inward(model: ShapeModel) -> npt.NDArray[np.int64]:
    """1 or -1 for the points (N,) on the convex hull: along or against the normal is into the part."""
    points, normals = model.levels[0].points, model.levels[0].normals
    hull = points[cv2.convexHull(points.astype(np.float32), returnPoints=False)[:, 0]]
    along = np.roll(hull, -1, axis=0) - hull
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    distance = np.abs(np.einsum("nmk,mk->nm", points[:, None] - hull[None], across)).min(axis=1)
    faces = np.sign(np.einsum("nk,nk->n", normals, hull.mean(axis=0) - points))
    return np.where(distance < APART_PX, faces, 0).astype(np.int64)


@lru_cache(maxsize=16)
def gap_px(model: ShapeModel) -> float:
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
