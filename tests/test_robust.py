"""The robust solver: kernels equal their plain twins, wrong samples are forgotten, covariances are honest."""

from __future__ import annotations

import math
from dataclasses import replace

import naive
import numpy as np
import pytest

from edged.domain import FloatArray
from edged.vision import robust
from edged.vision.median import median
from edged.vision.robust import Groups, propagate, solve_groups
from edged.vision.spd import invert_spd


def ring(count: int) -> FloatArray:
    """(N, 5) slow waves around a circle."""
    angle = np.arange(count) * (2 * np.pi / count)
    rest = [math.sqrt(2) * f(m * angle) for m in (1, 2) for f in (np.cos, np.sin)]
    return np.column_stack([np.ones(count), *rest])


def problem(
    seed: int, bias: float = 0.0, noise: float = 0.1, wrong: float = 0.0
) -> tuple[Groups, FloatArray]:
    """Four groups, unknowns of which groups 0, 2 and groups 1, 3 share their own, and the true step.

    Unknowns: 3 common ones, one for each pair, and 5 shared slow displacements of the groups 1 and 3.
    """
    rng = np.random.default_rng(seed)
    counts = np.array([120, 48, 110, 60])
    starts = np.concatenate([[0], np.cumsum(counts)])
    waves = np.concatenate([ring(count) for count in counts])
    own = rng.normal(size=(counts.sum(), 4))
    columns = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 3], [0, 1, 2, 4]])
    shared = np.array([-1, 5, -1, 5])
    truth = rng.normal(0, 0.3, 5)
    group = np.repeat(np.arange(4), counts)
    values = np.sum(own[:, :3] * truth[:3], axis=1) + own[:, 3] * truth[3 + group % 2]
    values += rng.normal(0, noise, len(values))
    for g in range(4):
        rows = slice(starts[g], starts[g + 1])
        values[rows] += waves[rows] @ rng.normal(0, bias, 5)
    common = rng.normal(0, bias, 5)
    values[group % 2 == 1] += waves[group % 2 == 1] @ common
    values[rng.random(len(values)) < wrong] += 3.0
    base = np.where(rng.random(len(values)) < 0.1, 0.0, 1.0)
    kinds = np.array([0, 1, 0, 1])
    return Groups(own, columns, shared, kinds, starts, values, base, waves, np.full(4, bias)), truth


@pytest.mark.parametrize("bias", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_the_solver_equals_its_twin(bias: float, seed: int) -> None:
    """Eliminated group by group or written out as unknowns, the slow displacements leave the same answer."""
    groups, _ = problem(seed, bias, wrong=0.1)
    unknowns, priors = (10, 5) if bias else (5, 0)
    if not bias:
        groups = replace(groups, shared=np.full(4, -1))
    solution = solve_groups(groups, unknowns, priors)
    assert solution is not None
    delta, covariance, weights, learned = naive.solve_groups(
        groups.design, groups.columns, groups.shared, groups.starts, groups.values, groups.base, groups.waves,
        groups.bias, groups.kinds, unknowns, priors,
    )  # fmt: skip
    np.testing.assert_allclose(solution.delta[:5], delta[:5], atol=2e-5)
    np.testing.assert_allclose(solution.delta[5:], delta[5:], atol=1e-3)  # in units of their sigma
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        solution.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=2e-3
    )
    np.testing.assert_allclose(solution.weights, weights, atol=2e-3)
    np.testing.assert_allclose(solution.bias, learned, rtol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_small_kernels_equal_their_twins(seed: int) -> None:
    """Scale, weight, correlation and inverse, on smooth and on rough samples with gaps."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(30, 200))
    rough = rng.normal(0, 0.1, count)
    smooth = np.convolve(np.concatenate([rough, rough]), np.ones(5), "same")[:count]
    base = np.where(rng.random(count) < 0.2, 0.0, 1.0)
    for values in (rough, smooth, smooth + ring(count) @ rng.normal(0, 0.1, 5)):
        assert robust.robust_scale(values, base) == pytest.approx(naive.median_scale(values, base))
        assert robust.correlation_length(values, base) == pytest.approx(
            naive.correlation_length(values, base)
        )
    for ratio in (-6.0, -1.0, 0.0, 2.5, 4.684):
        assert robust.tukey_weight(ratio) == pytest.approx(float(naive.tukey_weights(np.array(ratio))))
    square = rng.normal(size=(7, 7))
    inverse = np.empty((7, 7))
    assert invert_spd(square @ square.T + 0.1 * np.eye(7), inverse)
    np.testing.assert_allclose(inverse, np.linalg.inv(square @ square.T + 0.1 * np.eye(7)), rtol=1e-8)


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


def test_a_singular_matrix_is_told() -> None:
    """Neither a rank too low nor a negative or missing diagonal is inverted."""
    inverse = np.empty((2, 2))
    for matrix in ([[1.0, 1.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, -1.0]], [[np.nan, 0.0], [0.0, 1.0]]):
        assert not invert_spd(np.array(matrix), inverse)


def test_what_nothing_determines_is_none() -> None:
    """An unknown without a sample: no solution, no exception."""
    groups, _ = problem(0)
    assert solve_groups(replace(groups, base=np.zeros_like(groups.base)), 10, 5) is None


def test_wrong_samples_are_forgotten() -> None:
    """With 20 % of the samples 30 sigma off, the answer is that of the others."""
    groups, truth = problem(1, wrong=0.2)
    solution = solve_groups(groups, 10, 5)
    assert solution is not None
    np.testing.assert_allclose(solution.delta[:5], truth, atol=0.05)


def test_the_covariance_counts_displacements() -> None:
    """Over draws of noise and of slow displacements, the squared error in its own units is 1."""
    chi2 = []
    for seed in range(120):
        groups, truth = problem(seed, bias=0.05)
        solution = solve_groups(groups, 10, 5)
        assert solution is not None
        error = solution.delta[:5] - truth
        chi2.append(float(error @ np.linalg.solve(solution.covariance[:5, :5], error)) / 5)
    assert 0.8 < np.mean(chi2) < 1.3


def test_propagation_is_the_derivative() -> None:
    """What shifts the samples as an unknown would shifts that unknown by as much, and no other."""
    groups, _ = problem(2, bias=0.05)
    solution = solve_groups(groups, 10, 5)
    assert solution is not None
    rng = np.random.default_rng(3)
    by_unknown = np.zeros((len(groups.values), 5))
    for g in range(4):
        rows = slice(groups.starts[g], groups.starts[g + 1])
        by_unknown[rows, groups.columns[g, :4]] = groups.design[rows, :4]
    mixture = rng.normal(size=(5, 2))
    gain = propagate(groups, solution, by_unknown @ mixture)
    # to what the weights changed in the last round
    np.testing.assert_allclose(gain[:5], mixture, atol=1e-3)
    np.testing.assert_allclose(gain[5:], 0.0, atol=1e-2)
