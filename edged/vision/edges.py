"""Sub-pixel edges along given normals, straight from the raw image.

No rectification, no smoothing of the whole image: a profile is sampled across each predicted
edge point with bicubic interpolation, and the edge is the extremum of the profile's convolution
with the derivative of a Gaussian (J. Canny, PAMI 1986). A blurred step gives a Gaussian hill there,
so the extremum is refined by the Gaussian through it and its neighbours: a parabola would pull it
towards the sample by up to 0.023 px. At its best width, sqrt(5) times the blur, that operator is
within 1.2 x of the Cramér-Rao bound for an edge in white noise. Beside texture a narrower one is
better, so an edge can be measured at several widths from one profile; who fits the curve sees which
of them scatters least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.vision.jit import kernel

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

EDGE_SIGMA_PX = 1.2
"""Width of the operator: about sqrt(5) times the blur of a focused lens (0.55 px) is optimal."""
WIDTHS_PX = (0.6, 0.85, 1.2, 1.7)
"""Widths to choose from: beside texture, in between, focused lens with noise, soft or noisy image."""
FINE_STEP_PX = 0.5
"""Sampling of the profile for narrow operators."""
_HILL_SHARE = 0.25
"""Of the extremum that both neighbours of a blurred step exceed at either sampling; below it, texture."""
_MAX_PEAK = 1.2
"""The peak of a hill is less than this times its highest sample: exp(log(1 / _HILL_SHARE) / 8)."""
_TOGETHER = 64  # profiles that are worked on side by side
_CLIP_REACH_PX = 2.5  # the plateaus on both sides of an edge begin here, for a blur of up to 1 px


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSamples:
    """Edges across N points, at W widths of the operator.

    offset_px (W, N) : along the normal, NaN where there is no edge.
    slope (W, N) : grey values per px at the edge, signed.
    clipped (N,) bool : the sensor is saturated (or black) beside the edge, which moves it.
    """

    offset_px: FloatArray
    slope: FloatArray
    clipped: npt.NDArray[np.bool_]


def edges_along_normals(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    reach_px: float,
    polarity: int,
    sigma_px: float = EDGE_SIGMA_PX,
) -> tuple[FloatArray, FloatArray]:
    """Find the strongest edge across each point, within `reach_px` along its normal.

    image : (H, W) uint8.  points_px, normals : (N, 2) float64, (x, y), unit normals.
    polarity : +1 brighter along the normal, -1 darker, 0 either.
    Returns offset_px (N,) along the normal, NaN where there is no extremum or the profile leaves
    the image, and slope (N,), grey values per px at the edge (signed, NaN likewise).
    An extremum counts less the farther it is from the point (Gaussian of width reach), so that of
    two equal edges the nearer one is taken.
    """
    step_px = 1.0 if sigma_px >= 1.0 else FINE_STEP_PX
    samples = _measured(image, points_px, normals, reach_px, polarity, [sigma_px], step_px)
    return samples.offset_px[0], samples.slope[0]


def edges_at_widths(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    reach_px: float,
    polarity: int | npt.NDArray[np.int64],
    widths_px: Sequence[float] = WIDTHS_PX,
    step_px: float = FINE_STEP_PX,
) -> EdgeSamples:
    """`edges_along_normals` for several operators at once, with saturation noted.

    polarity : as there, or one for each point (N,).  step_px : of the samples across the edge; with 1 px
    an edge is found to 0.02 px in half of the time.
    """
    return _measured(image, points_px, normals, reach_px, polarity, widths_px, step_px)


def edge_profiles(
    image: Image, points_px: FloatArray, normals: FloatArray, half_px: float, step_px: float = FINE_STEP_PX
) -> tuple[FloatArray, FloatArray]:
    """Grey values (N, S) across each point and their places (S,) in px; NaN rows leave the image."""
    half = round(half_px / step_px)
    places = np.asarray(np.arange(-half, half + 1) * step_px, dtype=np.float64)
    return _profiles(_pixels(image), _columns(points_px), _columns(normals), half, step_px), places


def _measured(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    reach_px: float,
    polarity: int | npt.NDArray[np.int64],
    widths_px: Sequence[float],
    step_px: float,
) -> EdgeSamples:
    points = _columns(points_px)
    signs = np.full(len(points), polarity, dtype=np.int64)
    widths = np.asarray(widths_px, dtype=np.float64)
    result = _edge_offsets(
        _pixels(image), points, _columns(normals), float(reach_px), widths, signs, float(step_px)
    )
    count = len(widths)
    return EdgeSamples(result[:count], result[count : 2 * count], result[2 * count] > 0)


def _columns(points: FloatArray) -> FloatArray:
    return np.require(points, np.float64, ("C", "W"))


def _pixels(image: Image) -> Image:
    """As the kernels take it: a copy of what is a view or read-only."""
    return np.require(image, np.uint8, ("C", "W"))


@kernel("UniTuple(f8, 4)(f8)", any_order=True)
def _cubic(f: float) -> tuple[float, float, float, float]:
    """Catmull-Rom weights of the four values around a place f past the second (R. Keys, 1981, a = -0.5)."""
    half, square = 0.5 * f, 0.5 * f * f
    return (
        half * (f * (2.0 - f) - 1.0),
        1.0 + square * (3.0 * f - 5.0),
        half * (1.0 + f * (4.0 - 3.0 * f)),
        square * (f - 1.0),
    )


@kernel("b1(u1[:, ::1], f8, f8, f8, f8, i8, f8[::1])", any_order=True)
def _sample_profile(
    image: Image, x: float, y: float, sx: float, sy: float, half: int, profile: FloatArray
) -> bool:
    """Fill profile with 2 half + 1 bicubic samples, (sx, sy) apart; False when it leaves the image."""
    height, width = image.shape
    for end in (-half, half):
        px, py = x + end * sx, y + end * sy
        if not (1.0 <= px < width - 2.0 and 1.0 <= py < height - 2.0):
            return False
    for s in range(2 * half + 1):
        px = x + (s - half) * sx
        py = y + (s - half) * sy
        # inside the image, see above: as unsigned numbers they need no check for negative indices
        ix, iy = np.uint64(px), np.uint64(py)
        wa, wb, wc, wd = _cubic(px - ix)
        above, here, below, last = _cubic(py - iy)
        a, b, c, d = ix - np.uint64(1), ix, ix + np.uint64(1), ix + np.uint64(2)
        row = image[iy - np.uint64(1)]
        value = above * (wa * row[a] + wb * row[b] + wc * row[c] + wd * row[d])
        row = image[iy]
        value += here * (wa * row[a] + wb * row[b] + wc * row[c] + wd * row[d])
        row = image[iy + np.uint64(1)]
        value += below * (wa * row[a] + wb * row[b] + wc * row[c] + wd * row[d])
        row = image[iy + np.uint64(2)]
        profile[s] = value + last * (wa * row[a] + wb * row[b] + wc * row[c] + wd * row[d])
    return True


@kernel("f8[:, ::1](u1[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8)")
def _profiles(image: Image, points: FloatArray, normals: FloatArray, half: int, step: float) -> FloatArray:
    count = points.shape[0]
    found = np.full((count, 2 * half + 1), np.nan)
    profile = np.empty(2 * half + 1)
    for n in range(count):
        x, y = points[n, 0], points[n, 1]
        if _sample_profile(image, x, y, normals[n, 0] * step, normals[n, 1] * step, half, profile):
            found[n] = profile
    return found


@kernel("void(f8[:, ::1], f8[::1], i8, i8, i8, f8[:, ::1])", any_order=True)
def _slopes(
    profiles: FloatArray, derivative: FloatArray, radius: int, half: int, inner: int, slopes: FloatArray
) -> None:
    """Profiles (S, B), one in each column, times the derivative of a Gaussian, at the inner places."""
    side_by_side = profiles.shape[1]
    for s in range(2 * inner + 1):
        middle, total = half - inner + s, slopes[s]
        total[:] = 0.0
        for i in range(1, radius + 1):  # the operator is odd
            gain, ahead, behind = derivative[radius + i], profiles[middle + i], profiles[middle - i]
            for n in range(side_by_side):
                total[n] += gain * (ahead[n] - behind[n])


@kernel("UniTuple(f8, 2)(f8[:, ::1], i8, f8, i8, f8)")
def _best_extremum(
    slopes: FloatArray, n: int, reach: float, polarity: int, step: float
) -> tuple[float, float]:
    """(offset px, slope) of the strongest extremum in column n of the slopes; NaN if there is none."""
    inner = len(slopes) // 2
    best_weight, best_offset, best_slope = 0.0, np.nan, np.nan
    for s in range(1, 2 * inner):
        before, here, after = slopes[s - 1, n], slopes[s, n], slopes[s + 1, n]
        if polarity < 0 or (polarity == 0 and here < 0):
            before, here, after = -before, -here, -after
        if here <= 0 or here < before or here <= after:
            continue
        if min(before, after) > _HILL_SHARE * here:
            if _MAX_PEAK * here < best_weight:
                continue
            lead = np.log(before / after)
            fraction = 0.5 * lead / np.log(before * after / (here * here))
            peak = here * np.exp(-0.25 * lead * fraction)
        else:
            fraction = 0.5 * (before - after) / (before - 2.0 * here + after)
            peak = here - 0.25 * (before - after) * fraction
        offset = (s - inner + fraction) * step
        weight = peak * np.exp(-0.5 * (offset / reach) ** 2)
        if abs(offset) <= reach and weight > best_weight:
            best_weight, best_offset = weight, offset
            best_slope = peak if slopes[s, n] > 0 else -peak
    return best_offset, best_slope


@kernel("b1(f8[:, ::1], i8, f8, f8)")
def _clips(profiles: FloatArray, n: int, offset: float, step: float) -> bool:
    """Whether the sensor is saturated, or black, beside an edge of the profile in column n."""
    half = len(profiles) // 2
    middle, span = half + offset / step, _CLIP_REACH_PX / step
    for s in range(max(0, int(middle - span)), min(2 * half, int(np.ceil(middle + span))) + 1):
        if profiles[s, n] >= 254.5 or profiles[s, n] <= 0.5:
            return True
    return False


@kernel("f8[:, ::1](u1[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8[::1], i8[::1], f8)")
def _edge_offsets(
    image: Image,
    points: FloatArray,
    normals: FloatArray,
    reach: float,
    widths: FloatArray,
    polarity: npt.NDArray[np.int64],
    step: float,
) -> FloatArray:
    """Rows: the offset at each width, then the slope at each width, then 1 where the sensor clips."""
    count, many = points.shape[0], widths.shape[0]
    found = np.full((2 * many + 1, count), np.nan)
    inner = int(np.ceil(reach / step)) + 1  # one more on each side: an extremum has two neighbours
    radii = np.empty(many, np.int64)
    for w in range(many):
        radii[w] = int(np.ceil(3.5 * widths[w] / step))
    half = inner + radii.max()
    derivatives = np.zeros((many, 2 * half + 1))
    for w in range(many):
        gain = 0.0
        for i in range(-radii[w], radii[w] + 1):
            value = i * np.exp(-0.5 * (i * step / widths[w]) ** 2)
            derivatives[w, i + radii[w]] = value
            gain += i * step * value
        derivatives[w] /= gain
    profile, profiles = np.empty(2 * half + 1), np.zeros((2 * half + 1, _TOGETHER))
    slopes = np.empty((2 * inner + 1, _TOGETHER))
    for first in range(0, count, _TOGETHER):
        for n in range(first, min(first + _TOGETHER, count)):
            x, y = points[n, 0], points[n, 1]
            sx, sy = normals[n, 0] * step, normals[n, 1] * step
            if np.isfinite(x + y) and _sample_profile(image, x, y, sx, sy, half, profile):
                profiles[:, n - first] = profile
                found[2 * many, n] = 0.0
        for w in range(many):
            _slopes(profiles, derivatives[w], radii[w], half, inner, slopes)
            for n in range(first, min(first + _TOGETHER, count)):
                if np.isnan(found[2 * many, n]):
                    continue
                offset, slope = _best_extremum(slopes, n - first, reach, polarity[n], step)
                found[w, n], found[many + w, n] = offset, slope
                if found[2 * many, n] == 0.0 and np.isfinite(offset):
                    found[2 * many, n] = 1.0 if _clips(profiles, n - first, offset, step) else 0.0
    return found
