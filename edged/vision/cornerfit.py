"""The kernel that measures chessboard corners (model: see `edged.vision.chessboard`).

Source of the method: Levenberg-Marquardt, K. Madsen, H. B. Nielsen, O. Tingleff, "Methods for
non-linear least squares problems", 2004.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain import FloatArray, Image
from edged.vision.jit import kernel

_UNKNOWNS = 9  # cx, cy, angle 1, angle 2, log blur, grey, half contrast, slope x, slope y
_STEPS = 40
_RECENTRED = 2  # the window is laid round the corner found, so that what is symmetric cancels
_MIN_SHARE_INSIDE = 0.7  # of the window's pixels; less lets one edge go unseen
_TWO_OVER_ROOT_PI = 2.0 / math.sqrt(math.pi)


@kernel()
def solve_spd(matrix: FloatArray, right: FloatArray, n: int) -> bool:
    """Solve matrix @ x = right in place by Cholesky; False if not positive definite.

    matrix (n, n) is overwritten by its factor, right (n,) by x. (numba's linalg needs SciPy.)
    """
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(n):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return True


@kernel()
def accumulate_corner(
    image: Image,
    p: FloatArray,
    window: FloatArray,
    normal: FloatArray,
    gradient: FloatArray,
    by_residual: bool,
) -> tuple[float, int]:
    """Sum of squared residuals and pixel count of corner p over a disc; fills JᵀJ and Jᵀr.

    window (5,) : x, y, radius, curvatures of both edges in 1/px.
    by_residual : weigh JᵀJ by each pixel's squared residual, for the covariance.
    """
    height, width = image.shape
    normal[:] = 0.0
    gradient[:] = 0.0
    row = np.empty(9)
    blur = math.exp(p[4])
    scale = 1.0 / (math.sqrt(2.0) * blur)
    sin1, cos1, sin2, cos2 = math.sin(p[2]), math.cos(p[2]), math.sin(p[3]), math.cos(p[3])
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
            dx, dy = x - p[0], y - p[1]
            along1, along2 = cos1 * dx + sin1 * dy, cos2 * dx + sin2 * dy
            beside1, beside2 = cos1 * dy - sin1 * dx, cos2 * dy - sin2 * dx
            bend1, bend2 = window[3] * along1, window[4] * along2
            u = (beside1 - 0.5 * bend1 * along1) * scale
            v = (beside2 - 0.5 * bend2 * along2) * scale
            edge1, edge2 = math.erf(u), math.erf(v)
            slope1 = _TWO_OVER_ROOT_PI * math.exp(-u * u) * edge2 * p[6]
            slope2 = _TWO_OVER_ROOT_PI * math.exp(-v * v) * edge1 * p[6]
            row[0] = scale * (slope1 * (sin1 + bend1 * cos1) + slope2 * (sin2 + bend2 * cos2)) - p[7]
            row[1] = scale * (slope1 * (bend1 * sin1 - cos1) + slope2 * (bend2 * sin2 - cos2)) - p[8]
            row[2] = -scale * slope1 * (along1 + bend1 * beside1)
            row[3] = -scale * slope2 * (along2 + bend2 * beside2)
            row[4] = -slope1 * u - slope2 * v
            row[5] = 1.0
            row[6] = edge1 * edge2
            row[7] = dx
            row[8] = dy
            residual = image[y, x] - (p[5] + p[6] * row[6] + p[7] * dx + p[8] * dy)
            total += residual * residual
            count += 1
            weight = residual * residual if by_residual else 1.0
            for i in range(9):
                gradient[i] += row[i] * residual
                for j in range(i + 1):
                    normal[i, j] += weight * row[i] * row[j]
    return total, count


@kernel()
def start_corner(image: Image, p: FloatArray, window: FloatArray) -> None:
    """Fill p's grey and half contrast by linear fit of the unblurred corner at p's place and angles."""
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
def fit_window(image: Image, p: FloatArray, window: FloatArray, covariance: FloatArray) -> float:
    """Levenberg-Marquardt over one window; p is improved in place.

    covariance (2, 2) of the centre.  Returns the noise sigma in grey values, or NaN on failure.
    """
    normal, trial_normal = np.empty((9, 9)), np.empty((9, 9))
    gradient, trial_gradient, step, trial = np.empty(9), np.empty(9), np.empty(9), np.empty(9)
    damped = np.empty((9, 9))
    total, count = accumulate_corner(image, p, window, normal, gradient, False)
    if count <= _UNKNOWNS:
        return math.nan
    damping = 1e-3
    for _ in range(_STEPS):
        damped[:] = normal
        for i in range(9):
            damped[i, i] *= 1.0 + damping
        step[:] = gradient
        if not solve_spd(damped, step, 9):
            return math.nan
        trial[:] = p + step
        if not (math.fabs(trial[4]) < 4.0):
            damping *= 10.0
            if damping > 1e8:
                return math.nan
            continue
        trial_total, _ = accumulate_corner(image, trial, window, trial_normal, trial_gradient, False)
        if trial_total <= total:
            p[:] = trial
            normal[:] = trial_normal
            gradient[:] = trial_gradient
            total = trial_total
            damping = max(damping * 0.1, 1e-9)
            # a thousandth of what noise leaves open
            if math.fabs(step[0]) < 1e-5 and math.fabs(step[1]) < 1e-5 and math.fabs(step[4]) < 1e-4:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    if not centre_covariance(image, p, window, normal, covariance):
        return math.nan
    return math.sqrt(total / (count - _UNKNOWNS))


@kernel()
def centre_covariance(
    image: Image, p: FloatArray, window: FloatArray, normal: FloatArray, covariance: FloatArray
) -> bool:
    """Covariance (2, 2) of the centre that holds when noise sits on the edges.

    Rough prints, shadows and sub-sampled edges put the residuals where the corner's place is
    read from, and most pixels of the window are flat and quiet: the residuals' mean square would
    promise too much. N^-1 (sum of r² g gᵀ) N^-1 does not. Source: H. White, 1980, doi:10.2307/1912934.
    """
    meat, factor = np.empty((9, 9)), np.empty((9, 9))
    scratch = np.empty(9)
    inverse = np.zeros((2, 9))
    _, count = accumulate_corner(image, p, window, meat, scratch, True)
    for axis in range(2):
        factor[:] = normal
        inverse[axis, axis] = 1.0
        if not solve_spd(factor, inverse[axis], 9):
            return False
    covariance[:] = 0.0
    for a in range(2):
        for b in range(2):
            for i in range(9):
                for j in range(9):
                    covariance[a, b] += inverse[a, i] * meat[max(i, j), min(i, j)] * inverse[b, j]
            covariance[a, b] *= count / (count - _UNKNOWNS)
    return True


@kernel("void(u1[:, ::1], f8[:, ::1], f8[:, ::1])")
def fit_corners(image: Image, start: FloatArray, result: FloatArray) -> None:
    """Fit the corner model at each start.

    start (N, 7) : x, y, the directions of both edges in rad, the window's radius in px, and the
    curvatures of both edges in 1/px, positive when they bend towards their normal.
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
            noise = fit_window(image, p, window, covariance)
            if math.isnan(noise):
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
        good = moved < max(2.5, 0.5 * start[n, 4]) and blur < 0.5 * start[n, 4] and across > 0.2
        if good and inside > _MIN_SHARE_INSIDE and noise < 0.25 * contrast:
            result[n, 5] = 1.0
