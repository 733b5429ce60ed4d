"""Kernels that measure marks by fitting a model of a corner or of a dot to the image.

The corner model is described in `boards.chessboard`, the dot model in `boards.circlegrid`. Both are fitted by
the same routine; `kind` selects the model.

Source of the method: Levenberg-Marquardt, K. Madsen, H. B. Nielsen, O. Tingleff, "Methods for
non-linear least squares problems", 2004.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.params import DETECTION
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import kernel

CORNER, DOT = 0, 1  # values of `kind`
_MOST_UNKNOWNS = 10  # size of the kernel's arrays
_STEPS = 40  # limit of Levenberg-Marquardt steps; a dozen usually suffice
# numba freezes globals when it compiles: kernels read these by name
_RECENTRED = DETECTION.recentred
_CENTRED_PX = DETECTION.centred_px
_MIN_SHARE_INSIDE = DETECTION.min_share_inside
_PIXEL_BLUR_PX = math.sqrt(1.0 / 12.0)  # blur by the width of a pixel: no lens makes an edge sharper
_TWO_OVER_ROOT_PI = 2.0 / math.sqrt(math.pi)  # slope of the error function at 0


@kernel(inline=True)
def unknowns_of(kind: int) -> int:
    """Number of unknowns of a model."""
    return 9 if kind == CORNER else 10


@kernel()
def corner_value(
    p: FloatArray, window: FloatArray, shape: FloatArray, dx: float, dy: float, row: FloatArray
) -> float:
    """Grey value of a corner at (dx, dy) from its centre; writes its derivatives to row (9,).

    p (9,) : x, y, directions of both edges, log blur, grey, half contrast, relative
    light gradient along x and y in 1/px.
    """
    scale, sin1, cos1, sin2, cos2 = shape[0], shape[1], shape[2], shape[3], shape[4]
    along1, along2 = cos1 * dx + sin1 * dy, cos2 * dx + sin2 * dy
    beside1, beside2 = cos1 * dy - sin1 * dx, cos2 * dy - sin2 * dx
    bend1, bend2 = window[3] * along1, window[4] * along2
    u = (beside1 - 0.5 * bend1 * along1) * scale
    v = (beside2 - 0.5 * bend2 * along2) * scale
    edge1, edge2 = math.erf(u), math.erf(v)
    slope1 = _TWO_OVER_ROOT_PI * math.exp(-u * u) * edge2 * p[6]
    slope2 = _TWO_OVER_ROOT_PI * math.exp(-v * v) * edge1 * p[6]
    surface = p[5] + p[6] * edge1 * edge2
    light = 1.0 + p[7] * dx + p[8] * dy
    row[0] = (
        light * scale * (slope1 * (sin1 + bend1 * cos1) + slope2 * (sin2 + bend2 * cos2)) - surface * p[7]
    )
    row[1] = (
        light * scale * (slope1 * (bend1 * sin1 - cos1) + slope2 * (bend2 * sin2 - cos2)) - surface * p[8]
    )
    row[2] = -light * scale * slope1 * (along1 + bend1 * beside1)
    row[3] = -light * scale * slope2 * (along2 + bend2 * beside2)
    row[4] = -light * (slope1 * u + slope2 * v)
    row[5] = light
    row[6] = light * edge1 * edge2
    row[7] = surface * dx
    row[8] = surface * dy
    return float(surface * light)


@kernel()
def dot_value(p: FloatArray, shape: FloatArray, dx: float, dy: float, row: FloatArray) -> float:
    """Grey value of a dot at (dx, dy) from its centre; writes its derivatives to row (10,).

    p (10,) : x, y, b11, b12, b22 (symmetric matrix that maps the ellipse to a unit circle), log of the
    blur in radii, grey, half contrast, relative light gradient along x and y in 1/px.
    """
    q1, q2 = p[2] * dx + p[3] * dy, p[3] * dx + p[4] * dy
    radius = math.sqrt(q1 * q1 + q2 * q2)
    scale = shape[0]
    u = (radius - 1.0) * scale
    edge = math.erf(u)
    slope = _TWO_OVER_ROOT_PI * math.exp(-u * u) * p[7]
    surface = p[6] + p[7] * edge
    light = 1.0 + p[8] * dx + p[9] * dy
    by_radius = light * slope * scale / max(radius, 1e-6)
    row[0] = -by_radius * (p[2] * q1 + p[3] * q2) - surface * p[8]
    row[1] = -by_radius * (p[3] * q1 + p[4] * q2) - surface * p[9]
    row[2] = by_radius * q1 * dx
    row[3] = by_radius * (q1 * dy + q2 * dx)
    row[4] = by_radius * q2 * dy
    row[5] = -light * slope * u
    row[6] = light
    row[7] = light * edge
    row[8] = surface * dx
    row[9] = surface * dy
    return float(surface * light)


@kernel()
def shape_of(kind: int, p: FloatArray, shape: FloatArray) -> None:
    """Fill shape with values common to all pixels of a mark: 1 / (√2 blur); a corner's sines and cosines."""
    shape[0] = 1.0 / (math.sqrt(2.0) * math.exp(p[4] if kind == CORNER else p[5]))
    shape[1], shape[2], shape[3], shape[4] = math.sin(p[2]), math.cos(p[2]), math.sin(p[3]), math.cos(p[3])


@kernel()
def accumulate(
    kind: int,
    image: Image,
    p: FloatArray,
    window: FloatArray,
    normal: FloatArray,
    gradient: FloatArray,
    by_residual: bool,
) -> tuple[float, int]:
    """Sum of squared residuals and pixel count of mark p over a disc; computes JᵀJ and Jᵀr.

    window (5,) : x, y, radius, and for corners the curvatures of both edges in 1/px.
    by_residual : weight JᵀJ by each pixel's squared residual, for the covariance.
    """
    height, width = image.shape
    n = unknowns_of(kind)
    normal[:] = 0.0
    gradient[:] = 0.0
    row, shape = np.empty(_MOST_UNKNOWNS), np.empty(5)
    shape_of(kind, p, shape)
    radius2 = window[2] * window[2]
    total, count = 0.0, 0
    for y in range(
        max(0, math.ceil(window[1] - window[2])), min(height - 1, math.floor(window[1] + window[2])) + 1
    ):
        for x in range(
            max(0, math.ceil(window[0] - window[2])), min(width - 1, math.floor(window[0] + window[2])) + 1
        ):
            if (x - window[0]) ** 2 + (y - window[1]) ** 2 > radius2:
                continue
            if kind == CORNER:
                value = corner_value(p, window, shape, x - p[0], y - p[1], row)
            else:
                value = dot_value(p, shape, x - p[0], y - p[1], row)
            residual = image[y, x] - value
            total += residual * residual
            count += 1
            weight = residual * residual if by_residual else 1.0
            for i in range(n):
                gradient[i] += row[i] * residual
                for j in range(i + 1):
                    normal[i, j] += weight * row[i] * row[j]
    return total, count


@kernel()
def start_corner(image: Image, p: FloatArray, window: FloatArray) -> None:
    """Set p's grey and half contrast by a linear fit of the unblurred corner at p's position and angles."""
    height, width = image.shape
    count, sum_sign, sum_grey, sum_both = 0, 0.0, 0.0, 0.0
    for y in range(
        max(0, math.ceil(window[1] - window[2])), min(height - 1, math.floor(window[1] + window[2])) + 1
    ):
        for x in range(
            max(0, math.ceil(window[0] - window[2])), min(width - 1, math.floor(window[0] + window[2])) + 1
        ):
            dx, dy = x - p[0], y - p[1]
            if dx * dx + dy * dy > window[2] * window[2]:
                continue
            side1 = math.cos(p[2]) * dy - math.sin(p[2]) * dx
            side2 = math.cos(p[3]) * dy - math.sin(p[3]) * dx
            sign = 1.0 if side1 * side2 > 0 else -1.0
            count += 1
            sum_sign += sign
            sum_grey += image[y, x]
            sum_both += sign * image[y, x]
    spread = count - sum_sign * sum_sign / count if count else 0.0
    p[6] = (sum_both - sum_sign * sum_grey / count) / spread if spread > 0.0 else 0.0
    p[5] = (sum_grey - p[6] * sum_sign) / count if count else 0.0


@kernel()
def fit_window(
    kind: int, image: Image, p: FloatArray, window: FloatArray, smoothed_px: float, covariance: FloatArray
) -> float:
    """Levenberg-Marquardt fit over one window; updates p in place.

    smoothed_px : sigma by which the image was smoothed, which correlates neighbouring pixels; 0 for dots.
    covariance (2, 2) of the centre.  Returns the noise sigma in grey values, or NaN on failure.
    """
    n = unknowns_of(kind)
    blur = 4 if kind == CORNER else 5  # index of log blur in p
    normal, trial_normal, damped = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    gradient, trial_gradient, step, trial = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    total, count = accumulate(kind, image, p, window, normal, gradient, False)
    if count <= n:
        return math.nan
    damping = 1e-3
    for _ in range(_STEPS):
        damped[:] = normal
        for i in range(n):
            damped[i, i] *= 1.0 + damping
        step[:] = gradient
        if factorise(damped, n) == 0.0:
            return math.nan
        substitute(damped, step, n)
        # far below the noise; tested before the trial, whose sum may differ by rounding only
        if math.fabs(step[0]) < 1e-5 and math.fabs(step[1]) < 1e-5 and math.fabs(step[blur]) < 1e-4:
            break
        trial[:] = p + step
        if math.fabs(trial[blur]) < 5.0:
            trial_total, _ = accumulate(kind, image, trial, window, trial_normal, trial_gradient, False)
        else:
            trial_total = math.inf
        if trial_total <= total:
            p[:] = trial
            normal[:] = trial_normal
            gradient[:] = trial_gradient
            total = trial_total
            damping = max(damping * 0.1, 1e-9)
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    if smoothed_px > 0.0:
        known = smoothed_covariance(image, p, window, smoothed_px, normal, covariance)
    else:
        known = centre_covariance(kind, image, p, window, normal, covariance)
    if not known:
        return math.nan
    return math.sqrt(total / (count - n))


@kernel()
def centre_covariance(
    kind: int, image: Image, p: FloatArray, window: FloatArray, normal: FloatArray, covariance: FloatArray
) -> bool:
    """Covariance (2, 2) of the centre that is also valid if the noise is concentrated at the edges.

    Rough prints, shadows and undersampled edges cause residuals just where the position is determined,
    while most pixels of the window are flat and quiet: the mean square residual would be too optimistic.
    N^-1 (sum of r² g gᵀ) N^-1 is not. Source: H. White, 1980, doi:10.2307/1912934.
    """
    n = unknowns_of(kind)
    meat, factor = np.empty((n, n)), normal.copy()
    scratch = np.empty(n)
    inverse = np.zeros((2, n))
    _, count = accumulate(kind, image, p, window, meat, scratch, True)
    if factorise(factor, n) == 0.0:
        return False
    for axis in range(2):
        inverse[axis, axis] = 1.0
        substitute(factor, inverse[axis], n)
    covariance[:] = 0.0
    for a in range(2):
        for b in range(2):
            for i in range(n):
                for j in range(n):
                    covariance[a, b] += inverse[a, i] * meat[max(i, j), min(i, j)] * inverse[b, j]
            covariance[a, b] *= count / (count - n)
    return True


@kernel()
def smoothed_covariance(
    image: Image,
    p: FloatArray,
    window: FloatArray,
    smoothed_px: float,
    normal: FloatArray,
    covariance: FloatArray,
) -> bool:
    """Covariance (2, 2) of a corner's centre in an image smoothed by a Gaussian of sigma s.

    Pixel noise then has the correlation R = exp(-d² / 4 s²), and the covariance is N^-1 JᵀRJ N^-1 times the
    variance. The variance is estimated from the residuals, weighted by their influence on the centre: for
    pure noise, with H = J N^-1 Jᵀ, their squares are expected to be the diagonal of (1 - H) R (1 - H)ᵀ.
    """
    side = 2 * math.ceil(window[2]) + 1
    rows, residual = np.zeros((9, side, side)), np.zeros((side, side))
    row, shape, factor = np.empty(_MOST_UNKNOWNS), np.empty(5), normal.copy()
    shape_of(CORNER, p, shape)
    left, top = math.ceil(window[0] - window[2]), math.ceil(window[1] - window[2])
    for y in range(max(0, top), min(image.shape[0], top + side)):
        for x in range(max(0, left), min(image.shape[1], left + side)):
            if (x - window[0]) ** 2 + (y - window[1]) ** 2 <= window[2] * window[2]:
                value = corner_value(p, window, shape, x - p[0], y - p[1], row)
                residual[y - top, x - left] = image[y, x] - value
                rows[:, y - top, x - left] = row[:9]
    if factorise(factor, 9) == 0.0:
        return False
    inverse = np.eye(9)
    for i in range(9):
        substitute(factor, inverse[i], 9)
    alike = correlated(rows, smoothed_px)
    middle, beside = np.zeros((9, 9)), np.empty(9)
    for y in range(side):
        for x in range(side):
            if rows[5, y, x] != 0.0:  # derivative by grey, which is zero only outside the window
                for j in range(9):
                    beside[j] = alike[j, y, x]
                for i in range(9):
                    for j in range(9):
                        middle[i, j] += rows[i, y, x] * beside[j]
    outer = product(product(inverse, middle), inverse)
    seen, expected = np.zeros(2), np.zeros(2)
    for y in range(side):
        for x in range(side):
            if rows[5, y, x] == 0.0:
                continue
            for j in range(9):
                row[j], beside[j] = rows[j, y, x], 2.0 * alike[j, y, x]
            left_over = 1.0
            for i in range(9):
                inner = 0.0
                for j in range(9):
                    inner += outer[i, j] * row[j] - inverse[i, j] * beside[j]
                left_over += row[i] * inner
            for axis in range(2):
                pull = 0.0
                for i in range(9):
                    pull += inverse[axis, i] * row[i]
                seen[axis] += pull * pull * residual[y, x] ** 2
                expected[axis] += pull * pull * left_over
    for a in range(2):
        if not expected[a] > 0.0:
            return False
    for a in range(2):
        for b in range(2):
            covariance[a, b] = outer[a, b] * math.sqrt(seen[a] / expected[a] * seen[b] / expected[b])
    return True


@kernel()
def correlated(rows: FloatArray, smoothed_px: float) -> FloatArray:
    """Convolve each of the rows (9, S, S) with the correlation exp(-d² / 4 s²) of smoothed noise."""
    count, side, _ = rows.shape
    reach = math.ceil(5.0 * smoothed_px)  # exp(-25 / 4) = 0.002
    once, twice = np.zeros(rows.shape), np.zeros(rows.shape)
    for far in range(-reach, reach + 1):
        share = math.exp(-far * far / (4.0 * smoothed_px * smoothed_px))
        for i in range(count):
            for y in range(side):
                for x in range(max(0, -far), min(side, side - far)):
                    once[i, y, x] += share * rows[i, y, x + far]
    for far in range(-reach, reach + 1):
        share = math.exp(-far * far / (4.0 * smoothed_px * smoothed_px))
        for i in range(count):
            for y in range(max(0, -far), min(side, side - far)):
                for x in range(side):
                    twice[i, y, x] += share * once[i, y + far, x]
    return twice


@kernel()
def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Matrix product a b of two (9, 9) matrices."""
    result = np.zeros((9, 9))
    for i in range(9):
        for j in range(9):
            for k in range(9):
                result[i, j] += a[i, k] * b[k, j]
    return result


@kernel("void(u1[:, ::1], f8[:, ::1], f8, f8[:, ::1])")
def fit_corners(image: Image, start: FloatArray, smoothed_px: float, result: FloatArray) -> None:
    """Fit the corner model from each initial value.

    smoothed_px : sigma of the Gaussian by which the image was smoothed; 0 for the original image.

    start (N, 7) : x, y, directions of both edges in rad, radius of the window in px, and
    curvatures of both edges in 1/px, positive if they bend towards their normal.
    result (N, 6) : x, y, sigma_px, blur_px, contrast, ok (1 or 0).
    """
    height, width = image.shape
    p, window, covariance = np.empty(9), np.empty(5), np.empty((2, 2))
    for n in range(start.shape[0]):
        result[n, :] = math.nan
        result[n, 4], result[n, 5] = 0.0, 0.0
        p[0], p[1], p[2], p[3] = start[n, 0], start[n, 1], start[n, 2], start[n, 3]
        p[4], p[7], p[8] = 0.0, 0.0, 0.0
        noise = math.nan
        for _ in range(_RECENTRED):
            window[0], window[1], window[2] = p[0], p[1], start[n, 4]
            window[3], window[4] = start[n, 5], start[n, 6]
            if not (0.0 <= p[0] <= width - 1 and 0.0 <= p[1] <= height - 1):
                noise = math.nan
                break
            start_corner(image, p, window)
            p[4] = max(p[4], -0.7)
            noise = fit_window(CORNER, image, p, window, smoothed_px, covariance)
            if math.isnan(noise) or math.hypot(p[0] - window[0], p[1] - window[1]) < _CENTRED_PX:
                break
        if math.isnan(noise):
            continue
        moved = math.hypot(p[0] - start[n, 0], p[1] - start[n, 1])
        blur, contrast = math.exp(p[4]), 2.0 * math.fabs(p[6])
        across = math.fabs(math.sin(p[2] - p[3]))
        inside_x = min(p[0], start[n, 4]) + min(width - 1 - p[0], start[n, 4])
        inside_y = min(p[1], start[n, 4]) + min(height - 1 - p[1], start[n, 4])
        inside = inside_x * inside_y / (4.0 * start[n, 4] * start[n, 4])
        result[n, 0], result[n, 1] = p[0], p[1]
        result[n, 2] = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]))
        result[n, 3], result[n, 4] = blur, contrast
        if smoothed_px > 0.0:
            result[n, 3] = max(_PIXEL_BLUR_PX, math.sqrt(max(0.0, blur * blur - smoothed_px * smoothed_px)))
        good = moved < max(2.5, 0.5 * start[n, 4]) and blur < 0.5 * start[n, 4] and across > 0.2
        if good and inside > _MIN_SHARE_INSIDE and noise < 0.25 * contrast:
            result[n, 5] = 1.0


@kernel("void(u1[:, ::1], f8[:, ::1], f8[:, ::1])")
def fit_dots(image: Image, start: FloatArray, result: FloatArray) -> None:
    """Fit the dot model from each initial value.

    start (N, 6) : x, y, b11, b12, b22 (as in `dot_value`), and radius of the window in px.
    result (N, 9) : x, y, sigma_px, blur_px, contrast, ok (1 or 0), b11, b12, b22.
    """
    height, width = image.shape
    p, window, covariance = np.empty(10), np.zeros(5), np.empty((2, 2))
    for n in range(start.shape[0]):
        result[n, :] = math.nan
        result[n, 4], result[n, 5] = 0.0, 0.0
        reach = start[n, 5]
        x, y = start[n, 0], start[n, 1]
        if not (reach <= x <= width - 1 - reach and reach <= y <= height - 1 - reach):
            continue
        p[:5] = start[n, :5]
        window[0], window[1], window[2] = x, y, reach
        radius = 1.0 / math.sqrt(max(p[2] * p[4] - p[3] * p[3], 1e-12))  # geometric mean of the semi-axes
        p[5], p[8], p[9] = math.log(0.7 / radius), 0.0, 0.0
        inside = float(image[round(y), round(x)])
        rim = 0.0
        for k in range(16):
            angle = k * math.pi / 8.0
            rim += image[round(y + reach * math.sin(angle)), round(x + reach * math.cos(angle))] / 16.0
        p[6], p[7] = 0.5 * (inside + rim), 0.5 * (rim - inside)
        noise = fit_window(DOT, image, p, window, 0.0, covariance)
        determinant = p[2] * p[4] - p[3] * p[3]
        if math.isnan(noise) or not determinant > 0.0:
            continue
        moved, fitted = math.hypot(p[0] - x, p[1] - y), 1.0 / math.sqrt(determinant)
        contrast = 2.0 * math.fabs(p[7])
        result[n, 0], result[n, 1] = p[0], p[1]
        result[n, 2] = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]))
        result[n, 3], result[n, 4] = math.exp(p[5]) * fitted, contrast
        result[n, 6], result[n, 7], result[n, 8] = p[2], p[3], p[4]
        if moved < 0.3 * radius and 0.6 < fitted / radius < 1.6 and noise < 0.25 * contrast:
            result[n, 5] = 1.0
