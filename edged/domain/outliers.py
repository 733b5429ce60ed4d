"""The one among many that differs more than chance makes one of so many differ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from edged.domain.arrays import FloatArray

NORMAL_MAD = 1.4826
"""Sigma of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, slots=True)
class OutlierParams:
    """min_count : of values; with fewer none is named. false_alarms : share of normal sets with a named one.

    Of five values the spread tells too little: one must lie twenty times it apart to be named.
    """

    min_count: int = 6
    false_alarms: float = 0.005
    draws: int = 20_000  # of sets of normal values: false_alarms is known to a tenth
    many: int = 200  # of more values the spread is known, and the normal distribution's own quantile holds


OUTLIERS = OutlierParams()


def deviations(values: FloatArray, least_spread: float = 0.0) -> FloatArray:
    """How far each value lies from the median, in robust sigmas: the modified z-score, with its sign.

    values : (N,). least_spread : a sigma below which the spread does not count: smaller differences matter to
    nobody. Returns (N,). Source: B. Iglewicz, D. C. Hoaglin, "How to Detect and Handle Outliers", 1993.
    """
    away = values - np.median(values)
    spread = max(NORMAL_MAD * float(np.median(np.abs(away))), least_spread)
    return away / spread if spread > 0 else np.where(away == 0, 0.0, np.copysign(np.inf, away))


@lru_cache(maxsize=64)
def limit(count: int, params: OutlierParams = OUTLIERS) -> float:
    """The deviation that the largest of so many normal values exceeds in `params.false_alarms` of all sets.

    The usual 3.5 names one of six normal values in a fifth of all sets: their spread is itself a chance.
    """
    if count > params.many:
        return NormalDist().inv_cdf(1.0 - params.false_alarms / (2 * count))
    normal = np.random.default_rng(count).normal(size=(params.draws, count))
    away = np.abs(normal - np.median(normal, axis=1, keepdims=True))
    largest = away.max(axis=1) / (NORMAL_MAD * np.median(away, axis=1))
    return float(np.quantile(largest, 1.0 - params.false_alarms))


def outliers(values: FloatArray, least_spread: float = 0.0, params: OutlierParams = OUTLIERS) -> list[int]:
    """Indices of the values that differ, the farthest first; none of fewer than `params.min_count`."""
    if len(values) < params.min_count:
        return []
    found = np.abs(deviations(values, least_spread))
    return [int(index) for index in np.argsort(-found) if found[index] > limit(len(values), params)]
