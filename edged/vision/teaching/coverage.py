"""Paint polygons with the exact share of each pixel that they cover."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.kernels.jit import kernel

Array = npt.NDArray[Any]


def coverage(outline_px: FloatArray, height: int, width: int) -> FloatArray:
    """Share (H, W) of each pixel that a closed polygon (N, 2) covers; an integer is a pixel's centre.

    Clockwise and counter-clockwise outlines give the same; the outline must not cross itself.
    """
    area = np.zeros((height + 1, width + 2))
    _accumulate(np.ascontiguousarray(outline_px, np.float64), height, width, area)
    return np.asarray(np.abs(np.cumsum(area[:height], axis=1)[:, :width]))


@kernel("void(f8[:, ::1], i8, i8, f8[:, ::1])")
def _accumulate(points: Array, height: int, width: int, area: Array) -> None:
    """Signed area between each edge and the pixels to its right, as differences along the rows.

    Font rasterisers do it this way (R. Levien, "How the world's fastest font renderer works", 2016).
    """
    for n in range(len(points)):
        x0, y0 = points[n - 1, 0] + 0.5, points[n - 1, 1] + 0.5
        x1, y1 = points[n, 0] + 0.5, points[n, 1] + 0.5
        sign = 1.0
        if y0 > y1:
            x0, y0, x1, y1, sign = x1, y1, x0, y0, -1.0
        if y1 == y0:
            continue
        slope = (x1 - x0) / (y1 - y0)
        for row in range(max(0, int(np.floor(y0))), min(height, int(np.floor(y1)) + 1)):
            top, bottom = max(y0, float(row)), min(y1, row + 1.0)
            if bottom <= top:
                continue
            a, b = x0 + (top - y0) * slope, x0 + (bottom - y0) * slope
            a, b = min(a, b), max(a, b)
            upright = b - a < 1e-12
            amount = sign * (bottom - top)
            if a < 0:  # an edge left of the picture has the whole row to its right
                area[row, 0] += amount * (1.0 if b <= 0 else -a / (b - a))
            for column in range(max(0, int(np.floor(a))), min(width - 1, int(np.floor(b))) + 1):
                # the part of the edge in this column, and the mean distance to the column's right side
                left, right = max(a, float(column)), min(b, column + 1.0)
                share = 1.0 if upright else (right - left) / (b - a)
                if share <= 0:
                    continue
                inside = column + 1.0 - (a if upright else 0.5 * (left + right))
                area[row, column] += amount * share * inside
                area[row, column + 1] += amount * share * (1 - inside)
