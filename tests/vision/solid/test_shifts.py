"""The distance of a profile's steps from their predicted places."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from edged.vision.solid.shifts import DAMPING, NEAR, STEP_PX, best_of_grid, fill_steps, misfit_at


@given(st.integers(0, 2**32 - 1), st.integers(1, NEAR + 1), st.floats(-2.5, 2.5), st.floats(0.45, 1.5))
def test_a_misfit_is_what_fitted_steps_leave(seed: int, many: int, shift: float, blur: float) -> None:
    """For any profile and steps, heights and remainder equal those of the equations solved in numpy."""
    rng = np.random.default_rng(seed)
    grey, edges = rng.uniform(0, 255, 21), rng.uniform(-7, 7, NEAR + 1)
    places = STEP_PX * np.arange(-10, 11)
    design = np.column_stack([np.ones(21), norm.cdf((places[:, None] - edges[:many] - shift) / blur)])
    heights = np.linalg.solve(design.T @ design + DAMPING * np.eye(many + 1), design.T @ grey)

    terms, normal, found = np.ones((NEAR + 2, 21)), np.empty((NEAR + 2, NEAR + 2)), np.empty(NEAR + 2)
    left = misfit_at(grey, float(grey @ grey), edges, many, shift, blur, terms, normal, found)
    assert found[: many + 1] == pytest.approx(heights, rel=1e-4, abs=0.01)
    assert left == pytest.approx(float(np.sum((grey - design @ heights) ** 2)), rel=1e-4, abs=0.01)


@given(st.integers(0, 2**32 - 1), st.integers(1, NEAR + 1))
def test_the_grid_has_the_misfit_of_each_shift(seed: int, many: int) -> None:
    """Sums that follow from one shift to the next leave what steps at that shift leave by themselves."""
    rng = np.random.default_rng(seed)
    grey, edges = rng.uniform(0, 255, 21), rng.uniform(-7, 7, NEAR + 1)
    square, grid, blur = float(grey @ grey), 4, 0.6
    wide, left, found = np.ones((NEAR + 2, 21 + 2 * grid)), np.empty(2 * grid + 1), np.empty(NEAR + 2)
    normal, terms = np.empty((NEAR + 2, NEAR + 2)), np.ones((NEAR + 2, 21))
    products, pulls = np.empty((NEAR + 2, NEAR + 2, len(left))), np.empty((NEAR + 2, len(left)))
    fill_steps(edges, many, 0.0, blur, wide)
    best = best_of_grid(grey, square, wide, many, products, pulls, normal, found, left)
    shifts = STEP_PX * np.arange(-grid, grid + 1)
    each = [misfit_at(grey, square, edges, many, at, blur, terms, normal, found) for at in shifts]
    assert left == pytest.approx(each, rel=1e-6, abs=1e-3)
    assert best == int(np.argmin(left))
