"""Separate the edges of a part's face from those of the background within a region.

An edge of the face appears in both images where the plane of the face predicts it. The table's texture lies
deeper and appears many pixels away in the other image, whatever its contrast.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from edged.domain.arrays import B8, FloatArray, Image
from edged.vision.edges.contours import Contour
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rigid import Plane, apply
from edged.vision.teaching.features import TeachingView, common_depths, plane_of, strong_contours
from edged.vision.teaching.params import SURFACES, TEACHING


def without_background(view: TeachingView, rig_from_part: FloatArray, mask: Image) -> Image:
    """Reduce a mask (h, w) uint8 to the surroundings of its edges in the face.

    Unchanged if it has no edges, if `clean_share` of them lie in the face, or if too few would remain.

    rig_from_part (4, 4) : pose of the face.  mask : of the rectified left image.
    """
    normal = rig_from_part[:3, 2]
    face = Plane.through(rig_from_part[:3, 3], normal)
    contours = view.contours_in(mask)
    agreeing = [agreeing_with(view, face, contour) for contour in contours]
    total = sum(len(flags) for flags in agreeing)
    if not total or sum(np.count_nonzero(flags) for flags in agreeing) >= TEACHING.clean_share * total:
        return mask
    kept = np.zeros_like(mask)
    for contour, agrees in zip(contours, agreeing, strict=True):
        chosen = mostly(agrees, contour.closed)
        pixels = np.rint(contour.points[chosen]).astype(np.intp)
        kept[np.clip(pixels[:, 1], 0, len(kept) - 1), np.clip(pixels[:, 0], 0, kept.shape[1] - 1)] = 255
    if np.count_nonzero(kept) < TEACHING.min_kept:
        return mask
    around = cv2.getStructuringElement(
        cv2.MORPH_ELLIPSE, (2 * TEACHING.band_px + 1, 2 * TEACHING.band_px + 1)
    )
    return np.minimum(np.asarray(cv2.dilate(kept, around), np.uint8), mask)


def agreeing_with(view: TeachingView, face: Plane, contour: Contour) -> B8:
    """(N,) whether the right image shows the same edge where the face predicts each point of a contour."""
    offsets, slopes, _ = edges_in_right(view, face, contour.points, contour.normals, 2.0)
    return are_alike(offsets, slopes, view.ratio_beyond(TEACHING.max_slope_ratio) * contour.slopes)


def are_alike(offsets: FloatArray, slopes: FloatArray, expected: FloatArray) -> B8:
    """(N,) whether edges, px off where they were expected, and their slopes are like expected ones (N,)."""
    ratio = slopes / np.maximum(expected, 1e-9)
    with np.errstate(invalid="ignore"):
        alike = (ratio < TEACHING.max_slope_ratio) & (ratio > 1 / TEACHING.max_slope_ratio)
        return np.asarray((np.abs(offsets) <= TEACHING.max_mismatch_px) & alike)


def with_ratio(view: TeachingView) -> TeachingView:
    """Fill in the usual ratio of edge slopes, right image to left, of a view.

    A metal face is bright for the camera that it reflects the light to.
    """
    ratio = _usual_ratio(view)
    return view if ratio == 1.0 else replace(view, ratio=ratio)  # `strong_contours` caches by identity


def _usual_ratio(view: TeachingView) -> float:
    """Median ratio of edge slopes, right image to left; 1 where the ratios scatter or no plane is found."""
    contours = strong_contours(view)
    face = plane_of(view, contours, common_depths(view.images.rectification))
    if face is None:
        return 1.0
    ratios = np.concatenate(
        [
            edges_in_right(view, face, some.points, some.normals, TEACHING.max_mismatch_px)[1] / some.slopes
            for some in contours
        ]
    )
    ratios = ratios[np.isfinite(ratios)]
    if not len(ratios):
        return 1.0
    low, usual, high = np.quantile(ratios, (0.25, 0.5, 0.75))
    is_plain = 0 < high < TEACHING.max_slope_ratio * low
    return float(usual) if is_plain else 1.0


def fits_significantly_better(
    view: TeachingView, face: Plane, other: Plane, contours: Sequence[Contour]
) -> bool:
    """Whether contours agree significantly better with one face than with another (McNemar's test).

    Where the face shows its plane by texture, the one that leans by clearly less from that is better.
    Source: Q. McNemar, "Note on the sampling error of the difference between correlated proportions or
    percentages", Psychometrika 12, 1947.
    """
    if view.surface is not None:
        leans = [plane.lean_rad(view.surface) for plane in (face, other)]
        if abs(leans[0] - leans[1]) > SURFACES.lean_rad:
            return leans[0] < leans[1]
    mine, theirs = (
        np.concatenate([agreeing_with(view, plane, contour) for contour in contours])
        for plane in (face, other)
    )
    more, fewer = np.count_nonzero(mine & ~theirs), np.count_nonzero(theirs & ~mine)
    return bool((more - fewer) > TEACHING.certain * math.sqrt((more + fewer) * TEACHING.alike_px))


def edges_in_right(
    view: TeachingView, face: Plane, points_px: FloatArray, normals: FloatArray, reach_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Find edges of the right image where a face predicts points (N, 2) of the rectified left image.

    Returns offsets (N,) px and slopes (N,) as `edges_along_normals`, and the normals (N, 2) on the right.
    """
    along = np.column_stack([-normals[:, 1], normals[:, 0]])
    there, beside = (in_right(view, face, points_px + shift) for shift in (-0.5 * along, 0.5 * along))
    along_right = beside - there
    lengths = np.linalg.norm(along_right, axis=1, keepdims=True)
    along_right = along_right / np.maximum(lengths, 1e-9)
    across = np.column_stack([along_right[:, 1], -along_right[:, 0]])
    offsets, slopes = edges_along_normals(
        view.images.rectified_right, 0.5 * (there + beside), across, reach_px, 1
    )
    return offsets, slopes, across


def in_right(view: TeachingView, face: Plane, rectified_px: FloatArray) -> FloatArray:
    """Map points (N, 2) of the rectified left image through the face into the rectified right image."""
    rig = view.images.rig
    space = face.meet(view.images.rays("left", rectified_px))
    seen = rig.right.project(apply(rig.right_from_left, space))
    return np.asarray(view.images.rectification.rectify_points("right", seen), np.float64)


def mostly(agrees: B8, closed: bool) -> B8:
    """(N,) whether most points agree in a window along a contour; a shorter contour is a single window."""
    return np.asarray(_share(agrees, closed) >= TEACHING.min_agreeing)


def _share(agrees: B8, closed: bool) -> FloatArray:
    if len(agrees) <= TEACHING.window_px:
        return np.full(len(agrees), float(np.mean(agrees)) if len(agrees) else 0.0)
    border = cv2.BORDER_WRAP if closed else cv2.BORDER_REFLECT_101
    half = TEACHING.window_px // 2
    column = agrees.astype(np.float64)[:, None]
    padded = cv2.copyMakeBorder(column, half, half, 0, 0, border)
    return np.asarray(
        np.convolve(padded[:, 0], np.full(TEACHING.window_px, 1 / TEACHING.window_px), "valid"), np.float64
    )
