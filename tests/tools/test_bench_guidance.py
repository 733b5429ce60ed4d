"""Guided views are worth the double of a careful person's, told by computed marks."""

from __future__ import annotations

import bench_guidance
import numpy as np
import pytest


@pytest.mark.slow
def test_guided_views_are_worth_the_double() -> None:
    """Six of them predict no more sigma than twelve of a careful person, and the errors are as stated."""
    guided, careful = bench_guidance.outcomes(6, 12, 0.01, seed=1)
    assert np.linalg.norm(guided.sigma_um) <= np.linalg.norm(careful.sigma_um)
    assert np.linalg.norm(guided.error_um) < 3 * np.linalg.norm(guided.sigma_um)
