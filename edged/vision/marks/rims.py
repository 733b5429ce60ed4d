"""Kernel that measures dots of known shape from the pixels around their rims only.

The model is the dot of `boards.markmodels` with the shape of the ellipse and the blur fixed to the taught
ones: seven unknowns instead of ten, on a ring of a few pixels, by Gauss-Newton from the expected position.
Effects that are symmetric about the centre, such as a different blur, do not move it.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.markmodels import dot_value
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import kernel
from edged.vision.marks.params import MARKS

# numba freezes globals when it compiles: kernels read these by name
_STEPS = MARKS.rim_steps
_SETTLED_PX = MARKS.settled_px
_FARTHEST_PX = MARKS.rim_px
_ROUGH = MARKS.rough
_UNKNOWNS = 7  # see `rim_sums`


@kernel()
def rim_sums(
    image: Image, p: FloatArray, ring: FloatArray, normal: FloatArray, meat: FloatArray, gradient: FloatArray
) -> tuple[float, int]:
    """Sum of squared residuals and pixel count over a ring; computes JᵀJ, Jᵀr and the sum of r² g gᵀ.

    p (10,) as in `dot_value`.  ring (7,) : centre, b11, b12, b22, radius and half width in px.
    """
    height, width = image.shape
    row, own, shape = np.empty(10), np.empty(_UNKNOWNS), np.empty(1)
    shape[0] = 1.0 / (math.sqrt(2.0) * math.exp(p[5]))
    normal[:] = 0.0
    meat[:] = 0.0
    gradient[:] = 0.0
    determinant = ring[2] * ring[4] - ring[3] * ring[3]
    # half sizes of the bounding box of the ellipse enlarged by the ring
    grown = 1.0 + ring[6] / ring[5]
    reach_x = grown * math.sqrt(ring[3] * ring[3] + ring[4] * ring[4]) / determinant
    reach_y = grown * math.sqrt(ring[2] * ring[2] + ring[3] * ring[3]) / determinant
    total, count = 0.0, 0
    for y in range(max(0, math.ceil(ring[1] - reach_y)), min(height - 1, math.floor(ring[1] + reach_y)) + 1):
        for x in range(
            max(0, math.ceil(ring[0] - reach_x)), min(width - 1, math.floor(ring[0] + reach_x)) + 1
        ):
            away_x, away_y = x - ring[0], y - ring[1]
            q1, q2 = ring[2] * away_x + ring[3] * away_y, ring[3] * away_x + ring[4] * away_y
            if math.fabs(math.sqrt(q1 * q1 + q2 * q2) - 1.0) * ring[5] > ring[6]:
                continue
            residual = image[y, x] - dot_value(p, shape, x - p[0], y - p[1], row)
            own[0], own[1] = row[0], row[1]
            own[2] = p[2] * row[2] + p[3] * row[3] + p[4] * row[4]
            own[3:] = row[6:]
            total += residual * residual
            count += 1
            for i in range(_UNKNOWNS):
                gradient[i] += own[i] * residual
                for j in range(i + 1):
                    product = own[i] * own[j]
                    normal[i, j] += product
                    meat[i, j] += residual * residual * product
    return total, count


@kernel("void(u1[:, ::1], f8[:, ::1], f8[:, ::1])")
def fit_rims(image: Image, start: FloatArray, result: FloatArray) -> None:
    """Fit dots of known shape.

    start (N, 7) : x, y, b11, b12, b22 (as in `dot_value`), blur in px, half width of the ring in px.
    result (N, 5) : x, y, sigma_px of one coordinate, contrast, ok (1 or 0). Source of the sigma: H. White,
    1980, doi:10.2307/1912934.
    """
    height, width = image.shape
    p, ring = np.empty(10), np.empty(7)
    normal, meat = np.empty((_UNKNOWNS, _UNKNOWNS)), np.empty((_UNKNOWNS, _UNKNOWNS))
    gradient, inverse = np.empty(_UNKNOWNS), np.empty(_UNKNOWNS)
    for n in range(start.shape[0]):
        result[n, :] = math.nan
        result[n, 3], result[n, 4] = 0.0, 0.0
        x, y, half = start[n, 0], start[n, 1], start[n, 6]
        determinant = start[n, 2] * start[n, 4] - start[n, 3] * start[n, 3]
        if not determinant > 0.0:
            continue
        radius = 1.0 / math.sqrt(determinant)
        reach = 1.0 / (
            0.5 * (start[n, 2] + start[n, 4]) - math.hypot(0.5 * (start[n, 2] - start[n, 4]), start[n, 3])
        )
        reach = reach * (1.0 + half / radius) + 1.0
        if not (reach <= x <= width - 1 - reach and reach <= y <= height - 1 - reach):
            continue
        p[:5] = start[n, :5]
        p[5] = math.log(start[n, 5] / radius)
        ring[:5] = start[n, :5]
        ring[5], ring[6] = radius, half
        inside = float(image[round(y), round(x)])
        outside = 0.0
        for k in range(16):
            angle = k * math.pi / 8.0
            outside += image[round(y + reach * math.sin(angle)), round(x + reach * math.cos(angle))] / 16.0
        p[6], p[7], p[8], p[9] = 0.5 * (inside + outside), 0.5 * (outside - inside), 0.0, 0.0
        total, count, settled = 0.0, 0, False
        for _ in range(_STEPS):
            total, count = rim_sums(image, p, ring, normal, meat, gradient)
            if count <= 4 * _UNKNOWNS or factorise(normal, _UNKNOWNS) == 0.0:
                break
            substitute(normal, gradient, _UNKNOWNS)
            p[0] += gradient[0]
            p[1] += gradient[1]
            p[2:5] *= math.exp(gradient[2])
            p[6:] += gradient[3:]
            if not math.hypot(p[0] - x, p[1] - y) < _FARTHEST_PX:
                break
            if math.fabs(gradient[0]) < _SETTLED_PX and math.fabs(gradient[1]) < _SETTLED_PX:
                settled = True
                break
        if not settled:
            continue
        variance = 0.0
        for axis in range(2):
            inverse[:] = 0.0
            inverse[axis] = 1.0
            substitute(normal, inverse, _UNKNOWNS)
            for i in range(_UNKNOWNS):
                for j in range(_UNKNOWNS):
                    variance += 0.5 * inverse[i] * meat[max(i, j), min(i, j)] * inverse[j]
        contrast = 2.0 * math.fabs(p[7])
        result[n, 0], result[n, 1] = p[0], p[1]
        result[n, 2] = math.sqrt(variance * count / (count - _UNKNOWNS))
        result[n, 3] = contrast
        if math.sqrt(total / (count - _UNKNOWNS)) < _ROUGH * contrast:
            result[n, 4] = 1.0
