"""Robust statistics: scale and weights of residuals, and the correlation of samples along a curve.

Samples of an edge scatter (scale) and are correlated along the edge; both are estimated robustly against
outliers. The solver `curves.adjustment` is based on them. Other fits use scale and weights of whole arrays.
Source: P. J. Huber, "Robust Statistics", 1981; J. W. Tukey's biweight with c = 4.685.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import F64
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.median import median

TUKEY = 4.685
"""Tukey's constant for 95 % efficiency with normal errors (P. W. Holland and R. E. Welsch, 1977); the usual
3 costs 5-9 %."""
SIGMA_PER_MEDIAN = 1.4826
"""The sigma of normal errors over the median of their magnitudes."""
MIN_SIGMA_PX = 0.01
"""No edge is better than this in an 8-bit image: floor of the robust scale."""
MAX_LAG = 24  # samples: size of the kernel's array of correlations
MIN_SAMPLES = 12.0  # for a robust scale that is known to a third
_AT_ONCE = 192  # samples whose terms stay in the fastest cache


def mad_sigma(residuals: F64) -> float:
    """Sigma of normal errors, from the median of |residuals| (N,), N >= 1."""
    return SIGMA_PER_MEDIAN * middle_of(np.abs(residuals))


def middle_of(values: F64) -> float:
    """Median of values (N,), N >= 1; NaN if one is NaN. Faster than numpy's, which makes 36 calls."""
    ordered, half = np.array(values), len(values) // 2
    ordered.sort()
    if math.isnan(ordered[-1]):
        return math.nan
    return float(ordered[half] if len(values) % 2 else 0.5 * (ordered[half - 1] + ordered[half]))


def tukey_weights(residuals: F64, sigma: float) -> F64:
    """Tukey's biweight (N,) of residuals (N,), in [0, 1]; 0 from `TUKEY` sigmas on."""
    return np.asarray(np.clip(1 - (residuals / (TUKEY * sigma)) ** 2, 0, None) ** 2)


@kernel("f8(f8[::1], f8[::1])")
def robust_scale(residuals: F64, base: F64) -> float:
    """Sigma of normal errors, from the median of |residuals| where base > 0; 0 if there is none."""
    count = 0
    kept = np.empty(len(residuals))
    for n in range(len(residuals)):
        kept[count] = abs(residuals[n])
        count += base[n] > 0
    if count == 0:
        return 0.0
    return SIGMA_PER_MEDIAN * median(kept[:count])


@kernel("f8(f8)")
def biweight(share: float) -> float:
    """Tukey's biweight of a residual as a share of the limit at which the weight becomes 0."""
    near = max(1.0 - share * share, 0.0)
    return near * near


@kernel("f8(f8)")
def tukey_weight(ratio: float) -> float:
    """Tukey's biweight of residual / scale."""
    return float(biweight(ratio / TUKEY))


@kernel("f8(f8[::1], f8[::1])", any_order=True)
def correlation_length(residuals: F64, weights: F64) -> float:
    """Correlation length of samples around a closed curve: 1 + 2 times the sum of their autocorrelation.

    Texture and machining marks displace an edge over several px along its length; if such samples counted as
    independent, the stated sigma would be too small. The sum ends at the first lag that is not significant.
    """
    count = len(residuals)
    kept, known = np.zeros(count), np.zeros(count)  # 0 where there is no edge: it adds nothing
    good, power = 0.0, 0.0
    for n in range(count):
        if weights[n] > 0.05:
            kept[n], known[n] = residuals[n], 1.0
    for n in range(count):
        good += known[n]
        power += kept[n] * kept[n]
    if good == 0.0 or power <= 0.0:
        return 1.0
    power /= good
    total = 1.0
    for lag in range(1, max(2, min(MAX_LAG, count // 8))):
        pairs, product = 0.0, 0.0
        behind, known_behind = kept[lag:], known[lag:]
        for n in range(count - lag):
            pairs += known[n] * known_behind[n]
            product += kept[n] * behind[n]
        behind, known_behind = kept[count - lag :], known[count - lag :]
        for n in range(lag):  # around the end
            pairs += known[n] * known_behind[n]
            product += kept[n] * behind[n]
        if pairs < 8:
            break
        correlation = product / pairs / power
        if correlation <= 2.0 / np.sqrt(pairs):
            break
        total += 2.0 * correlation
    return total


@kernel("void(f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8[::1])", any_order=True)
def weighted_moments(terms: F64, values: F64, weights: F64, moments: F64, right_side: F64) -> None:
    """Fill the weighted products of terms (T, N) with themselves and with the values."""
    size, count = terms.shape
    weighted = np.empty(_AT_ONCE)
    moments[:], right_side[:] = 0.0, 0.0
    for first in range(0, count, _AT_ONCE):
        part = min(_AT_ONCE, count - first)
        wanted, weight = values[first : first + part], weights[first : first + part]
        for i in range(size):
            term, total = terms[i, first : first + part], 0.0
            for n in range(part):
                weighted[n] = weight[n] * term[n]
            for n in range(part):
                total += weighted[n] * wanted[n]
            right_side[i] += total
            for j in range(i + 1):
                other, total = terms[j, first : first + part], 0.0
                for n in range(part):
                    total += weighted[n] * other[n]
                moments[i, j] += total
    for i in range(size):
        for j in range(i):
            moments[j, i] = moments[i, j]
