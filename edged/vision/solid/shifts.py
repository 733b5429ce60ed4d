"""Measure how far a profile's steps lie from where they were predicted: one shift for all, free heights."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import F64, I64
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import kernel
from edged.vision.solid.params import PROFILE

# numba freezes globals when it compiles: kernels read these by name
STEP_PX = PROFILE.step_px
WIDEST_PX = PROFILE.widest_px
DAMPING = PROFILE.damping
NEAR = 4
"""Steps of a profile besides that of its own edge: two neighbours on either side."""
STEP_END = 6
"""Sigmas from a blurred step, beyond which it is 0 or 1 to 1e-9."""
STEPS_PER_UNIT = 512
"""Rows of the table of a blurred step: between two of them a line is good to 1e-7."""
STEPS = np.array(
    [
        0.5 * (1.0 + math.erf(k / STEPS_PER_UNIT / math.sqrt(2.0)))
        for k in range(-STEP_END * STEPS_PER_UNIT, STEP_END * STEPS_PER_UNIT + 2)
    ]
)
"""A step blurred by a Gaussian of unit width, from -STEP_END on."""


@kernel("f8(f8)", inline=True)
def _edge_step(x: float) -> float:
    """A step blurred by a Gaussian of unit width, between two rows of the table: good to 1e-7."""
    place = (x + STEP_END) * STEPS_PER_UNIT
    row = int(place)
    low, high = float(STEPS[row]), float(STEPS[row + 1])
    return low + (place - row) * (high - low)


@kernel("void(f8[::1], i8, f8, f8, f8[:, ::1])")
def fill_steps(edges: F64, many: int, shift: float, blur: float, terms: F64) -> None:
    """Fill terms[1 : many + 1] (S,) with blurred steps at edges + shift, at places STEP_PX apart about 0."""
    size = terms.shape[1]
    for e in range(many):
        at = edges[e] + shift
        for s in range(size):
            x = (STEP_PX * (s - size // 2) - at) / blur
            terms[e + 1, s] = 0.0 if x < -STEP_END else (1.0 if x > STEP_END else _edge_step(x))


@kernel("f8(f8[::1], f8, f8[:, ::1], i8, i8, f8[:, ::1], f8[::1])")
def misfit(grey: F64, square: float, terms: F64, many: int, first: int, normal: F64, height: F64) -> float:
    """Residual square sum of a profile after steps are fitted to it; height is filled with their heights.

    grey (S,), square : its square sum.  terms (many + 1, S or more) : a constant and steps, from column
    first on.  normal, height : buffers.
    """
    count, size = len(grey), many + 1
    for i in range(size):
        own = terms[i, first : first + count]
        total = 0.0
        for s in range(count):
            total += own[s] * grey[s]
        height[i] = total
        for j in range(i + 1):
            other = terms[j, first : first + count]
            total = DAMPING if i == j else 0.0
            for s in range(count):
                total += own[s] * other[s]
            normal[i, j] = total
    right = height[:size].copy()
    factorise(normal, size)
    substitute(normal, height, size)
    for i in range(size):  # of (N + d) h = r: |g|^2 - 2 h r + h N h
        square -= height[i] * (right[i] + DAMPING * height[i])
    return max(square, 0.0)


@kernel("f8(f8[::1], f8, f8[::1], i8, f8, f8, f8[:, ::1], f8[:, ::1], f8[::1])")
def misfit_at(
    grey: F64, square: float, edges: F64, many: int, shift: float, blur: float,
    terms: F64, normal: F64, height: F64,
) -> float:  # fmt: skip
    """`misfit` of blurred steps at edges + shift."""
    fill_steps(edges, many, shift, blur, terms)
    return misfit(grey, square, terms, many, 0, normal, height)


@kernel("void(f8[:, ::1], i8[::1], f8[:, ::1], f8, i8, f8[::1], f8[::1], f8[::1])")
def find_shifts(
    profiles: F64, curve: I64, near: F64, blur: float, together: int, shift: F64, weight: F64, height: F64
) -> None:
    """Fill shift (M,), px, weight (M,), 1 / px², and height (M,) from profiles (M, S).

    near (M, 4) : offsets of neighbouring edges, NaN where there are fewer.  together : profiles on either
    side along the same curve that are averaged. Where the best shift lies at the end of the search, or the
    profile leaves the image, nothing is filled in.
    """
    count, size = profiles.shape
    grey, edges = np.empty(size), np.empty(NEAR + 1)
    half = STEP_PX * (size // 2)
    grid = round(WIDEST_PX / STEP_PX)
    terms, wide = np.ones((NEAR + 2, size)), np.ones((NEAR + 2, size + 2 * grid))
    normal, steps = np.empty((NEAR + 2, NEAR + 2)), np.empty(NEAR + 2)
    for m in range(count):
        first, last = m, m
        while first > 0 and m - first < together and curve[first - 1] == curve[m]:
            first -= 1
        while last < count - 1 and last - m < together and curve[last + 1] == curve[m]:
            last += 1
        square = 0.0
        for s in range(size):
            total = 0.0
            for n in range(first, last + 1):
                total += profiles[n, s]
            grey[s] = total / (last - first + 1)
            square += grey[s] * grey[s]
        if not np.isfinite(square):
            continue
        edges[0], many = 0.0, 1
        for k in range(NEAR):
            if np.isfinite(near[m, k]) and abs(near[m, k]) < half + WIDEST_PX:
                edges[many] = near[m, k]
                many += 1
        fill_steps(edges, many, 0.0, blur, wide)  # shifted by whole steps these are the steps of the grid
        least, at = np.inf, 0
        for g in range(-grid, grid + 1):
            value = misfit(grey, square, wide, many, grid - g, normal, steps)
            if value < least:
                least, at = value, g
        if abs(at) == grid:
            continue
        d = STEP_PX * at
        for h in (0.25, 0.12):
            before = misfit_at(grey, square, edges, many, d - h, blur, terms, normal, steps)
            here = misfit_at(grey, square, edges, many, d, blur, terms, normal, steps)
            after = misfit_at(grey, square, edges, many, d + h, blur, terms, normal, steps)
            bend = before - 2 * here + after
            if bend > 1e-9:
                d += min(max(0.5 * h * (before - after) / bend, -h), h)
        before = misfit_at(grey, square, edges, many, d - 0.25, blur, terms, normal, steps)
        after = misfit_at(grey, square, edges, many, d + 0.25, blur, terms, normal, steps)
        here = misfit_at(grey, square, edges, many, d, blur, terms, normal, steps)
        shift[m], height[m] = d, steps[1]
        curvature = max((before - 2 * here + after) / 0.0625, 0.0)
        weight[m] = min(0.5 * curvature / (here / (size - 3) + 0.5), 400.0)
