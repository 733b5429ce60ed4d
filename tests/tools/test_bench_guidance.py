"""Guided views are worth twice a careful person's, by computed marks."""

from __future__ import annotations

import bench_guidance
import numpy as np
import pytest


@pytest.mark.long
def test_guided_views_are_worth_the_double() -> None:
    """Six guided views predict no more sigma than a careful person's twelve, and the errors fit the sigma."""
    guided, careful = bench_guidance.outcomes(6, 12, 0.01, seed=1)
    assert np.linalg.norm(guided.sigma_um) <= np.linalg.norm(careful.sigma_um)
    assert np.linalg.norm(guided.error_um) < 3 * np.linalg.norm(guided.sigma_um)
