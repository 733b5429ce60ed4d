"""Kernels of normalised cross-correlation along a row: window, scores, peak."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import F64, I32, Image
from edged.vision.kernels.jit import kernel

TEMPLATE_SCALE = 16  # grey values of a sheared window are kept as integers, so that sums are exact


@kernel("void(u1[:, ::1], i8, i8, f8, f8, i8, i4[:, ::1])")
def sheared_window(
    image: Image, x: int, y: int, stretch: float, shear: float, half: int, window: I32
) -> None:
    """Fill window[b, a] with the image at x + stretch a + shear b in row y + b, linear between pixels.

    Units are 1 / TEMPLATE_SCALE grey; a, b run from -half to half; columns are clamped at the border.
    """
    last = image.shape[1] - 1
    for b in range(-half, half + 1):
        for a in range(-half, half + 1):
            position = min(max(x + stretch * a + shear * b, 0.0), float(last))
            column = min(int(position), last - 1)
            share = position - column
            value = (1.0 - share) * image[y + b, column] + share * image[y + b, column + 1]
            window[b + half, a + half] = int(TEMPLATE_SCALE * value + 0.5)


@kernel("void(i4[:, ::1], u1[:, ::1], i8, i8, i8, i4[:, ::1], i4[::1], f8[::1])")
def ncc_along_row(
    window: I32, image: Image, x: int, y: int, count: int, strip: I32, products: I32, scores: F64
) -> None:
    """Zero-mean NCC of a window with the image at centres x, x + 1, ... x + count - 1 of row y.

    All windows lie within the image. strip, products : scratch. scores (>= count,) is written;
    0 where either window is flat.
    """
    size = window.shape[0]
    half, width, area = size // 2, count + size - 1, size * size
    sum_window, sum_window2 = 0, 0
    products[:count] = 0
    for j in range(size):
        for k in range(width):
            strip[j, k] = image[y - half + j, x - half + k]
        for i in range(size):
            t = window[j, i]
            sum_window += t
            sum_window2 += np.int64(t) * t
            for k in range(count):
                products[k] += t * strip[j, i + k]
    spread_window = float(area * sum_window2 - sum_window * sum_window)
    total, total2 = 0, 0
    for k in range(width):
        for j in range(size):
            total += strip[j, k]
            total2 += strip[j, k] * strip[j, k]
            if k >= size:
                total -= strip[j, k - size]
                total2 -= strip[j, k - size] * strip[j, k - size]
        if k >= size - 1:
            n = k - size + 1
            spread = float(area * total2 - total * total)
            joint = float(area * np.int64(products[n]) - sum_window * total)
            scores[n] = joint / math.sqrt(spread * spread_window) if spread * spread_window > 0.0 else 0.0


@kernel("i8(f8[::1], i8, f8[::1])")
def find_peak(scores: F64, count: int, found: F64) -> int:
    """Index of the best score; -1 if it lies at an end of the scores.

    found (4,) is filled: its score, the ratio of the second peak to it, curvature per step², offset of the
    vertex in steps.
    """
    best = 0
    for k in range(1, count):
        if scores[k] > scores[best]:
            best = k
    found[0] = scores[best]
    if best in (0, count - 1):
        return -1
    first, last = best, best
    while first > 0 and scores[first - 1] < scores[first]:
        first -= 1
    while last < count - 1 and scores[last + 1] < scores[last]:
        last += 1
    second = 0.0
    for k in range(count):
        if k < first or k > last:
            second = max(second, scores[k])
    before, after = scores[best - 1], scores[best + 1]
    found[1] = second / scores[best] if scores[best] > 0.0 else 1.0
    found[2] = 2.0 * scores[best] - before - after
    found[3] = 0.5 * (after - before) / found[2] if found[2] > 0.0 else 0.0
    return best
