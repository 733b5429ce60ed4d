"""Small symmetric positive matrices, solved in kernels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edged.vision.kernels.jit import kernel

F64 = npt.NDArray[np.float64]

_TINY_PIVOT = 1e-10  # of a matrix scaled to a unit diagonal


@kernel("b1(f8[:, ::1], f8[:, ::1])", any_order=True)
def invert_spd(matrix: F64, inverse: F64) -> bool:
    """Invert a symmetric positive matrix by Cholesky, scaled to a unit diagonal; False if it is singular.

    Every inner loop runs along a row: the inverse of the factor, row by row, then its square.
    """
    size = matrix.shape[0]
    scale, row = np.empty(size), np.empty(size)
    lower, upside = np.empty((size, size)), np.zeros((size, size))  # the factor and its inverse
    for i in range(size):
        if not matrix[i, i] > 0:
            return False
        scale[i] = 1.0 / np.sqrt(matrix[i, i])
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(j):
                total += lower[i, k] * lower[j, k]
            total = matrix[i, j] * scale[i] * scale[j] - total
            if i > j:
                lower[i, j] = total / lower[j, j]
            elif total > _TINY_PIVOT:
                lower[i, i] = np.sqrt(total)
            else:
                return False
        row[:i] = 0.0
        for k in range(i):
            for c in range(k + 1):
                row[c] -= lower[i, k] * upside[k, c]
        for c in range(i):
            upside[i, c] = row[c] / lower[i, i]
        upside[i, i] = 1.0 / lower[i, i]
    inverse[:] = 0.0
    for k in range(size):
        for i in range(k + 1):
            for j in range(i + 1):
                inverse[i, j] += upside[k, i] * upside[k, j]
    for i in range(size):
        for j in range(i + 1):
            inverse[i, j] = inverse[j, i] = inverse[i, j] * scale[i] * scale[j]
    return True
