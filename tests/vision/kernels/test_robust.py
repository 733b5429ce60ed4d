"""Robust statistics along a curve: kernels equal their plain twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.adjustments import ring
from naive import curves as naive_curves
from naive import kernels as naive_kernels

from edged.vision.kernels import robust
from edged.vision.kernels.median import median


@pytest.mark.parametrize("seed", range(5))
def test_small_kernels_equal_their_twins(seed: int) -> None:
    """Scale, weight and correlation equal the twins', on smooth and rough samples with gaps."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(30, 200))
    rough = rng.normal(0, 0.1, count)
    smooth = np.convolve(np.concatenate([rough, rough]), np.ones(5), "same")[:count]
    base = np.where(rng.random(count) < 0.2, 0.0, 1.0)
    for values in (rough, smooth, smooth + ring(count) @ rng.normal(0, 0.1, 5)):
        assert robust.robust_scale(values, base) == pytest.approx(naive_kernels.median_scale(values, base))
        kept = values[base > 0]
        assert robust.mad_sigma(kept) == pytest.approx(naive_kernels.median_scale(kept, base[base > 0]))
        assert robust.correlation_length(values, base) == pytest.approx(
            naive_curves.correlation_length(values, base)
        )
    for ratio in (-6.0, -1.0, 0.0, 2.5, 4.684):
        assert robust.tukey_weight(ratio) == pytest.approx(
            float(naive_kernels.tukey_weights(np.array(ratio)))
        )


def test_weights_of_an_array_are_those_of_its_residuals() -> None:
    """Tukey's biweight is 1 at 0, half at 0.541 of the threshold and 0 from there on, for either sign."""
    residuals = 0.3 * np.array([-9.0, -4.685, -2.0, -0.1, 0.0, 0.1, 2.5, 4.684, 5.0])
    weights = robust.tukey_weights(residuals, 0.3)
    np.testing.assert_allclose(weights, [robust.tukey_weight(one / 0.3) for one in residuals], atol=1e-12)
    np.testing.assert_allclose(weights, naive_kernels.tukey_weights(residuals / 0.3), atol=1e-12)
    assert robust.tukey_weights(np.array([0.0, 0.5411961 * 4.685]), 1.0) == pytest.approx([1.0, 0.5])
    assert robust.robust_scale(residuals, np.zeros(9)) == 0.0


@pytest.mark.parametrize("count", [1, 2, 16, 17, 40, 333, 2000])
def test_the_median_is_numpys(count: int) -> None:
    """With few or many samples, outliers and equal samples the median is numpy's; of NaN it is NaN."""
    rng = np.random.default_rng(count)
    rough = rng.normal(0, 0.1, count)
    for values in (rough, np.abs(rough) + 1e6 * (rng.random(count) < 0.2), np.full(count, 2.5)):
        assert median(values) == np.median(values)
    assert median(np.repeat([0.0, 1.0], count)) == 0.5
    assert math.isnan(median(np.full(count, np.nan)))
    median(np.where(rng.random(count) < 0.5, np.inf, rough))
