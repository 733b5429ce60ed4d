"""Kernels of affine least-squares matching along a row (A. Gruen, 1985).

The model is gain * right(x - disparity(x, y), y) + offset = left(x, y) over a window, where the disparity is
a plane: shift + slope_x u + slope_y v, with (u, v) from the window's middle. Both sides are smoothed
*after* the right image was resampled onto the left one's pixels, so that a slanted face is smoothed alike in
both, and the residuals are noise. Resampling is by cubic splines (M. Unser, 1999): shorter cubics bias the
result towards half pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import F64, Image
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import kernel
from edged.vision.stereo.params import PAIRING

RADIUS = 3  # taps on either side of the smoothing kernel: 4 sigma
_OFFSETS = np.arange(-RADIUS, RADIUS + 1)  # px
TAPS = (
    np.exp(-0.5 * (_OFFSETS / PAIRING.smoothing_px) ** 2)
    / np.exp(-0.5 * (_OFFSETS / PAIRING.smoothing_px) ** 2).sum()
)
"""Gaussian smoothing kernel with sum 1."""
NOISE_GAIN = float(np.sum(TAPS**2) ** 2)
"""Variance of smoothed white noise of variance 1."""
TAP2_COVARIANCE = float(np.sum(TAPS**2) * np.sum(TAPS[2:] * TAPS[:-2]))
"""Covariance of smoothed white noise two pixels apart in x."""
_FREQUENCY = np.linspace(0.0, math.pi, 20_001)  # rad per px, all frequencies for a mean
_RESPONSE = np.cos(np.outer(_FREQUENCY, _OFFSETS)) @ TAPS
SLOPE_NOISE_GAIN = float(np.sum(TAPS**2) * np.mean((_FREQUENCY * _RESPONSE) ** 2))
"""Variance of the derivative by x of smoothed white noise of variance 1."""

# numba freezes globals when it compiles: kernels read these by name
SLOPE_SIGMA = PAIRING.slope_sigma
MAX_ITERATIONS = PAIRING.max_iterations
MAX_STEP_PX = PAIRING.max_step_px
MAX_SLOPE = PAIRING.max_slope
TINY_PIVOT = 1e-12  # relative to its diagonal element: below, an unknown is undetermined
CONVERGED_PX = PAIRING.converged_px
POLE = math.sqrt(3.0) - 2.0  # of the cubic spline's recursive filter

SHIFT, SLOPE_X, SLOPE_Y, GAIN, OFFSET = range(5)  # unknowns of a fit
LEFT_PATCH, DIVERGED = -1.0, -2.0  # results of a fit, instead of its variance


class Patches(NamedTuple):
    """Data and working memory of a fit. n is the window's size, r the smoothing's radius.

    left (n, n) smoothed; spline (n + 2r, m) coefficients of the right image's rows.
    """

    left: F64
    spline: F64
    value: F64
    slope: F64
    rows: F64
    smooth_value: F64
    smooth_slope: F64
    influence: F64
    influence_rows: F64
    normal: F64
    gradient: F64


@kernel()
def make_patches(half: int) -> Patches:
    """Memory for windows of (2 half + 1)² pixels."""
    size, wide = 2 * half + 1, 2 * (half + RADIUS) + 1
    # space for slopes up to MAX_SLOPE in both directions, for the steps of the fit and for the spline
    columns = 2 * math.ceil((1.0 + 2.0 * MAX_SLOPE) * (half + RADIUS) + MAX_STEP_PX + 3.0) + 1
    return Patches(
        np.empty((size, size)),
        np.empty((wide, columns)),
        np.empty((wide, wide)),
        np.empty((wide, wide)),
        np.empty((size, wide)),
        np.empty((size, size)),
        np.empty((size, size)),
        np.empty((wide + 2 * RADIUS, wide + 2 * RADIUS)),
        np.empty((wide, wide + 2 * RADIUS)),
        np.empty((5, 5)),
        np.empty(5),
    )


@kernel("void(u1[:, ::1], i8, i8, f8[:, ::1])")
def cut_out(image: Image, x: int, y: int, patch: F64) -> None:
    """Fill patch with the image around (x, y); beyond the border its last pixels are repeated."""
    rows, columns = patch.shape
    height, width = image.shape
    for j in range(rows):
        row = min(max(y - rows // 2 + j, 0), height - 1)
        for i in range(columns):
            patch[j, i] = image[row, min(max(x - columns // 2 + i, 0), width - 1)]


@kernel("void(f8[:, ::1], f8[:, ::1], f8[:, ::1])")
def smooth(patch: F64, rows: F64, result: F64) -> None:
    """Gaussian smoothing (n + 2r, n + 2r) -> (n, n). rows (n, n + 2r) is scratch."""
    size, wide = result.shape[0], patch.shape[1]
    for j in range(size):
        for i in range(wide):
            value = TAPS[0] * (patch[j, i] + patch[j + 6, i]) + TAPS[1] * (patch[j + 1, i] + patch[j + 5, i])
            value += TAPS[2] * (patch[j + 2, i] + patch[j + 4, i]) + TAPS[3] * patch[j + 3, i]
            rows[j, i] = value
        for i in range(size):
            value = TAPS[0] * (rows[j, i] + rows[j, i + 6]) + TAPS[1] * (rows[j, i + 1] + rows[j, i + 5])
            value += TAPS[2] * (rows[j, i + 2] + rows[j, i + 4]) + TAPS[3] * rows[j, i + 3]
            result[j, i] = value


@kernel("void(f8[:, ::1])")
def spline_rows(patch: F64) -> None:
    """Turn rows of samples into coefficients of the cubic spline through them, in place.

    The ends are continued as constants; the error of that is gone after a few pixels (POLE^5 = 1e-3).
    """
    rows, columns = patch.shape
    # rows in the inner loop: their recursions do not wait for each other
    for j in range(rows):
        patch[j, 0] /= 1.0 - POLE
    for i in range(1, columns):
        for j in range(rows):
            patch[j, i] += POLE * patch[j, i - 1]
    for j in range(rows):
        patch[j, columns - 1] *= -POLE / (1.0 - POLE)
    for i in range(columns - 2, -1, -1):
        for j in range(rows):
            patch[j, i] = POLE * (patch[j, i + 1] - patch[j, i])
    for j in range(rows):
        for i in range(columns):
            patch[j, i] *= 6.0


@kernel("b1(f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1])")
def resample(spline: F64, unknowns: F64, value: F64, slope: F64) -> bool:
    """Fill value, slope: the right image and its derivative by x at the matches of the left window's pixels.

    False where a match leaves the patch.
    """
    size = value.shape[0]
    half, centre, last = size // 2, spline.shape[1] // 2, spline.shape[1] - 3
    step = 1.0 - unknowns[SLOPE_X]
    for j in range(size):
        start = centre - unknowns[SHIFT] - unknowns[SLOPE_Y] * (j - half) - step * half
        end = start + step * (size - 1)
        if not (min(start, end) >= 1.0 and max(start, end) < last):
            return False
        for i in range(size):
            position = start + step * i
            k = int(position)
            t = position - k
            a, b, c, d = spline[j, k - 1], spline[j, k], spline[j, k + 1], spline[j, k + 2]
            # the four pieces of the cubic B-spline, by Horner's rule
            p0, p1, p2, p3 = (a + 4.0 * b + c) / 6.0, 0.5 * (c - a), 0.5 * (a + c) - b, (d - a) / 6.0
            p3 += 0.5 * (b - c)
            value[j, i] = p0 + t * (p1 + t * (p2 + t * p3))
            slope[j, i] = p1 + t * (2.0 * p2 + 3.0 * t * p3)
    return True


@kernel("f8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])")
def normal_equations(left: F64, value: F64, slope: F64, unknowns: F64, normal: F64, gradient: F64) -> float:
    """Sum up JᵀJ (lower triangle) and -Jᵀr at `unknowns`; returns the sum of squared residuals."""
    size = left.shape[0]
    half, gain, offset = size // 2, unknowns[GAIN], unknowns[OFFSET]
    normal[:] = 0.0
    gradient[:] = 0.0
    squares = 0.0
    for j in range(size):
        v = float(j - half)
        gg, ggu, gguu, gr, gru, grv, rr = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        gv, gvu, g1, g1u, vv, v1, er, ev = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(size):
            u, f, g = float(i - half), value[j, i], -gain * slope[j, i]
            r = gain * f + offset - left[j, i]
            gu = g * u
            gg += g * g
            ggu += g * gu
            gguu += gu * gu
            gv += g * f
            gvu += gu * f
            g1 += g
            g1u += gu
            vv += f * f
            v1 += f
            gr += g * r
            gru += gu * r
            ev += f * r
            er += r
            rr += r * r
        grv = gr * v
        normal[0, 0] += gg
        normal[1, 0] += ggu
        normal[1, 1] += gguu
        normal[2, 0] += gg * v
        normal[2, 1] += ggu * v
        normal[2, 2] += gg * v * v
        normal[3, 0] += gv
        normal[3, 1] += gvu
        normal[3, 2] += gv * v
        normal[3, 3] += vv
        normal[4, 0] += g1
        normal[4, 1] += g1u
        normal[4, 2] += g1 * v
        normal[4, 3] += v1
        gradient[0] -= gr
        gradient[1] -= gru
        gradient[2] -= grv
        gradient[3] -= ev
        gradient[4] -= er
        squares += rr
    normal[4, 4] = float(size * size)
    return squares


@kernel()
def fit(unknowns: F64, p: Patches) -> float:
    """Gauss-Newton from `unknowns`, in place; p.normal is left factorised at the solution.

    Returns the variance of the difference of two pixels from the residuals, not yet corrected for the
    unknowns; LEFT_PATCH if the window leaves the patch, DIVERGED if there is no solution.
    """
    for iteration in range(MAX_ITERATIONS):
        if not resample(p.spline, unknowns, p.value, p.slope):
            return LEFT_PATCH
        smooth(p.value, p.rows, p.smooth_value)
        smooth(p.slope, p.rows, p.smooth_slope)
        if iteration == 0:
            unknowns[OFFSET] = p.left.mean() - unknowns[GAIN] * p.smooth_value.mean()
        squares = normal_equations(p.left, p.smooth_value, p.smooth_slope, unknowns, p.normal, p.gradient)
        variance = squares / (p.left.size * NOISE_GAIN)
        for a in (SLOPE_X, SLOPE_Y):
            p.normal[a, a] += variance / SLOPE_SIGMA**2
            p.gradient[a] -= variance / SLOPE_SIGMA**2 * unknowns[a]
        if factorise(p.normal, len(unknowns)) < TINY_PIVOT:
            return DIVERGED
        substitute(p.normal, p.gradient, len(unknowns))
        unknowns += p.gradient
        steepest = max(abs(unknowns[SLOPE_X]), abs(unknowns[SLOPE_Y]))
        if not (abs(unknowns[SHIFT]) <= MAX_STEP_PX and steepest <= MAX_SLOPE):
            return DIVERGED
        turn_px = max(abs(p.gradient[SLOPE_X]), abs(p.gradient[SLOPE_Y])) * 0.5 * p.left.shape[0]
        if max(abs(p.gradient[SHIFT]), turn_px) < CONVERGED_PX:
            return variance
    return DIVERGED


@kernel()
def _true_normal(unknowns: F64, variance: float, p: Patches) -> float:
    """Subtract the noise in the gradients from the factorised p.normal, and factorise it again.

    At the minimum the second derivatives, which Gauss-Newton neglects, subtract as much as noise has added.
    Returns the energy per pixel that was subtracted, -1 if nothing is left.
    """
    half, area = p.left.shape[0] // 2, float(p.left.size)
    normal = np.zeros((5, 5))
    for i in range(5):
        for j in range(i + 1):
            for k in range(j + 1):
                normal[i, j] += p.normal[i, k] * p.normal[j, k]
    gain2 = unknowns[GAIN] * unknowns[GAIN]
    energy = gain2 / (1.0 + gain2) * variance * SLOPE_NOISE_GAIN
    moment = half * (half + 1.0) / 3.0  # mean of u² from -half to half
    normal[SHIFT, SHIFT] -= area * energy
    normal[SLOPE_X, SLOPE_X] -= area * moment * energy
    normal[SLOPE_Y, SLOPE_Y] -= area * moment * energy
    p.normal[:] = normal
    return energy if factorise(p.normal, len(unknowns)) > TINY_PIVOT else -1.0


@kernel()
def variance_of(weights: F64, unknowns: F64, variance: float, row_sigma_px: float, p: Patches) -> float:
    """Variance of weights · unknowns after `fit` returned `variance`; inf if all texture is noise.

    weights is overwritten.

    White noise e of both images reaches the fit as S e, S being the smoothing; the estimate moves by
    aᵀ S e with a the influence of each residual. So its variance is that of e times |Sᵀ a|².
    row_sigma_px : sigma of the row difference between both images; it moves the estimate where the texture
    is not perpendicular to the row.
    """
    size, area = p.left.shape[0], float(p.left.size)
    half = size // 2
    energy = _true_normal(unknowns, variance, p)
    if energy < 0.0:
        return np.inf
    substitute(p.normal, weights, len(weights))
    # a, padded with zeros so that Sᵀ a is complete: S spreads it beyond the window's rim
    p.influence[:] = 0.0
    plain, per_row = 0.0, 0.0
    for j in range(size):
        above, below = max(j - 1, 0), min(j + 1, size - 1)
        for i in range(size):
            g = -unknowns[GAIN] * p.smooth_slope[j, i]
            influence = g * (weights[SHIFT] + weights[SLOPE_X] * (i - half) + weights[SLOPE_Y] * (j - half))
            influence += weights[GAIN] * p.smooth_value[j, i] + weights[OFFSET]
            p.influence[j + 2 * RADIUS, i + 2 * RADIUS] = influence
            plain += influence * influence
            vertical = (p.smooth_value[below, i] - p.smooth_value[above, i]) / (below - above)
            per_row += influence * unknowns[GAIN] * vertical
    smooth(p.influence, p.influence_rows, p.value)
    spread = 0.0
    for j in range(p.value.shape[0]):
        for i in range(p.value.shape[1]):
            spread += p.value[j, i] * p.value[j, i]
    # noise in the gradients, from the right image, combines only with the left image's half of the noise
    moment = half * (half + 1.0) / 3.0
    noisy = area * energy * (weights[SHIFT] ** 2 + moment * (weights[SLOPE_X] ** 2 + weights[SLOPE_Y] ** 2))
    spread *= 1.0 - 0.5 * min(noisy / max(plain, 1e-300), 1.0)
    # degrees of freedom absorbed by the fit: 1 by the mean; by the other unknowns in proportion to the
    # share of the smoothed noise in a smoothed field like theirs
    degrees = area * NOISE_GAIN
    corrected = variance * degrees / max(degrees - 1.0 - 4.0 * spread / max(plain, 1e-300), 1.0)
    # the prior restrains the slopes: its contribution to the estimate has the prior's own variance
    pull = variance / SLOPE_SIGMA * math.hypot(weights[SLOPE_X], weights[SLOPE_Y])
    return float(corrected * spread + pull * pull + (per_row * row_sigma_px) ** 2)
