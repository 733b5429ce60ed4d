"""Sub-pixel edges along given normals, measured directly in the raw image.

No rectification, no smoothing of the whole image: a profile is sampled across each predicted
edge point with bicubic interpolation, and the edge is the extremum of the profile's convolution
with the derivative of a Gaussian (J. Canny, PAMI 1986). A blurred step gives a Gaussian peak there,
so the extremum is refined by the Gaussian through it and its neighbours: a parabola would pull it
towards the sample by up to 0.023 px. At its best width, sqrt(5) times the blur, that operator is
within 1.2 x of the Cramér-Rao bound for an edge in white noise. Beside texture a narrower one is
better, so an edge can be measured at several widths from one profile; the curve fit then shows which
of them scatters least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, F32, F64, I32, I64, FloatArray, Image
from edged.vision.edges.params import EDGE
from edged.vision.kernels.jit import for_kernel, kernel

# numba freezes globals when it compiles: kernels read these by name
WIDTHS_PX = EDGE.widths_px
_HILL_SHARE = EDGE.hill_share
_TOGETHER = 128  # profiles processed side by side
_EXTREMUM = 1 << 16  # more than the samples of a profile, so that one number holds a count and a position
_CLIP_REACH_PX = EDGE.clip_reach_px
_WHITE, _BLACK = 254.5, 0.5  # grey values of clipped 8-bit pixels


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSamples:
    """Edges across N points, at W operator widths.

    offset_px (W, N) : along the normal, NaN where there is no edge.
    slope (W, N) : grey values per px at the edge, signed.
    clipped (N,) bool : the sensor is saturated (or black) beside the edge, which displaces it.
    """

    offset_px: FloatArray
    slope: FloatArray
    clipped: B8


def edges_along_normals(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    reach_px: float,
    polarity: int,
    sigma_px: float = EDGE.sigma_px,
) -> tuple[FloatArray, FloatArray]:
    """Find the strongest edge across each point, within `reach_px` along its normal.

    image : (H, W) uint8.  points_px, normals : (N, 2) float64, (x, y), unit normals.
    polarity : +1 brighter along the normal, -1 darker, 0 either.
    Returns offset_px (N,) along the normal, NaN where there is no extremum or the profile leaves
    the image, and slope (N,), grey values per px at the edge (signed, NaN likewise).
    Extrema are weighted down with their distance from the point (Gaussian of width reach), so that of
    two equal edges the nearer one is taken.
    """
    step_px = 1.0 if sigma_px >= 1.0 else EDGE.fine_step_px
    samples = _measured(image, points_px, normals, reach_px, polarity, [sigma_px], step_px)
    return samples.offset_px[0], samples.slope[0]


def edges_at_widths(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    reach_px: float,
    polarity: int | I64,
    widths_px: Sequence[float] = WIDTHS_PX,
    step_px: float = EDGE.fine_step_px,
) -> EdgeSamples:
    """`edges_along_normals` for several operator widths at once, with a flag for saturation.

    polarity : as there, or one for each point (N,).  step_px : sampling across the edge; with 1 px
    an edge is found to 0.02 px in half the time.
    """
    return _measured(image, points_px, normals, reach_px, polarity, widths_px, step_px)


def edge_profiles(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    half_px: float,
    step_px: float = EDGE.fine_step_px,
) -> tuple[FloatArray, FloatArray]:
    """Grey values (N, S) across each point, and positions (S,) in px; rows that leave the image are NaN."""
    half = round(half_px / step_px)
    places = np.asarray(np.arange(-half, half + 1) * step_px, dtype=np.float64)
    points, across = for_kernel(points_px, np.float64), for_kernel(normals, np.float64)
    return profiles_across(for_kernel(image, np.uint8), points, across, half, step_px), places


def _measured(
    image: Image,
    points_px: FloatArray,
    normals: FloatArray,
    reach_px: float,
    polarity: int | I64,
    widths_px: Sequence[float],
    step_px: float,
) -> EdgeSamples:
    points, across = for_kernel(points_px, np.float64), for_kernel(normals, np.float64)
    signs, widths = np.empty(len(points), np.int32), np.array(widths_px, np.float64)
    signs[:] = polarity
    pixels = for_kernel(image, np.uint8)  # copied if it is a view or read-only
    result = edge_offsets(pixels, points, across, float(reach_px), widths, signs, float(step_px))
    count = len(widths)
    return EdgeSamples(result[:count], result[count : 2 * count], result[2 * count] > 0)


@kernel(inline=True)
def _cubic(f: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Catmull-Rom weights of four values at a fraction f past the second (R. Keys, 1981, a = -0.5)."""
    one, three = np.float32(1.0), np.float32(3.0)
    half = np.float32(0.5) * f
    square = half * f
    return (
        half * (f * (np.float32(2.0) - f) - one),
        one + square * (three * f - np.float32(5.0)),
        half * (one + f * (np.float32(4.0) - three * f)),
        square * (f - one),
    )


@kernel("void(f8[::1], f8[::1], f8, f4[::1], i4[::1])", any_order=True)
def _split(middle: F64, step: F64, s: float, fraction: F32, before: I32) -> None:
    """Split the coordinate of sample s of each profile into a fraction and the index of the first pixel."""
    for n in range(len(middle)):
        place = middle[n] + s * step[n]
        whole = np.floor(place)
        fraction[n] = np.float32(place - whole)
        before[n] = np.int32(np.int32(whole) - np.int32(1))


@kernel(inline=True)
def _four_pixels(flat: Image, at: np.uint64) -> np.int32:
    """Four neighbours on a row packed into one number; the compiler makes a single load of it."""
    return np.int32(
        np.uint32(flat[at])
        | np.uint32(flat[at + np.uint64(1)]) << np.uint32(8)
        | np.uint32(flat[at + np.uint64(2)]) << np.uint32(16)
        | np.uint32(flat[at + np.uint64(3)]) << np.uint32(24)
    )


@kernel("void(u1[::1], i8, i4[::1], i4[::1], i4[:, ::1])", any_order=True)
def _fetch(flat: Image, width: int, left: I32, top: I32, rows: I32) -> None:
    """Fetch the 4 x 4 pixels from (left, top) on as four numbers of four bytes, one for each row."""
    a, b, c, d = rows[0], rows[1], rows[2], rows[3]
    down = np.uint64(width)
    for n in range(len(left)):
        # always inside the image; unsigned indices need no check for negative values
        at = np.uint64(top[n]) * down + np.uint64(left[n])
        a[n] = _four_pixels(flat, at)
        b[n] = _four_pixels(flat, at + down)
        c[n] = _four_pixels(flat, at + down + down)
        d[n] = _four_pixels(flat, at + down + down + down)


@kernel(inline=True)
def _byte(row: np.int32, k: int) -> np.float32:
    return np.float32(np.int32(np.int32(np.uint32(row) >> np.uint32(8 * k)) & np.int32(255)))


@kernel("void(i4[:, ::1], f4[::1], f4[::1], f4[::1])", any_order=True)
def _interpolate(rows: I32, x: F32, y: F32, values: F32) -> None:
    a, b, c, d = rows[0], rows[1], rows[2], rows[3]
    for n in range(len(values)):
        left, here, right, last = _cubic(x[n])
        above, level, below, bottom = _cubic(y[n])
        p, q, r, s = a[n], b[n], c[n], d[n]
        values[n] = (
            left * (above * _byte(p, 0) + level * _byte(q, 0) + below * _byte(r, 0) + bottom * _byte(s, 0))
            + here * (above * _byte(p, 1) + level * _byte(q, 1) + below * _byte(r, 1) + bottom * _byte(s, 1))
            + right * (above * _byte(p, 2) + level * _byte(q, 2) + below * _byte(r, 2) + bottom * _byte(s, 2))
            + last * (above * _byte(p, 3) + level * _byte(q, 3) + below * _byte(r, 3) + bottom * _byte(s, 3))
        )


@kernel("b1(u1[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8, i8, f4[:, ::1], b1[::1])")
def _sample_profiles(
    image: Image,
    points: F64,
    normals: F64,
    first: int,
    step: float,
    half: int,
    profiles: F32,
    inside: B8,
) -> bool:
    """Sample profiles (2 half + 1, B), one per column, across the points from index `first` on.

    inside (B,) : set to whether the point exists and its profile stays in the image. Returns True if any
    does.
    """
    height, width = image.shape
    many, some = len(inside), False
    middle, steps = np.ones((2, many)), np.zeros((2, many))
    for n in range(many):
        inside[n] = False
        if first + n >= len(points):
            continue
        x, y = points[first + n, 0], points[first + n, 1]
        sx, sy = normals[first + n, 0] * step, normals[first + n, 1] * step
        fits = True
        for end in (-half, half):
            px, py = x + end * sx, y + end * sy
            fits = fits and 1.0 <= px < width - 2.0 and 1.0 <= py < height - 2.0
        if fits:
            inside[n] = some = True
            middle[0, n], middle[1, n], steps[0, n], steps[1, n] = x, y, sx, sy
    if not some:
        return False
    flat = image.reshape(image.size)
    fraction, before = np.empty((2, many), np.float32), np.empty((2, many), np.int32)
    rows = np.empty((4, many), np.int32)
    for s in range(2 * half + 1):
        for axis in range(2):
            _split(middle[axis], steps[axis], float(s - half), fraction[axis], before[axis])
        _fetch(flat, width, before[0], before[1], rows)
        _interpolate(rows, fraction[0], fraction[1], profiles[s])
    return True


@kernel("f8[:, ::1](u1[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8)")
def profiles_across(
    image: Image, points: FloatArray, normals: FloatArray, half: int, step: float
) -> FloatArray:
    """`edge_profiles` with 2 half + 1 samples, step px apart."""
    count = points.shape[0]
    found = np.full((count, 2 * half + 1), np.nan)
    profiles, inside = np.empty((2 * half + 1, _TOGETHER), np.float32), np.empty(_TOGETHER, np.bool_)
    for first in range(0, count, _TOGETHER):
        _sample_profiles(image, points, normals, first, step, half, profiles, inside)
        for s in range(2 * half + 1):
            for n in range(min(_TOGETHER, count - first)):
                if inside[n]:
                    found[first + n, s] = profiles[s, n]
    return found


@kernel("void(f4[:, ::1], f4[::1], i8, i8, i8, f4[:, ::1])", any_order=True)
def _slopes(profiles: F32, derivative: F32, radius: int, half: int, inner: int, slopes: F32) -> None:
    """Convolve profiles (S, B), one per column, with the derivative of a Gaussian, at the inner samples."""
    side_by_side = profiles.shape[1]
    for s in range(2 * inner + 1):
        middle, total = half - inner + s, slopes[s]
        total[:] = 0.0
        for i in range(1, radius + 1):  # the operator is odd
            gain, ahead, behind = derivative[radius + i], profiles[middle + i], profiles[middle - i]
            for n in range(side_by_side):
                total[n] += gain * (ahead[n] - behind[n])


@kernel("void(f4[:, ::1], i4[::1], i4[::1])", any_order=True)
def _extrema(slopes: F32, polarity: I32, extrema: I32) -> None:
    """For each column, _EXTREMUM times the number of extrema of its polarity plus the sum of their rows."""
    extrema[:] = 0
    for s in range(1, len(slopes) - 1):
        before, here, after = slopes[s - 1], slopes[s], slopes[s + 1]
        mark = np.int32(_EXTREMUM + s)
        for n in range(len(extrema)):
            slope = here[n]
            falling = polarity[n] < 0 or (polarity[n] == 0 and slope < 0)
            if falling:
                hill = slope < 0 and slope <= before[n] and slope < after[n]
            else:
                hill = slope > 0 and slope >= before[n] and slope > after[n]
            extrema[n] += mark if hill else np.int32(0)


@kernel(inline=True)
def _log_share(share: float) -> float:
    """Logarithm of a number in [_HILL_SHARE, 1] to 4e-9, by a short series for its fourth root."""
    root = np.sqrt(np.sqrt(share))
    z = (root - 1.0) / (root + 1.0)
    z2 = z * z
    series = 1.0 + z2 * (1.0 / 3.0 + z2 * (1.0 / 5.0 + z2 * (1.0 / 7.0 + z2 * (1.0 / 9.0))))
    return float(8.0 * z * series)


@kernel(inline=True)
def _top(before: float, here: float, after: float) -> tuple[float, float]:
    """Position, in samples from the middle one, and height of a maximum through three samples.

    By a Gaussian, or by a parabola if a neighbour is too low for a Gaussian peak.
    """
    rise, fall = _log_share(before / here), _log_share(after / here)
    lead = rise - fall
    fraction = 0.5 * lead / (rise + fall)
    x = -0.25 * lead * fraction  # up to -log(_HILL_SHARE) / 8: six terms of the exponential give 1e-9
    growth = 1.0 + x * (1.0 + x * (0.5 + x * (1 / 6 + x * (1 / 24 + x * (1 / 120 + x * (1 / 720))))))
    bend = 0.5 * (before - after) / (before - 2.0 * here + after)
    if min(before, after) > _HILL_SHARE * here:
        return fraction, here * growth
    return bend, here - 0.25 * (before - after) * bend


@kernel("void(f8[:, ::1], f8[::1], f8[::1])", any_order=True)
def tops(three: F64, fraction: F64, peak: F64) -> None:
    """Fill position and height, as by `_top`, from three samples (3, B) of each profile.

    The series consist of sums and products, which the compiler vectorises over several profiles: five times
    as fast as with the library's logarithm and exponential (`tools/bench kernels`).
    """
    before, here, after = three[0], three[1], three[2]
    for n in range(len(peak)):
        place, height = _top(before[n], here[n], after[n])
        fraction[n], peak[n] = place, height


@kernel("UniTuple(f8, 2)(f4[:, ::1], i8, f8, i8, f8)")
def _best_extremum(slopes: F32, n: int, reach: float, polarity: int, step: float) -> tuple[float, float]:
    """Offset in px and slope of the strongest extremum in column n of the slopes; NaN if there is none."""
    inner = len(slopes) // 2
    best_weight, best_offset, best_slope = 0.0, np.nan, np.nan
    for s in range(1, 2 * inner):
        before, here, after = float(slopes[s - 1, n]), float(slopes[s, n]), float(slopes[s + 1, n])
        if polarity < 0 or (polarity == 0 and here < 0):
            before, here, after = -before, -here, -after
        if here <= 0 or here < before or here <= after:
            continue
        fraction, peak = _top(before, here, after)
        offset = (s - inner + fraction) * step
        weight = peak * np.exp(-0.5 * (offset / reach) ** 2)
        if abs(offset) <= reach and weight > best_weight:
            best_weight, best_offset = weight, offset
            best_slope = peak if slopes[s, n] > 0 else -peak
    return best_offset, best_slope


@kernel("void(f4[:, ::1], i4[::1], f8, f8, f8[::1], f8[::1])")
def _measure_slopes(slopes: F32, polarity: I32, reach: float, step: float, offset: F64, slope: F64) -> None:
    """Fill offset (B,) and slope (B,) of the strongest extremum in each column; NaN if there is none."""
    many, inner = len(polarity), len(slopes) // 2
    extrema, three = np.empty(many, np.int32), np.ones((3, many))
    _extrema(slopes, polarity, extrema)
    for n in range(many):
        if _EXTREMUM < extrema[n] < 2 * _EXTREMUM:
            s = extrema[n] - _EXTREMUM
            sign = 1.0 if slopes[s, n] > 0 else -1.0
            for i in range(3):
                three[i, n] = sign * slopes[s - 1 + i, n]
    fraction, peak = np.empty(many), np.empty(many)
    tops(three, fraction, peak)
    for n in range(many):
        offset[n], slope[n] = np.nan, np.nan
        if extrema[n] >= 2 * _EXTREMUM:
            offset[n], slope[n] = _best_extremum(slopes, n, reach, polarity[n], step)
        elif extrema[n] > 0:
            s = extrema[n] - _EXTREMUM
            place = (s - inner + fraction[n]) * step
            if abs(place) <= reach:
                offset[n], slope[n] = place, peak[n] if slopes[s, n] > 0 else -peak[n]


@kernel("void(f4[:, ::1], b1[::1])", any_order=True)
def _may_clip(profiles: F32, may: B8) -> None:
    """Set whether the sensor is saturated, or black, anywhere on each profile."""
    high, low = profiles[0].copy(), profiles[0].copy()
    for s in range(1, len(profiles)):
        row = profiles[s]
        for n in range(len(row)):
            high[n] = max(high[n], row[n])
        for n in range(len(row)):
            low[n] = min(low[n], row[n])
    for n in range(len(may)):
        may[n] = high[n] >= _WHITE or low[n] <= _BLACK


@kernel("b1(f4[:, ::1], i8, f8, f8)")
def _clips(profiles: F32, n: int, offset: float, step: float) -> bool:
    """Whether the sensor is saturated, or black, beside an edge of the profile in column n."""
    half = len(profiles) // 2
    middle, span = half + offset / step, _CLIP_REACH_PX / step
    for s in range(max(0, int(middle - span)), min(2 * half, int(np.ceil(middle + span))) + 1):
        if profiles[s, n] >= _WHITE or profiles[s, n] <= _BLACK:
            return True
    return False


@kernel(inline=True)
def _radius(width: float, step: float) -> int:
    return int(np.ceil(3.5 * width / step))


@kernel("void(f8, f8, f4[::1])")
def _derivative(width: float, step: float, taps: F32) -> None:
    """Fill taps with the derivative of a Gaussian, normalised so that a ramp of 1 per px gives 1."""
    radius, gain = _radius(width, step), 0.0
    for i in range(-radius, radius + 1):
        gain += i * step * (i * np.exp(-0.5 * (i * step / width) ** 2))
    for i in range(-radius, radius + 1):
        taps[i + radius] = i * np.exp(-0.5 * (i * step / width) ** 2) / gain


@kernel("f8[:, ::1](u1[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8[::1], i4[::1], f8)")
def edge_offsets(
    image: Image, points: F64, normals: F64, reach: float, widths: F64, polarity: I32, step: float
) -> F64:
    """Measure edges; rows: offset at each width, slope at each width, then 1 where the sensor clips."""
    count, many = points.shape[0], widths.shape[0]
    found = np.full((2 * many + 1, count), np.nan)
    inner = int(np.ceil(reach / step)) + 1  # one more on each side: an extremum needs two neighbours
    half = inner
    for width in widths:
        half = max(half, inner + _radius(width, step))
    taps = np.empty((many, 2 * half + 1), np.float32)
    for w in range(many):
        _derivative(widths[w], step, taps[w])
    profiles = np.empty((2 * half + 1, _TOGETHER), np.float32)
    slopes = np.empty((2 * inner + 1, _TOGETHER), np.float32)
    inside, may_clip = np.empty(_TOGETHER, np.bool_), np.empty(_TOGETHER, np.bool_)
    signs, offset, slope = np.zeros(_TOGETHER, np.int32), np.empty(_TOGETHER), np.empty(_TOGETHER)
    for first in range(0, count, _TOGETHER):
        part = min(_TOGETHER, count - first)
        if not _sample_profiles(image, points, normals, first, step, half, profiles, inside):
            continue
        _may_clip(profiles, may_clip)
        for n in range(part):
            signs[n] = polarity[first + n]
        clips = found[2 * many, first : first + part]
        for w in range(many):
            _slopes(profiles, taps[w], _radius(widths[w], step), half, inner, slopes)
            _measure_slopes(slopes, signs, reach, step, offset, slope)
            for n in range(part):
                if not inside[n]:
                    continue
                found[w, first + n], found[many + w, first + n] = offset[n], slope[n]
                if w == 0:
                    clips[n] = 0.0
                if may_clip[n] and clips[n] == 0.0 and np.isfinite(offset[n]):
                    clips[n] = 1.0 if _clips(profiles, n, offset[n], step) else 0.0
    return found
