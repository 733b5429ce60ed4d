"""Cholesky's factor: what it solves and inverts, and which matrices it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from edged.vision.kernels.cholesky import factorise, invert, substitute


@pytest.mark.parametrize("size", [1, 3, 5, 8, 40])
def test_the_upper_left_of_a_matrix_is_factorised_and_solved(size: int) -> None:
    """The lower triangle becomes numpy's factor, the solution is numpy's, and values outside are not read."""
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size))
    square, right = root @ root.T + np.eye(size), rng.normal(size=size + 2)
    matrix = np.full((size + 2, size + 2), np.nan)
    matrix[:size, :size] = np.tril(square) + np.triu(np.full((size, size), np.nan), 1)
    assert 0 < factorise(matrix, size) <= 1
    np.testing.assert_allclose(np.tril(matrix[:size, :size]), np.linalg.cholesky(square), rtol=1e-9)
    solution = right.copy()
    substitute(matrix, solution, size)
    np.testing.assert_allclose(solution[:size], np.linalg.solve(square, right[:size]), rtol=1e-8)
    np.testing.assert_array_equal(solution[size:], right[size:])


def test_the_smallest_pivot_does_not_depend_on_units() -> None:
    """For two unknowns correlated by 0.8 the smallest pivot is 1 - 0.8², whatever their units."""
    matrix = np.array([[1.0, 0.8], [0.8, 1.0]])
    for units in ([1.0, 1.0], [1e-6, 1e3], [1e8, 1.0]):
        assert factorise(matrix * np.outer(units, units), 2) == pytest.approx(0.36)


@pytest.mark.parametrize("size", [2, 7, 30])
def test_the_inverse_is_numpys(size: int) -> None:
    """The inverse of a full matrix is numpy's, whatever the units of its unknowns."""
    rng = np.random.default_rng(size)
    root, units = rng.normal(size=(size, size)), 10.0 ** rng.uniform(-6, 6, size)
    square = root @ root.T + 0.1 * np.eye(size)
    inverse = np.empty((size, size))
    assert invert(square * np.outer(units, units), inverse)
    np.testing.assert_allclose(inverse * np.outer(units, units), np.linalg.inv(square), rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(inverse, inverse.T)


@pytest.mark.parametrize(
    "rows",
    [
        [[1.0, 1.0], [1.0, 1.0]],
        [[1.0, 0.0], [0.0, -1.0]],
        [[1.0, 2.0], [2.0, 1.0]],
        [[0.0, 0.0], [0.0, 1.0]],
        [[np.nan, 0.0], [0.0, 1.0]],
        [[1.0, np.nan], [np.nan, 1.0]],
    ],
)
def test_what_is_not_positive_is_refused(rows: list[list[float]]) -> None:
    """A matrix of too low a rank, with a negative or a missing element, is neither factorised nor
    inverted."""
    assert factorise(np.array(rows), 2) == 0.0
    assert not invert(np.array(rows), np.empty((2, 2)))
