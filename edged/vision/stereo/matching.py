"""Stereo matching of single points along their rectified rows: search by NCC, then least squares.

1. Zero-mean NCC (paper, eq. 8) of a square window around the left point with all windows of the search range
   in the right image; for slanted faces also with a sheared window. The best position must be a real peak,
   clear of the second one, and the match back from right to left must agree.
2. Affine least-squares matching from there (A. Gruen, 1985, with the row fixed):
   gain * right(x - disparity(x, y), y) + offset = left(x, y), disparity a plane in x and y. Its sigma is that
   of white noise propagated through the whole estimate, with the noise level taken from the residuals: it
   grows with anything that the model cannot explain.

A point that cannot be measured is rejected with a reason, never guessed.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, F64, I32, I64, FloatArray, Image
from edged.errors import ImageError
from edged.vision.kernels.jit import kernel
from edged.vision.stereo.leastsquares import (
    GAIN,
    LEFT_PATCH,
    NOISE_GAIN,
    SHIFT,
    SLOPE_X,
    SLOPE_Y,
    TAP2_COVARIANCE,
    Patches,
    cut_out,
    fit,
    make_patches,
    smooth,
    spline_rows,
    variance_of,
)
from edged.vision.stereo.ncc import find_peak, ncc_along_row, sheared_window
from edged.vision.stereo.params import PAIRING

# numba freezes globals when it compiles: kernels read these by name
SLOPES = np.array(PAIRING.slopes)
SURE_SCORE = PAIRING.sure_score


class MatchStatus(enum.IntEnum):
    """Why a point has no disparity."""

    ACCEPTED = 0  # it has a disparity
    OUTSIDE = 1  # window or search range leaves an image, or the peak lies at an end of the range
    TEXTURELESS = 2  # no texture above the noise
    EDGE_PARALLEL = 3  # all texture runs along the row
    LOW_SCORE = 4  # no place in the row is similar enough
    AMBIGUOUS = 5  # a second place is about as similar
    LEFT_RIGHT = 6  # the match back from right to left disagrees
    DIVERGED = 7  # the fit left the peak


@dataclass(frozen=True, slots=True)
class NccParams:
    """Parameters of matching by NCC.

    half_size_px : the window has 2 half_size_px + 1 rows and columns; 3 to 20.
    min_score : of the best position, [0, 1].
    max_ambiguity : largest ratio of second to best peak.
    left_right_px : largest disagreement of the matches from left to right and back.
    max_sigma_px : largest standard deviation of a disparity.
    noise_grey : standard deviation of a pixel, to tell texture from noise before the search.
    row_sigma_px : standard deviation of the remaining difference between corresponding rows.
    """

    half_size_px: int = 10  # chosen: 441 px of texture; more blurs the face's form, less leaves more to noise
    min_score: float = 0.6  # chosen: more refuses glossy faces, less lets other texture through
    max_ambiguity: float = 0.9  # chosen: more takes the next tooth of a pattern, less refuses texture
    left_right_px: float = 1.0  # for whole-pixel matches: neighbouring pixels agree
    max_sigma_px: float = 0.25  # chosen: more lets uncertain points in, less leaves holes
    noise_grey: float = 2.0  # chosen: more refuses faint texture, less matches noise
    row_sigma_px: float = 0.03  # chosen: of a good calibration; it is part of each sigma


@dataclass(frozen=True, slots=True, eq=False)
class NccMatches:
    """Disparities of N points; NaN where `reason` is not ACCEPTED.

    disparity_px (N,) : left.x - right.x of the point itself, not of its whole pixel; rectified.
    sigma_px (N,) : its standard deviation. slope (N, 2) : its derivative by x and y of the left image.
    score (N,) : best NCC in [-1, 1], NaN where there was no search.
    ambiguity (N,) : second peak over best. curvature (N,) : -d² score / d disparity² at the peak, per px².
    reason (N,) : `MatchStatus` values, int64.
    """

    disparity_px: FloatArray
    sigma_px: FloatArray
    slope: FloatArray
    score: FloatArray
    ambiguity: FloatArray
    curvature: FloatArray
    reason: I64

    @property
    def accepted(self) -> B8:
        """(N,) whether points have a disparity."""
        return np.asarray(self.reason == MatchStatus.ACCEPTED)


def match_ncc(
    left: Image,
    right: Image,
    points_px: FloatArray,
    disparity_range_px: FloatArray | tuple[float, float],
    params: NccParams | None = None,
) -> NccMatches:
    """Match points of the left image along their epipolar rows.

    left, right : (H, W) uint8, rectified: corresponding points lie in the same row.
    points_px : (N, 2), (x, y) in the left image; need not be integers.
    disparity_range_px : (lowest, highest) of left.x - right.x, one pair or one per point (N, 2).
    Raises `ImageError` for images that do not fit, ValueError for wrong shapes and empty ranges.
    Source: J. P. Lewis, "Fast Normalized Cross-Correlation", 1995; paper eq. 8; A. Gruen, "Adaptive Least
    Squares Correlation", 1985.
    """
    params = params or NccParams()
    for name, image in (("left", left), ("right", right)):
        if image.ndim != 2 or image.dtype != np.uint8:
            raise ImageError(f"{name} image: expected (H, W) uint8, got {image.shape} {image.dtype}")
    if left.shape != right.shape:
        raise ImageError(f"left image {left.shape} and right image {right.shape} differ in size")
    points = np.ascontiguousarray(points_px, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points_px: expected (N, 2), got {points.shape}")
    ranges = np.ascontiguousarray(np.broadcast_to(np.asarray(disparity_range_px, np.float64), points.shape))
    if not (ranges[:, 0] <= ranges[:, 1]).all():
        raise ValueError("disparity_range_px: expected lowest <= highest")
    # a disparity beyond the image's width has no pixel; this also bounds the work
    ranges = np.clip(ranges, -float(left.shape[1]), float(left.shape[1]))
    results = np.full((points.shape[0], 7), np.nan)
    reasons = np.zeros(points.shape[0], np.int64)
    limits = np.array(
        [
            params.min_score,
            params.max_ambiguity,
            params.left_right_px,
            params.max_sigma_px,
            params.noise_grey,
            params.row_sigma_px,
        ]
    )
    _match(
        np.ascontiguousarray(left),
        np.ascontiguousarray(right),
        points,
        ranges,
        params.half_size_px,
        limits,
        results,
        reasons,
    )
    return NccMatches(
        results[:, 0], results[:, 1], results[:, 2:4], results[:, 4], results[:, 5], results[:, 6], reasons
    )


# --- one point ------------------------------------------------------------------------------------


class _Search(NamedTuple):
    """Memory of the search; `found` as written by `ncc.find_peak`."""

    window: I32
    strip: I32
    products: I32
    scores: F64
    found: F64


class _Point(NamedTuple):
    """A point's nearest pixel, the remaining fraction of its position, and its range of disparities."""

    x: int
    y: int
    rest_x: float
    rest_y: float
    lowest: float
    highest: float


# plain numbers for the kernels
ACCEPTED, OUTSIDE, TEXTURELESS, EDGE_PARALLEL, LOW_SCORE, AMBIGUOUS, LEFT_RIGHT, DIVERGED = map(
    int, MatchStatus
)
WHOLE, FRACTION, START_SLOPE_X, START_SLOPE_Y = range(4)
"""Entries of the start of a fit: integer part of the disparity, its fraction, slopes."""
DISPARITY, SIGMA, RESULT_SLOPE_X, RESULT_SLOPE_Y, SCORE, AMBIGUITY, CURVATURE = range(7)
"""Columns of the results, as in `NccMatches`."""
MIN_SCORE, MAX_AMBIGUITY, MAX_LEFT_RIGHT, MAX_SIGMA, NOISE, ROW_SIGMA = range(6)
"""Entries of the limits, as in `NccParams`."""


@kernel()
def _make_search(width: int, half: int) -> _Search:
    size = 2 * half + 1
    return _Search(
        np.empty((size, size), np.int32),
        np.empty((size, width + size), np.int32),
        np.empty(width + size, np.int32),
        np.empty(width + size),
        np.empty(4),
    )


@kernel()
def _texture(patch: F64, noise: float) -> tuple[float, float]:
    """Energy of the horizontal and of the vertical gradient of a smoothed patch, minus that of its noise."""
    size = patch.shape[0]
    energy_x, energy_y = 0.0, 0.0
    for j in range(1, size - 1):
        for i in range(1, size - 1):
            energy_x += 0.25 * (patch[j, i + 1] - patch[j, i - 1]) ** 2
            energy_y += 0.25 * (patch[j + 1, i] - patch[j - 1, i]) ** 2
    # variance of (n(x + 1) - n(x - 1)) / 2 of smoothed white noise n
    floor = (size - 2) ** 2 * noise * noise * 0.5 * (NOISE_GAIN - TAP2_COVARIANCE)
    return max(energy_x - floor, 0.0), max(energy_y - floor, 0.0)


@kernel()
def _best_along_row(image: Image, y: int, start: int, count: int, s: _Search) -> int:
    """Index of the peak of s.window along a row, -1 if there is none; fills s.found as `find_peak`."""
    ncc_along_row(s.window, image, start, y, count, s.strip, s.products, s.scores)
    return find_peak(s.scores, count, s.found)


@kernel()
def _search(
    left: Image, right: Image, point: _Point, limits: F64, s: _Search, result: F64, start: F64
) -> int:
    """Find the whole-pixel match of a point, there and back; a `MatchStatus`. Fills result and start."""
    half, width = s.window.shape[0] // 2, left.shape[1]
    # one more at both ends, so that a peak at the end of the range still has two neighbours
    lowest, highest = math.floor(point.lowest) - 1, math.ceil(point.highest) + 1
    first, last = max(point.x - highest, half), min(point.x - lowest, width - 1 - half)
    if last - first < 2:
        return OUTSIDE
    best, peaked = -1.0, False
    for h in range(SLOPES.shape[0]):
        slope_x, slope_y = SLOPES[h]
        stretch = 1.0 / (1.0 - slope_x)
        sheared_window(left, point.x, point.y, stretch, slope_y * stretch, half, s.window)
        peak = _best_along_row(right, point.y, first, last - first + 1, s)
        if s.found[0] > best:
            best, peaked = s.found[0], peak >= 0
            result[SCORE] = best
            start[START_SLOPE_X], start[START_SLOPE_Y] = slope_x, slope_y
            if peaked:
                result[AMBIGUITY], result[CURVATURE] = s.found[1], s.found[2]
                start[WHOLE], start[FRACTION] = point.x - (first + peak), -s.found[3]
        if best >= SURE_SCORE:
            break
    if best < limits[MIN_SCORE]:
        return LOW_SCORE
    if not peaked:
        return OUTSIDE
    if result[AMBIGUITY] > limits[MAX_AMBIGUITY]:
        return AMBIGUOUS
    x_right = point.x - int(start[WHOLE])
    stretch = 1.0 - start[START_SLOPE_X]
    sheared_window(right, x_right, point.y, stretch, -start[START_SLOPE_Y], half, s.window)
    first, last = max(x_right + lowest, half), min(x_right + highest, width - 1 - half)
    if last - first < 2:
        return OUTSIDE
    peak = _best_along_row(left, point.y, first, last - first + 1, s)
    back = first + peak + s.found[3] - x_right
    if peak < 0 or abs(back - start[WHOLE] - start[FRACTION]) > limits[MAX_LEFT_RIGHT]:
        return LEFT_RIGHT
    return ACCEPTED


@kernel()
def _refine(right: Image, point: _Point, start: F64, row_sigma_px: float, p: Patches, result: F64) -> int:
    """Least-squares matching from a whole-pixel match; fills `result`. A `MatchStatus`."""
    half = p.left.shape[0] // 2
    x_right = point.x - int(start[WHOLE])
    cut_out(right, x_right, point.y, p.spline)
    spline_rows(p.spline)
    unknowns = np.array([start[FRACTION], start[START_SLOPE_X], start[START_SLOPE_Y], 1.0, 0.0])
    variance = fit(unknowns, p)
    if variance == LEFT_PATCH:
        return OUTSIDE
    if variance < 0.0 or unknowns[GAIN] <= 0.0:
        return DIVERGED
    reach = half * (abs(1.0 - unknowns[SLOPE_X]) + abs(unknowns[SLOPE_Y])) + abs(unknowns[SHIFT])
    if x_right - reach < 0.0 or x_right + reach > right.shape[1] - 1:
        return OUTSIDE
    # disparity of the point itself, which need not lie on a pixel
    weights = np.array([1.0, point.rest_x, point.rest_y, 0.0, 0.0])
    result[DISPARITY] = start[WHOLE] + np.sum(weights[:3] * unknowns[:3])
    result[SIGMA] = math.sqrt(variance_of(weights, unknowns, variance, row_sigma_px, p))
    result[RESULT_SLOPE_X], result[RESULT_SLOPE_Y] = unknowns[SLOPE_X], unknowns[SLOPE_Y]
    return ACCEPTED


@kernel()
def _match_point(
    left: Image, right: Image, point: _Point, limits: F64, s: _Search, p: Patches, result: F64
) -> int:
    """Match one point: texture, search and refinement; a `MatchStatus`."""
    half = s.window.shape[0] // 2
    height, width = left.shape
    if not (half <= point.x < width - half and half <= point.y < height - half):
        return OUTSIDE
    cut_out(left, point.x, point.y, p.value)
    smooth(p.value, p.rows, p.left)
    energy_x, energy_y = _texture(p.left, limits[NOISE])
    # the sigma of a disparity is noise / gradient, from both images
    needed = 2.0 * (limits[NOISE] / limits[MAX_SIGMA]) ** 2
    if energy_x < needed:
        return EDGE_PARALLEL if energy_y >= needed else TEXTURELESS
    start = np.zeros(4)
    reason = _search(left, right, point, limits, s, result, start)
    if reason == ACCEPTED:
        reason = _refine(right, point, start, limits[ROW_SIGMA], p, result)
    if reason == ACCEPTED:
        if not point.lowest <= result[DISPARITY] <= point.highest:
            reason = OUTSIDE
        elif not result[SIGMA] <= limits[MAX_SIGMA]:
            reason = EDGE_PARALLEL if energy_y > 4.0 * energy_x else TEXTURELESS
    if reason != ACCEPTED:
        result[: RESULT_SLOPE_Y + 1] = np.nan
    return reason


@kernel("void(u1[:, ::1], u1[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8[::1], f8[:, ::1], i8[::1])")
def _match(
    left: Image, right: Image, points: F64, ranges: F64, half: int, limits: F64, results: F64, reasons: I64
) -> None:
    """Match every point in turn; fills reasons and results (N, 7), which are NaN on entry."""
    search, patches = _make_search(left.shape[1], half), make_patches(half)
    for n in range(points.shape[0]):
        x, y = points[n]
        # in this form NaN is outside, too
        if not (0.0 <= x <= left.shape[1] - 1.0 and 0.0 <= y <= left.shape[0] - 1.0):
            reasons[n] = OUTSIDE
            continue
        whole_x, whole_y = math.floor(x + 0.5), math.floor(y + 0.5)
        point = _Point(whole_x, whole_y, x - whole_x, y - whole_y, ranges[n, 0], ranges[n, 1])
        reasons[n] = _match_point(left, right, point, limits, search, patches, results[n])
