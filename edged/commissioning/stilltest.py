"""Is the sigma honest? A part that lies still, measured again and again: its scatter against what is stated.

Calibration and registration do not scatter from picture to picture, so it is the edges' share alone that is
held against the scatter. What displaces an edge alike in every picture, texture beside it and the light, is
in that share, too, and lies as still as the part: of parts with much of it the scatter is the smaller one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain.arrays import FloatArray

StillVerdict = Literal["honest", "larger", "smaller", "moving", "vanished"]
"""larger, smaller : the scatter than the stated sigma. moving, vanished : the part did: nothing is judged."""

MOVED_PX = 1.0
"""A part that lies still is seen there, to much less than this."""
DRIFT = 3.0
"""By what factor the variance exceeds that from one picture to the next, of a part that moves on."""
COVERAGE_SIGMA = 1.96
LEAST, MOST = 5, 200
"""Pictures: with fewer the verdict is open to a factor, and more take minutes."""


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """A picture of the part. place_mm (3,); by_edges (3, 3) : of its covariance.  at_px (2,) : its match."""

    place_mm: FloatArray
    by_edges: FloatArray
    at_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Stillness:
    """What came of it. scatter_mm, edges_mm (3,) : X, Y, Z; None where the part vanished.

    chi2 : scatter over stated variance, mean of all axes; expected : where 19 of 20 honest ones lie.
    """

    verdict: StillVerdict
    pictures: int
    scatter_mm: FloatArray | None
    edges_mm: FloatArray | None
    chi2: float | None
    expected: tuple[float, float]


def judged(stands: Sequence[Stand | None]) -> Stillness:
    """The verdict over pictures, in the order they were taken; None: the part was not measured in it."""
    count = len(stands)
    expected = interval(3 * (count - 1))
    seen = [one for one in stands if one is not None]
    if len(seen) < count or count < LEAST:
        return Stillness("vanished", count, None, None, None, expected)
    places = np.array([one.place_mm for one in seen])
    stated = np.mean([one.by_edges for one in seen], axis=0)
    scatter_mm, edges_mm = places.std(axis=0, ddof=1), np.sqrt(np.diag(stated))
    if _has_moved(seen, places, stated):
        return Stillness("moving", count, scatter_mm, edges_mm, None, expected)
    chi2 = _mean_square(places - places.mean(axis=0), stated) * count / (count - 1)
    low, high = expected
    verdict: StillVerdict = "larger" if chi2 > high else "smaller" if chi2 < low else "honest"
    return Stillness(verdict, count, scatter_mm, edges_mm, chi2, expected)


def interval(freedom: int) -> tuple[float, float]:
    """Where chi² / freedom lies in 95 of 100 cases.

    To half a percent from 12 degrees on. Source: E. B. Wilson, M. M. Hilferty, PNAS 17, 1931.

    >>> low, high = interval(87)
    >>> round(low, 2), round(high, 2)
    (0.72, 1.32)
    """
    spread = 2 / (9 * max(freedom, 1))
    low, high = ((1 - spread + side * COVERAGE_SIGMA * math.sqrt(spread)) ** 3 for side in (-1, 1))
    return max(low, 0.0), high


def _has_moved(stands: Sequence[Stand], places: FloatArray, stated: FloatArray) -> bool:
    """Whether the part lay elsewhere in some picture, or went on little by little.

    From picture to picture a part that drifts, or was pushed once, differs by less than over all of them
    (J. von Neumann, "Distribution of the Ratio of the Mean Square Successive Difference", 1941).
    """
    at = np.array([one.at_px for one in stands])
    if float(np.linalg.norm(at - np.median(at, axis=0), axis=1).max()) > MOVED_PX:
        return True
    whole = _mean_square(places - places.mean(axis=0), stated)
    steps = 0.5 * _mean_square(np.diff(places, axis=0), stated)
    return whole > DRIFT * steps and whole > interval(3 * (len(stands) - 1))[1]


def _mean_square(gaps: FloatArray, covariance: FloatArray) -> float:
    """Of vectors (N, 3), in units of a covariance (3, 3), by degree of freedom."""
    return float(np.sum(gaps * np.linalg.solve(covariance, gaps.T).T) / gaps.size)
