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
LAST_ROW = 2.0 * STEP_END * STEPS_PER_UNIT
STEPS = np.array(
    [
        0.5 * (1.0 + math.erf(k / STEPS_PER_UNIT / math.sqrt(2.0)))
        for k in range(-STEP_END * STEPS_PER_UNIT, STEP_END * STEPS_PER_UNIT + 2)
    ]
)
"""A step blurred by a Gaussian of unit width, from -STEP_END on."""


@kernel("void(f8[::1], i8, f8, f8, f8[:, ::1])")
def fill_steps(edges: F64, many: int, shift: float, blur: float, terms: F64) -> None:
    """Fill terms[1 : many + 1] (S,) with blurred steps at edges + shift, at places STEP_PX apart about 0.

    Between two rows of the table, and without branches: the compiler then computes several at once.
    """
    size, rows = terms.shape[1], STEPS_PER_UNIT / blur
    for e in range(many):
        term, at = terms[e + 1], STEP_PX * (size // 2) + edges[e] + shift
        first = STEP_END * STEPS_PER_UNIT - at * rows
        for s in range(size):
            place = min(max(first + s * (STEP_PX * rows), 0.0), LAST_ROW)
            row = np.int32(place)
            low, high = STEPS[row], STEPS[row + 1]
            term[s] = low + (place - row) * (high - low)


@kernel("f8(f8[::1], f8, f8[:, ::1], i8, f8[:, ::1], f8[::1])", any_order=True)
def misfit(grey: F64, square: float, terms: F64, many: int, normal: F64, height: F64) -> float:
    """Residual square sum of a profile after steps are fitted to it; height is filled with their heights.

    grey (S,), square : its square sum.  terms (many + 1, S) : a constant and steps.  normal, height :
    buffers.
    """
    count, size = len(grey), many + 1
    for i in range(size):
        own = terms[i]
        total = 0.0
        for s in range(count):
            total += own[s] * grey[s]
        height[i] = total
        for j in range(i + 1):
            other = terms[j]
            total = DAMPING if i == j else 0.0
            for s in range(count):
                total += own[s] * other[s]
            normal[i, j] = total
    return _left_of(square, size, normal, height)


@kernel("f8(f8, i8, f8[:, ::1], f8[::1])")
def _left_of(square: float, size: int, normal: F64, height: F64) -> float:
    """Residual square sum from damped normal equations; their right side, height, becomes their solution."""
    factorise(normal, size)
    substitute(normal, height, size)
    for i in range(size):  # of (N + d) h = r: |g|^2 - 2 h r + h N h = |g|^2 - h r - d h h, and h r = |L' h|^2
        along = 0.0
        for k in range(i, size):
            along += normal[k, i] * height[k]
        square -= along * along + DAMPING * height[i] * height[i]
    return max(square, 0.0)


@kernel("i8(f8[::1], f8, f8[:, ::1], i8, f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1])")
def best_of_grid(
    grey: F64, square: float, wide: F64, many: int, products: F64, pulls: F64, normal: F64, height: F64,
    left: F64,
) -> int:  # fmt: skip
    """Number of the shift of the grid with the smallest `misfit`; left (G,) is filled with all of them.

    wide (many + 1, S + G - 1) : a constant and steps; at shift g they begin at column G - 1 - g.
    products (many + 1, many + 1, G), pulls (many + 1, G), normal, height : buffers.
    The sums of products follow from one shift to the next; those with the profile are taken for all at once.
    """
    count, size, shifts = len(grey), many + 1, len(left)
    for i in range(size):
        pull, term = pulls[i], wide[i]
        pull[:] = 0.0
        for s in range(count):
            value = grey[s]
            for c in range(shifts):  # by column: shift shifts - 1 - c
                pull[c] += value * term[s + c]
        for j in range(i + 1):
            other, total = wide[j], 0.0
            for s in range(count):
                total += term[s] * other[s]
            for c in range(shifts):
                products[i, j, c] = total
                if c < shifts - 1:
                    total += term[count + c] * other[count + c] - term[c] * other[c]
    best = 0
    for g in range(shifts):
        c = shifts - 1 - g
        for i in range(size):
            height[i] = pulls[i, c]
            for j in range(i):
                normal[i, j] = products[i, j, c]
            normal[i, i] = products[i, i, c] + DAMPING
        left[g] = _left_of(square, size, normal, height)
        if left[g] < left[best]:
            best = g
    return best


@kernel("f8(f8[::1], f8, f8[::1], i8, f8, f8, f8[:, ::1], f8[:, ::1], f8[::1])", any_order=True)
def misfit_at(
    grey: F64, square: float, edges: F64, many: int, shift: float, blur: float,
    terms: F64, normal: F64, height: F64,
) -> float:  # fmt: skip
    """`misfit` of blurred steps at edges + shift; one or two, as usual, are summed in one pass."""
    fill_steps(edges, many, shift, blur, terms)
    if many > 2:
        return misfit(grey, square, terms, many, normal, height)
    count, own, other = len(grey), terms[1], terms[many]
    whole = first = second = of_own = of_other = own_own = own_other = other_other = 0.0
    for s in range(count):
        value, a, b = grey[s], own[s], other[s]
        whole += value
        first, second = first + a * value, second + b * value
        of_own, of_other = of_own + a, of_other + b
        own_own, own_other, other_other = own_own + a * a, own_other + a * b, other_other + b * b
    height[0], height[1], height[many] = whole, first, second
    normal[0, 0], normal[1, 0], normal[1, 1] = count + DAMPING, of_own, own_own + DAMPING
    if many == 2:
        normal[2, 0], normal[2, 1], normal[2, 2] = of_other, own_other, other_other + DAMPING
    return _left_of(square, many + 1, normal, height)


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
    normal, steps, left = np.empty((NEAR + 2, NEAR + 2)), np.empty(NEAR + 2), np.empty(2 * grid + 1)
    products, pulls = np.empty((NEAR + 2, NEAR + 2, len(left))), np.empty((NEAR + 2, len(left)))
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
        at = best_of_grid(grey, square, wide, many, products, pulls, normal, steps, left) - grid
        if abs(at) == grid:
            continue
        d = STEP_PX * at
        for h in (0.25, 0.12):
            before = misfit_at(grey, square, edges, many, d - h, blur, terms, normal, steps)
            here = left[at + grid]  # of the grid; then d is between its shifts
            if h < 0.25:
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
