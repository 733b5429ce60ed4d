"""Plain-loop twins of the kernels of `vision/teaching`: slow, but simple enough to trust."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray


def coverage(outline: FloatArray, height: int, width: int, n: int = 12) -> FloatArray:
    """Share of n x n points of each pixel that lie inside a polygon (even-odd)."""
    share = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            for k in range(n * n):
                x = column - 0.5 + (k % n + 0.5) / n
                y = row - 0.5 + (k // n + 0.5) / n
                inside = False
                for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
                    if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
                        inside = not inside
                share[row, column] += inside / n**2
    return share
