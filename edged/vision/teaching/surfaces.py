"""Plane faces that a teaching pair shows by their texture, whatever their edges look like.

Walls that are seen, edge breaks and glints move the edges of a face by a pixel, each in its own way: a face
by a few small holes was taught tilted by up to 5 degrees. Grain, machining marks and noise of its paint are
in the face itself. Source: H. Hirschmüller, "Stereo processing by semiglobal matching and mutual
information", IEEE TPAMI 30, 2008 (OpenCV's), then planes by RANSAC over small windows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.edges.contours import Contour
from edged.vision.geometry.rigid import Plane
from edged.vision.part.initialplane import plane_of_disparities
from edged.vision.part.params import START
from edged.vision.teaching.features import TeachingView, strong_contours
from edged.vision.teaching.params import SURFACES


@lru_cache(maxsize=2)  # keyed by identity; each fit of a teaching needs them
def surfaces_of(view: TeachingView, depth_mm: tuple[float, float]) -> tuple[Plane, ...]:
    """The planes that the pair shows within its outlines, nearest to the cameras first, in the rig frame.

    depth_mm : range of the rectified depth.
    """
    area = _around(strong_contours(view), view.mask.shape)
    if area is None:
        return ()
    for coarser in SURFACES.coarser:
        found = _surfaces(view, area, depth_mm, coarser)
        if found:
            break
    return tuple(sorted(found, key=lambda plane: -plane.offset))


def is_at(plane: Plane, point: FloatArray) -> bool:
    """Whether a point (3,) lies on a plane, or half an edge break beside it."""
    return abs(float(plane.normal @ point) - plane.offset) < SURFACES.at_mm


def _surfaces(
    view: TeachingView, area: tuple[slice, slice], depth_mm: tuple[float, float], coarser: int
) -> list[Plane]:
    """The planes of an area in the rig frame, by pictures that are shrunk this many times more."""
    disparity, shrunk = _disparities(view, *area, depth_mm, coarser)
    # pixels of the shrunk area are x = (whole x - first) / shrunk
    first = np.array([area[1].start, area[0].start]) + 0.5 * (shrunk - 1)
    corners = first + shrunk * np.array([[0, 0], [disparity.shape[1], 0], [0, disparity.shape[0]]])
    planes = _planes(disparity, SURFACES.fewest * coarser)
    large = [plane for plane in planes if plane[2] >= SURFACES.many]
    found = []
    for (a, b, c), centre, _ in large or planes:  # small ones lean by up to 0.5 degrees
        near = _part_of(area, first + shrunk * centre)
        of_picture = _refined(view, near, np.array([a, b, c * shrunk - first @ (a, b)]))
        plane = plane_of_disparities(view.images.rectification, of_picture, corners)
        if plane is not None:
            found.append(plane)
    return found


def _around(contours: Sequence[Contour], shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Rows and columns around contours; None without any."""
    if not contours:
        return None
    points = np.concatenate([contour.points for contour in contours])
    first = np.maximum(np.floor(points.min(axis=0)).astype(int) - SURFACES.beside_px, 0)
    last = np.minimum(np.ceil(points.max(axis=0)).astype(int) + SURFACES.beside_px, shape[1::-1])
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def _part_of(area: tuple[slice, slice], centre: FloatArray) -> tuple[slice, slice]:
    """The rows and columns of an area that are near to a point (2,): more pixels would only want memory."""
    half, (rows, columns) = SURFACES.refined_half_px, area
    x, y = np.rint(centre).astype(int).tolist()
    return (
        slice(max(rows.start, y - half), min(rows.stop, y + half)),
        slice(max(columns.start, x - half), min(columns.stop, x + half)),
    )


def _disparities(
    view: TeachingView, rows: slice, columns: slice, depth_mm: tuple[float, float], coarser: int
) -> tuple[FloatArray, int]:
    """(h, w) disparities of an area, NaN where the right picture shows no place or several.

    Both in pixels of an area that is shrunk by a power of two, if it is large, and by `coarser`; also that
    factor.
    """
    images = view.images
    high, low = (images.rectification.disparity_px(depth) for depth in depth_mm)
    low, high = math.floor(low), min(math.ceil(high), columns.stop)
    work = (rows.stop - rows.start) * (columns.stop - columns.start) * max(high - low, 1)
    shrunk = coarser * 2 ** max(0, math.ceil(math.log2(work / SURFACES.work) / 3))
    count = 16 * math.ceil((high - low) / (16 * shrunk))
    width, height = (shrunk * ((side.stop - side.start) // shrunk) for side in (columns, rows))
    if count <= 0 or min(width, height) < shrunk * SURFACES.window_px:
        return np.full((1, 1), np.nan), shrunk
    rows, columns = slice(rows.start, rows.start + height), slice(columns.start, columns.start + width)
    places = np.arange(columns.start - low - shrunk * count, columns.stop - low)
    covered = (places >= 0) & (places < images.rectified_right.shape[1])
    places = np.where(covered, places, 0)

    def small(image: Image) -> Image:
        size = image.shape[1] // shrunk, image.shape[0] // shrunk
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    right = small(np.where(covered, images.rectified_right[rows, places], 0).astype(np.uint8))
    left = small(images.rectified_left[rows, columns])
    valid = small(np.where(covered, images.rectification.valid_right[rows, places], 0).astype(np.uint8))
    found = _matched(left, right, count)
    there = np.rint(np.arange(found.shape[1]) + count - found).astype(np.intp)
    seen = np.take_along_axis(valid, np.clip(there, 0, valid.shape[1] - 1), axis=1) == 255
    known = (found > 0) & seen & (small(view.mask[rows, columns]) == 255)
    return np.where(known, found + low / shrunk, np.nan), shrunk


def _matched(left: Image, right: Image, count: int) -> FloatArray:
    """(h, w) how far each pixel of the left picture has moved left in the right one, of 0 to count pixels.

    left (h, w), right (h, count + w) : in both, the last columns are the same.  Not positive where unknown.
    """
    block = SURFACES.block_px
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=count, blockSize=block, P1=4 * block**2, P2=32 * block**2,
        disp12MaxDiff=1, uniquenessRatio=SURFACES.unique, speckleWindowSize=SURFACES.speckle, speckleRange=2,
    )  # fmt: skip
    beside = cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_CONSTANT)
    return np.asarray(matcher.compute(beside, right), np.float64)[:, count:] / 16


def _refined(view: TeachingView, area: tuple[slice, slice], plane: FloatArray) -> FloatArray:
    """The plane (a, b, c) again, by what whole pixels leave of it: slanted planes are matched in steps."""
    count = SURFACES.refined_px
    rows, columns = (np.arange(side.start, side.stop) for side in area)
    # the right picture, moved so that a pixel of the plane has moved by half of the range
    wide = np.arange(columns[0] - count, columns[-1] + 1) + 0.5 * count
    x, y = np.meshgrid(wide, rows)
    there = (x - (plane[0] * x + plane[1] * y + plane[2])).astype(np.float32)
    right = cv2.remap(view.images.rectified_right, there, y.astype(np.float32), cv2.INTER_LINEAR)
    moved = _matched(view.images.rectified_left[area], np.asarray(right, np.uint8), count)
    known = (moved > 0) & (view.mask[area] > 0)
    down, along = np.nonzero(known)
    points = np.column_stack([along + columns[0], down + rows[0], np.ones(len(down))])
    rest = (moved[known] - 0.5 * count) * (1.0 - plane[0])
    change = np.zeros(3)
    for reach_px in (SURFACES.other_px, *[SURFACES.same_px] * SURFACES.rounds):
        near = np.abs(rest - points @ change) < reach_px
        if np.count_nonzero(near) < SURFACES.fewest:
            return plane
        change = np.linalg.lstsq(points[near], rest[near], rcond=None)[0]
    return np.asarray(plane + change)


def _planes(disparity: FloatArray, fewest: int) -> list[tuple[FloatArray, FloatArray, int]]:
    """The planes with most disparities: (a, b, c) of d = a x + b y + c, these' middle (2,) and number.

    fewest : disparities of a plane.
    """
    rows, columns = np.nonzero(np.isfinite(disparity))
    points = np.column_stack([columns, rows, np.ones(len(rows))])
    values, trials = disparity[rows, columns], _of_windows(disparity)
    some = slice(None, None, max(1, len(values) // SURFACES.compared))
    left, found = np.ones(len(values), bool), list[tuple[FloatArray, FloatArray, int]]()
    for _ in range(SURFACES.most):
        there, wanted = points[some][left[some]], values[some][left[some]]
        if not (len(trials) and len(wanted)):
            break
        agreeing = [np.count_nonzero(np.abs(there @ trial - wanted) < SURFACES.same_px) for trial in trials]
        best = trials[int(np.argmax(agreeing))]
        for _ in range(SURFACES.rounds):
            near = left & (np.abs(points @ best - values) < SURFACES.same_px)
            if np.count_nonzero(near) < fewest:
                return found
            best = np.linalg.lstsq(points[near], values[near], rcond=None)[0]
        away = np.abs(points @ best - values)
        if _is_textured(away[left]):
            found.append((best, np.median(points[near, :2], axis=0), int(near.sum())))
        left &= away > SURFACES.other_px
    return found


def _is_textured(away_px: FloatArray) -> bool:
    """Whether disparities at these distances (N,) from a plane are many, or hardly any lie beside it.

    Smeared matches lie about as densely beside a plane as on it.
    """
    on_plane = np.count_nonzero(away_px < SURFACES.same_px)
    beside = np.count_nonzero(away_px < SURFACES.beside * SURFACES.same_px) - on_plane
    return bool(on_plane >= SURFACES.many or beside < SURFACES.smeared * on_plane)


def _of_windows(disparity: FloatArray) -> FloatArray:
    """(N, 3) planes through small windows that are mostly matched, and plane."""
    size, found = SURFACES.window_px, []
    for top in range(0, disparity.shape[0] - size, size // 2):
        for first in range(0, disparity.shape[1] - size, size // 2):
            window = disparity[top : top + size, first : first + size]
            rows, columns = np.nonzero(np.isfinite(window))
            if len(rows) < SURFACES.filled * size**2:
                continue
            points = np.column_stack([columns + first, rows + top, np.ones(len(rows))])
            values = window[rows, columns]
            trial = np.linalg.lstsq(points, values, rcond=None)[0]
            misfit_px = np.median(np.abs(points @ trial - values))
            if misfit_px < SURFACES.same_px / 2 and np.abs(trial[:2]).max() < START.max_slope:
                found.append(trial)
    return np.array(found).reshape(-1, 3)
