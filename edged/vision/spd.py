"""Inverse of small symmetric positive matrices, for kernels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edged.vision.jit import kernel

F64 = npt.NDArray[np.float64]

_TINY_PIVOT = 1e-10  # of a matrix scaled to a unit diagonal


@kernel("b1(f8[:, ::1], f8[:, ::1])")
def invert_spd(matrix: F64, inverse: F64) -> bool:
    """Invert a symmetric positive matrix by Cholesky, scaled to a unit diagonal; False if it is singular."""
    size = matrix.shape[0]
    scale = np.empty(size)
    lower = np.zeros((size, size))
    for i in range(size):
        if not matrix[i, i] > 0:
            return False
        scale[i] = 1.0 / np.sqrt(matrix[i, i])
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j] * scale[i] * scale[j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > _TINY_PIVOT:
                    return False
                lower[i, i] = np.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    column = np.empty(size)
    for c in range(size):
        for i in range(size):
            total = 1.0 if i == c else 0.0
            for k in range(i):
                total -= lower[i, k] * column[k]
            column[i] = total / lower[i, i]
        for i in range(size - 1, -1, -1):
            total = column[i]
            for k in range(i + 1, size):
                total -= lower[k, i] * column[k]
            column[i] = total / lower[i, i]
        for i in range(size):
            inverse[i, c] = column[i] * scale[i] * scale[c]
    return True
