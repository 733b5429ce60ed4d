"""Choice of the operator width that measures a curve best, and how far its edges may be displaced.

Best is the smallest variance plus squared bias. A second edge close by (a chamfer, the wall of a disc),
texture and shading pull a wide operator more than a narrow one, and along a whole arc: the slowly varying
difference between a width and the narrowest one is its bias.
"""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import B8, F64, I64
from edged.vision.curves.params import FIT
from edged.vision.edges.subpixel import WIDTHS_PX
from edged.vision.kernels.cholesky import invert
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import (
    MIN_SAMPLES,
    MIN_SIGMA_PX,
    correlation_length,
    robust_scale,
    tukey_weight,
    weighted_moments,
)

# numba freezes globals when it compiles: kernels read these by name
CLIPPED_WEIGHT = FIT.clipped_weight
BIAS_SHARE = FIT.bias_share
MIN_BIAS_PX = FIT.min_bias_px
SIGNIFICANT = FIT.significant
CERTAIN = FIT.certain
START_WIDTH = FIT.start_width
NEIGHBOURS = FIT.contrast_neighbours
FIRST_ROUNDS = FIT.first_rounds
NEXT_ROUNDS = FIT.next_rounds


@kernel("void(f8[::1], f8[::1], b1[::1], f8, f8[::1], f8[::1])")
def _weigh(offset: F64, slope: F64, clipped: B8, min_slope: float, values: F64, base: F64) -> None:
    """Fill values, 0 where there is no edge, and prior weights.

    Noise and texture move an edge the more, the weaker it is: where the mean contrast around a sample is
    below the median of the curve, its weight falls with the square of the ratio.
    """
    count = len(offset)
    kept, contrast = 0, np.empty(count)
    for n in range(count):
        known = np.isfinite(offset[n]) and abs(slope[n]) >= min_slope
        values[n] = offset[n] if known else 0.0
        base[n] = 0.0
        if known:
            base[n] = CLIPPED_WEIGHT if clipped[n] else 1.0
    beside = min(NEIGHBOURS, (count - 1) // 2)
    around, total, many = np.zeros(count), 0.0, 0  # sums over a window that moves along the curve
    for n in range(-2 * beside, count):
        ahead, behind = n + beside, n - beside - 1
        ahead += count if ahead < 0 else (-count if ahead >= count else 0)
        behind += count if behind < 0 else 0
        if base[ahead] > 0.0:
            total, many = total + abs(slope[ahead]), many + 1
        if n > 0 and base[behind] > 0.0:
            total, many = total - abs(slope[behind]), many - 1
        if n >= 0 and base[n] > 0.0:
            around[n] = contrast[kept] = total / many
            kept += 1
    if kept == 0:
        return
    middle = median(contrast[:kept])
    for n in range(count):
        if around[n] < middle:
            base[n] *= (around[n] / middle) ** 2


@kernel("UniTuple(f8, 2)(f8[::1], f8[::1], f8[:, ::1], i8, f8[::1])", any_order=True)
def variance_of_mean(values: F64, base: F64, waves: F64, rounds: int, shares: F64) -> tuple[float, float]:
    """Variance of the mean of samples around a curve, and the mean square of their slow changes.

    Slow changes are those that the waves (M, N) explain; they are no noise. (inf, 0) for too few samples.
    shares (N,) : robust weight of each sample in [0, 1], a factor of its base; first the start, then the
    result.
    """
    many, count = waves.shape
    known, total = 0, 0.0
    for n in range(count):
        known += base[n] > 0.0
        total += base[n] * shares[n]
    if known < MIN_SAMPLES or total <= 0.0:
        return np.inf, 0.0
    weights, residuals = np.empty(count), np.empty(count)
    matrix, inverse, right_side = np.empty((many, many)), np.empty((many, many)), np.empty(many)
    for _ in range(rounds):
        for n in range(count):
            weights[n] = base[n] * shares[n]
        weighted_moments(waves, values, weights, matrix, right_side)
        if not invert(matrix, inverse):
            return np.inf, 0.0
        for n in range(count):
            residuals[n] = values[n]
        for i in range(many):
            wave, amplitude = waves[i], 0.0
            for j in range(many):
                amplitude += inverse[i, j] * right_side[j]
            for n in range(count):
                residuals[n] -= amplitude * wave[n]
        accuracy = 1.0 / max(robust_scale(residuals, base), 1e-3)
        for n in range(count):
            shares[n] = tukey_weight(residuals[n] * accuracy)
    total, variance, square = 0.0, 0.0, 0.0
    for n in range(count):
        weights[n] = base[n] * shares[n]
        total += weights[n]
        variance += weights[n] * residuals[n] ** 2
        square += weights[n] * (values[n] - residuals[n]) ** 2
    if total <= 0.0:
        return np.inf, 0.0
    variance = max(variance / total, MIN_SIGMA_PX**2)
    return variance * correlation_length(residuals, weights) / total, square / total


@kernel("f8(f8[::1], f8[::1], f8[::1], f8[::1])")
def _blur2(narrow_slope: F64, narrow_base: F64, wide_slope: F64, wide_base: F64) -> float:
    """Variance of the blur in px², from the slopes at two widths: slope² ~ 1 / (blur² + width²)."""
    count, ratios = 0, np.empty(len(narrow_slope))
    for n in range(len(narrow_slope)):
        if narrow_base[n] > 0.0 and wide_base[n] > 0.0:
            ratios[count] = narrow_slope[n] / wide_slope[n]
            count += 1
    if count == 0:
        return 0.0
    ratio = median(ratios[:count]) ** 2
    narrow2, wide2 = WIDTHS_PX[0] ** 2, WIDTHS_PX[START_WIDTH] ** 2
    if ratio <= 1.0:
        return wide2
    return min(max((wide2 - ratio * narrow2) / (ratio - 1.0), 0.0), wide2)


@kernel("void(f8[:, ::1], f8[:, ::1], b1[::1], i8[::1], f8[:, ::1], f8, f8[:, ::1], f8[:, ::1])")
def choose(
    offset: F64,
    slope: F64,
    clipped: B8,
    starts: I64,
    waves: F64,
    min_slope: float,
    samples: F64,
    curves: F64,
) -> None:
    """Choose the operator width of each curve.

    Fills samples (2, N) with offset, base, and curves (2, K) with bias, blur².
    offset, slope (W, N) : for each width, the narrowest first.  starts (K + 1,) : first sample of each curve.
    """
    many, modes = offset.shape[0], waves.shape[1]
    for k in range(len(starts) - 1):
        a, b = starts[k], starts[k + 1]
        values, base = np.empty((many, b - a)), np.empty((many, b - a))
        slow_changes = waves[a:b].T.copy() if many > 1 else waves[:0].T.copy()
        for w in range(many):
            _weigh(offset[w, a:b], slope[w, a:b], clipped[a:b], min_slope, values[w], base[w])
        best, best_merit, at_start = 0, np.inf, 0.0
        shares, alike = np.ones(b - a), np.ones(b - a)
        change, common = np.empty(b - a), np.empty(b - a)
        for w in range(many if many > 1 else 0):
            rounds = FIRST_ROUNDS if w == 0 else NEXT_ROUNDS
            variance, _ = variance_of_mean(values[w], base[w], slow_changes, rounds, shares)
            doubt, slow = 0.0, 0.0
            if w > 0:
                for n in range(b - a):
                    change[n] = values[w, n] - values[0, n]
                    common[n] = min(base[w, n], base[0, n])
                rounds = FIRST_ROUNDS if w == 1 else NEXT_ROUNDS
                doubt, slow = variance_of_mean(change, common, slow_changes, rounds, alike)
            chance = modes * doubt  # mean square of the waves from noise alone
            square = slow - chance if slow > SIGNIFICANT * chance else 0.0
            if w == START_WIDTH:
                at_start = square
            merit = variance + (square if slow > CERTAIN * chance else 0.0)
            if merit < best_merit:
                best, best_merit = w, merit
        if many > 1:
            curves[0, k] = max(BIAS_SHARE * np.sqrt(at_start / modes), MIN_BIAS_PX)
            curves[1, k] = _blur2(slope[0, a:b], base[0], slope[START_WIDTH, a:b], base[START_WIDTH])
        for n in range(a, b):
            samples[1, n] = base[best, n - a]
            samples[0, n] = values[best, n - a] if base[best, n - a] > 0.0 else np.nan
