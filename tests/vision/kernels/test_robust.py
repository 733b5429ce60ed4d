"""Robust statistics along a curve: kernels equal their plain twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from adjustments import ring
from naive import curves as naive_curves
from naive import kernels as naive_kernels

from edged.vision.kernels import robust
from edged.vision.kernels.median import median


@pytest.mark.parametrize("seed", range(5))
def test_small_kernels_equal_their_twins(seed: int) -> None:
    """Scale, weight and correlation, on smooth and on rough samples with gaps."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(30, 200))
    rough = rng.normal(0, 0.1, count)
    smooth = np.convolve(np.concatenate([rough, rough]), np.ones(5), "same")[:count]
    base = np.where(rng.random(count) < 0.2, 0.0, 1.0)
    for values in (rough, smooth, smooth + ring(count) @ rng.normal(0, 0.1, 5)):
        assert robust.robust_scale(values, base) == pytest.approx(naive_kernels.median_scale(values, base))
        assert robust.correlation_length(values, base) == pytest.approx(
            naive_curves.correlation_length(values, base)
        )
    for ratio in (-6.0, -1.0, 0.0, 2.5, 4.684):
        assert robust.tukey_weight(ratio) == pytest.approx(
            float(naive_kernels.tukey_weights(np.array(ratio)))
        )


@pytest.mark.parametrize("count", [1, 2, 16, 17, 40, 333, 2000])
def test_the_median_is_numpys(count: int) -> None:
    """With few and many samples, outliers, equal samples and two heaps; what is no number ends, too."""
    rng = np.random.default_rng(count)
    rough = rng.normal(0, 0.1, count)
    for values in (rough, np.abs(rough) + 1e6 * (rng.random(count) < 0.2), np.full(count, 2.5)):
        assert median(values) == np.median(values)
    assert median(np.repeat([0.0, 1.0], count)) == 0.5
    assert math.isnan(median(np.full(count, np.nan)))
    median(np.where(rng.random(count) < 0.5, np.inf, rough))
