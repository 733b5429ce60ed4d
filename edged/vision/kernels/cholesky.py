"""Cholesky decomposition of small symmetric positive matrices, in kernels: factorise, substitute, invert.

`factorise` and `substitute` add their sums in a fixed order, whatever the caller: equal systems have
bit-equal solutions.
"""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import F64
from edged.vision.kernels.jit import kernel

_TINY_PIVOT = 1e-10  # of a matrix scaled to a unit diagonal


@kernel("f8(f8[:, ::1], i8)")
def factorise(matrix: F64, size: int) -> float:
    """Replace the lower triangle of a matrix, upper left size x size, by its factor L: matrix = LLᵀ.

    Only the lower triangle is read.  Returns the smallest pivot in [0, 1] relative to its diagonal element,
    so that the units of unknowns do not matter; 0 if the matrix is not positive.
    """
    smallest = 1.0
    for j in range(size):
        diagonal = matrix[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 0.0:
            return 0.0
        smallest = min(smallest, pivot / diagonal)
        matrix[j, j] = math.sqrt(pivot)
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / matrix[j, j]
    return smallest


@kernel("void(f8[:, ::1], f8[::1], i8)")
def substitute(factor: F64, vector: F64, size: int) -> None:
    """Solve LLᵀ x = vector in place, with L from `factorise`."""
    for i in range(size):
        for k in range(i):
            vector[i] -= factor[i, k] * vector[k]
        vector[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= factor[k, i] * vector[k]
        vector[i] /= factor[i, i]


@kernel("b1(f8[:, ::1], f8[:, ::1])", any_order=True)
def invert(matrix: F64, inverse: F64) -> bool:
    """Invert a symmetric positive matrix, scaled to a unit diagonal; False if it is singular.

    It inverts the factor, row by row, then forms the product: every inner loop runs along a row.
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
            lower[i, j] = matrix[i, j] * scale[i] * scale[j]
    if not factorise(lower, size) > _TINY_PIVOT:
        return False
    for i in range(size):
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
