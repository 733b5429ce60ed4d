"""Outlier detection with a limit that accounts for the number of values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from edged.domain.arrays import FloatArray

NORMAL_MAD = 1.4826
"""Ratio of sigma to median absolute deviation in a normal distribution."""


@dataclass(frozen=True, slots=True)
class OutlierParams:
    """Parameters of the outlier test.

    min_count : of values; with fewer, none is reported. false_alarms : share of normal sets with a reported
    one. The spread of five values is too uncertain: one would have to deviate by twenty times it to be
    reported.
    """

    min_count: int = 6
    false_alarms: float = 0.005
    draws: int = 20_000  # simulated normal sets: gives false_alarms to within a tenth
    many: int = 200  # with more values the spread is well known, and the normal quantile holds


OUTLIERS = OutlierParams()


def deviations(values: FloatArray, least_spread: float = 0.0) -> FloatArray:
    """Return the signed modified z-score: deviation of each value from the median in robust sigmas.

    values : (N,). least_spread : lower bound on the robust sigma, so that irrelevant differences are ignored.
    Returns (N,). Source: B. Iglewicz, D. C. Hoaglin, "How to Detect and Handle Outliers", 1993.
    """
    away = values - np.median(values)
    spread = max(NORMAL_MAD * float(np.median(np.abs(away))), least_spread)
    return away / spread if spread > 0 else np.where(away == 0, 0.0, np.copysign(np.inf, away))


@lru_cache(maxsize=64)
def limit(count: int, params: OutlierParams = OUTLIERS) -> float:
    """Return the deviation exceeded by the largest of `count` normal values in `false_alarms` of all sets.

    The usual 3.5 would report one of six normal values in a fifth of all sets, as their spread is itself
    random.
    """
    if count > params.many:
        return NormalDist().inv_cdf(1.0 - params.false_alarms / (2 * count))
    normal = np.random.default_rng(count).normal(size=(params.draws, count))
    away = np.abs(normal - np.median(normal, axis=1, keepdims=True))
    largest = away.max(axis=1) / (NORMAL_MAD * np.median(away, axis=1))
    return float(np.quantile(largest, 1.0 - params.false_alarms))


def outliers(values: FloatArray, least_spread: float = 0.0, params: OutlierParams = OUTLIERS) -> list[int]:
    """Return the indices of outliers, the farthest first; none for fewer than `params.min_count` values."""
    if len(values) < params.min_count:
        return []
    found = np.abs(deviations(values, least_spread))
    return [int(index) for index in np.argsort(-found) if found[index] > limit(len(values), params)]
