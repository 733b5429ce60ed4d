"""The joint solver: equal to its twin, ignores wrong samples, states true covariances."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.adjustments import problem, solve
from naive import curves as naive

from edged.vision.curves.adjustment import propagate


@pytest.mark.parametrize("bias", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_the_solver_equals_its_twin(bias: float, seed: int) -> None:
    """Eliminated curve by curve or solved as unknowns, the systematic shifts give the same answer."""
    samples, _ = problem(seed, bias, wrong=0.1)
    unknowns, priors = (10, 5) if bias else (5, 0)
    if not bias:
        none = np.zeros((len(samples.values), 0))
        samples = samples._replace(shared=np.full(4, -1), waves=none, families=np.zeros(0, np.int64))
    solution = solve(samples, unknowns, priors)
    assert solution is not None
    delta, covariance, weights, learned = naive.solve(samples, unknowns, priors)
    np.testing.assert_allclose(solution.delta[:5], delta[:5], atol=2e-5)
    np.testing.assert_allclose(solution.delta[5:], delta[5:], atol=1e-3)  # in units of their sigma
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        solution.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=2e-3
    )
    np.testing.assert_allclose(solution.weights, weights, atol=2e-3)
    np.testing.assert_allclose(solution.bias, learned, rtol=1e-3)


def test_what_is_wrong_in_one_part_of_a_pair_is_wrong_in_the_other() -> None:
    """Samples with a wrong difference between the cameras get no weight in the mean, either."""
    samples, _ = problem(5)
    values = samples.values.copy()
    values[130:140] += 2.0  # the second part of the first curve
    solution = solve(samples._replace(values=values, base=np.ones_like(samples.base)), 10, 5)
    assert solution is not None
    assert (solution.weights[10:20] == 0).all()
    assert (solution.weights[130:140] == 0).all()
    assert solution.weights[20:120].min() >= 0 < np.median(solution.weights[20:120])


def test_what_nothing_determines_is_none() -> None:
    """An unknown without a sample gives no solution and no exception."""
    samples, _ = problem(0)
    assert solve(samples._replace(base=np.zeros_like(samples.base)), 10, 5) is None


def test_wrong_samples_are_forgotten() -> None:
    """With 20 % of the samples off by 30 sigma, the answer is that of the others."""
    samples, truth = problem(1, wrong=0.2)
    solution = solve(samples, 10, 5)
    assert solution is not None
    np.testing.assert_allclose(solution.delta[:5], truth, atol=0.05)


def test_the_covariance_counts_displacements() -> None:
    """Over draws of noise and of systematic shifts, the squared error in units of its covariance is 1."""
    chi2 = []
    for seed in range(120):
        samples, truth = problem(seed, bias=0.05)
        solution = solve(samples, 10, 5)
        assert solution is not None
        error = solution.delta[:5] - truth
        chi2.append(float(error @ np.linalg.solve(solution.covariance[:5, :5], error)) / 5)
    assert 0.8 < np.mean(chi2) < 1.3


def test_propagation_is_the_derivative() -> None:
    """A change of the samples as by one unknown changes this unknown by as much, and no other."""
    samples, _ = problem(2, bias=0.05)
    solution = solve(samples, 10, 5)
    assert solution is not None
    rng = np.random.default_rng(3)
    by_unknown = np.zeros((len(samples.values), 5))
    for k in range(4):
        rows = slice(*samples.starts[samples.parts[k : k + 2]])
        by_unknown[rows, samples.columns[k, :4]] = samples.design[rows, :4]
    mixture = rng.normal(size=(5, 2))
    gain = propagate(samples, solution, by_unknown @ mixture)
    # to what the weights changed in the last round, and to what neighbours differ by
    np.testing.assert_allclose(gain[:5], mixture, atol=2e-2)
    np.testing.assert_allclose(gain[5:], 0.0, atol=0.3)  # in units of a small sigma
