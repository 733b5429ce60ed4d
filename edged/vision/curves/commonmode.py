"""Edges of one curve in both cameras, as their means (common mode) and differences.

Both images are sampled at the same points of a curve. Anything that displaces its edge in space, such as
texture and tool marks of the part or the roundness of the rim, displaces it in both images alike: the edges
of machined parts correlate by 0.2 to 0.7. This does not affect depth and tilt, which follow from the
difference of the images, and for centre and radius both images count as one observation, not as two. So the
offsets of a point that both cameras see are transformed to their mean and their difference; the mean is
weighted by each camera's own scatter so that both are independent. A point that only one camera sees stays
as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, F64, I64, FloatArray
from edged.vision.curves.params import FIT
from edged.vision.kernels.jit import B1, F1, F2, I1, kernel
from edged.vision.kernels.robust import MIN_SAMPLES, robust_scale

# numba freezes globals when it compiles: kernels read these by name
_APART = FIT.apart
_CLIP = FIT.clip
_MIN_SHARE = FIT.min_camera_share
_MIN_GAIN = FIT.min_gain
_MIN_PRIOR_RATIO = FIT.min_prior_ratio
LEAST_GAIN = 1e-9  # px/mm, avoids a division by 0
PARTS = ("means", "differences", "left alone", "right alone")
"""Parts of a curve's rows, as `Pairs.rows` numbers them."""


class Pairs(NamedTuple):
    """Assignment of the rows of the left and the right image (N each) to parts of K curves.

    both (N,) bool : seen by both cameras.  share (N,) : of the left one in the mean.  gain (2, N) : as in
    `pair`, but never 0.
    rows (M,) : indices of the 4 N rows (means, differences, left alone, right alone) in use, curve by curve.
    starts (Q + 1,), parts (K + 1,), paired (K,), base (M,) : as in `samples.Samples`.
    """

    both: B1
    share: F1
    gain: F2
    rows: I1
    starts: I1
    parts: I1
    paired: B1
    base: F1

    def rows_of(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """(M, ...) rows in use, from those of both images, (N, ...) each."""
        shape = (len(self.both), -1)
        rows = rows_of(
            self, np.ascontiguousarray(left.reshape(shape)), np.ascontiguousarray(right.reshape(shape))
        )
        return rows.reshape(len(self.rows), *left.shape[1:])


@kernel("Pairs(f8[:, ::1], f8[:, ::1], f8[:, ::1], i8[::1], b1)", tuples=(Pairs,))
def pair(offset_px: F64, base: F64, gain: F64, starts: I64, together: bool) -> Pairs:
    """Pair the edges of K curves.

    offset_px, base (2, N) : along the normals, left and right, and prior weights, 0 where there is no edge.
    gain (2, N) : motion along the normals of the images per motion of the curve along its own, px/mm.
    starts (K + 1,).  together : False keeps all edges single, for curves that are not yet in place.
    """
    count, curves = len(base[0]), len(starts) - 1
    sure, most = np.empty((2, count)), 0.0
    for side in range(2):
        for n in range(count):
            sure[side, n] = gain[side, n] if abs(gain[side, n]) > LEAST_GAIN else LEAST_GAIN
            most = max(most, abs(sure[side, n]))
    both, share, weights = np.zeros(count, np.bool_), np.full(count, 0.5), np.zeros((4, count))
    weights[2:] = base
    if together:
        places = np.empty((2, count))
        for n in range(count):
            left, right = base[0, n], base[1, n]
            both[n] = min(abs(sure[0, n]), abs(sure[1, n])) > _MIN_GAIN * most
            both[n] &= min(left, right) > _MIN_PRIOR_RATIO * max(left, right)
            if both[n]:
                weights[0, n] = weights[1, n] = 2.0 / (1.0 / left + 1.0 / right)
                weights[2, n] = weights[3, n] = 0.0
            for side in range(2):
                known = not np.isnan(offset_px[side, n])
                places[side, n] = offset_px[side, n] / sure[side, n] if known else 0.0
        share = _shares(places, both, starts)
    counts, parts = np.zeros((4, curves), np.int64), np.zeros(curves + 1, np.int64)
    borders, total = np.zeros(4 * curves + 1, np.int64), 0
    paired = np.zeros(curves, np.bool_)
    for k in range(curves):
        parts[k + 1] = parts[k]
        for kind in range(4):
            for n in range(starts[k], starts[k + 1]):
                counts[kind, k] += weights[kind, n] > 0.0
            if counts[kind, k] >= MIN_SAMPLES:
                total += starts[k + 1] - starts[k]
                parts[k + 1] += 1
                borders[parts[k + 1]] = total
        paired[k] = counts[0, k] >= MIN_SAMPLES
    rows, chosen, m = np.empty(total, np.int64), np.empty(total), 0
    for k in range(curves):
        for kind in range(4):
            for n in range(starts[k], starts[k + 1] if counts[kind, k] >= MIN_SAMPLES else 0):
                rows[m], chosen[m] = kind * count + n, weights[kind, n]
                m += 1
    return Pairs(both, share, sure, rows, borders[: parts[curves] + 1].copy(), parts, paired, chosen)


@kernel("f8[:, ::1](Pairs, f8[:, ::1], f8[:, ::1])", tuples=(Pairs,))
def rows_of(pairs: Pairs, left: F64, right: F64) -> F64:
    """(M, C) rows in use among means, differences, left and right rows, from left and right, (N, C) each."""
    count, columns = left.shape
    found = np.empty((len(pairs.rows), columns))
    for m in range(len(pairs.rows)):
        kind, n = pairs.rows[m] // count, pairs.rows[m] % count
        middle = 0.5 * (pairs.gain[0, n] + pairs.gain[1, n])
        of_left, of_right = 0.0, 0.0
        if kind == 0:
            of_left = pairs.share[n] * (middle / pairs.gain[0, n])
            of_right = (1.0 - pairs.share[n]) * (middle / pairs.gain[1, n])
        elif kind == 1:
            of_left, of_right = middle / pairs.gain[0, n], -(middle / pairs.gain[1, n])
        elif kind == 2:
            of_left = 1.0
        else:
            of_right = 1.0
        for c in range(columns):
            found[m, c] = of_left * left[n, c] + of_right * right[n, c]
    return found


@kernel("void(Pairs, f8[::1], f8[::1], f8[:, ::1], f8[:, ::1])", tuples=(Pairs,))
def by_camera(pairs: Pairs, residuals: F64, weights: F64, seen_residuals: F64, seen_weights: F64) -> None:
    """Fill seen_residuals, seen_weights (2, N), 0 where there is no edge, from those of the rows, (M,) each.

    The weight of a pair is the lower of those of its mean and its difference.
    """
    count = len(pairs.both)
    full = np.zeros((2, 4 * count))
    for m in range(len(pairs.rows)):
        full[0, pairs.rows[m]], full[1, pairs.rows[m]] = residuals[m], weights[m]
    for n in range(count):
        for side in range(2):
            seen_residuals[side, n] = full[0, (2 + side) * count + n]
            seen_weights[side, n] = full[1, (2 + side) * count + n]
        if pairs.both[n]:
            middle = 0.5 * (pairs.gain[0, n] + pairs.gain[1, n])
            mean, apart, share = full[0, n], full[0, count + n], pairs.share[n]
            seen_residuals[0, n] = (mean + (1.0 - share) * apart) * (pairs.gain[0, n] / middle)
            seen_residuals[1, n] = (mean - share * apart) * (pairs.gain[1, n] / middle)
            seen_weights[0, n] = seen_weights[1, n] = min(full[1, n], full[1, count + n])


@kernel("f8(f8[::1])")
def _clipped_square(values: F64) -> float:
    """Mean square of values clipped at _CLIP sigmas: steadier than a median."""
    limit, total = _CLIP * robust_scale(values, np.ones(len(values))), 0.0
    for n in range(len(values)):
        total += min(abs(values[n]), limit) ** 2
    return total / len(values)


@kernel("f8[::1](f8[:, ::1], b1[::1], i8[::1])")
def _shares(places: F64, both: B8, starts: I64) -> F64:
    """(N,) share of the left camera in the mean: the larger, the smaller its own scatter.

    Offsets are a common part plus each camera's own scatter. The variances of left, right and difference
    give the latter: (difference + left - right) / 2 is that of the left camera.
    """
    share = np.full(len(both), 0.5)
    for k in range(len(starts) - 1):
        a, b = starts[k], starts[k + 1]
        count = 0
        left, right, apart = np.empty(b - a), np.empty(b - a), np.empty(b - a)
        for n in range(a, b - _APART):
            if both[n] and both[n + _APART]:
                left[count] = places[0, n + _APART] - places[0, n]
                right[count] = places[1, n + _APART] - places[1, n]
                apart[count] = left[count] - right[count]
                count += 1
        if count < MIN_SAMPLES:
            continue
        difference = _clipped_square(apart[:count])
        of_left, of_right = _clipped_square(left[:count]), _clipped_square(right[:count])
        if difference > 0.0:
            of_right_alone = 0.5 * (difference + of_right - of_left) / difference
            share[a:b] = min(max(of_right_alone, _MIN_SHARE), 1.0 - _MIN_SHARE)
    return share
