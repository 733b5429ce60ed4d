"""Tests if the stated sigma is honest: it is compared with a still part's scatter over many pictures.

Calibration and registration do not vary from picture to picture, so only the edges' share must cover the
scatter. Part of that share comes from effects that displace an edge equally in every picture, such as texture
beside it, a wall or the light. The scatter should therefore be what the noise of single edges causes in the
pose. A shaking part or camera, or flickering light, moves all edges at once and causes more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.curves.edgenoise import Sighting, edge_noise
from edged.vision.part.expected import Scatters

StillVerdict = Literal["honest", "larger", "smaller", "moving", "vanished"]
"""larger, smaller : the scatter, against the expected one. moving, vanished : the part; nothing is judged."""

FAR = 12.0
"""Distance in stated sigmas from its median place at which a part counts as moved."""
DRIFT = 3.0
"""Factor by which the variance exceeds that between successive pictures if a part drifts."""
COVERAGE_SIGMA = 1.96
REWEIGHED = 1.3
"""Factor, a mean over several parts, by which noise in the pose exceeds the prediction with fixed weights:
noise also has some influence on which edges count."""
LEAST_MM2 = 1e-14
"""Least variance that counts as noise: pictures without noise predict nothing."""
LEAST, MOST = 5, 200
"""Number of pictures: with fewer, the verdict is uncertain by a factor, and more take minutes."""


@dataclass(frozen=True, slots=True, eq=False)
class StillSample:
    """One measurement of the part. place_mm (3,); by_edges (3, 3) : the edges' share of its covariance.

    sightings, scatters : of its features, by name.  pose (4, 4) : rig_from_part; None if not known.
    """

    place_mm: FloatArray
    by_edges: FloatArray
    sightings: Mapping[str, Sighting] = field(default_factory=dict)
    scatters: Scatters = field(default_factory=dict)
    pose: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StillResult:
    """Result of a still test. scatter_mm, edges_mm, noise_mm (3,) : X, Y, Z; None if the part vanished.

    edges_mm : stated sigma of the edges. noise_mm : sigma explained by the noise of single edges, None if not
    known. chi2 : variance of the scatter relative to that explained by noise, or else to the stated one, mean
    of all axes. expected : interval that holds chi2 of 95 % of honest tests. covers : the stated sigma covers
    the scatter; None if not judged.
    """

    verdict: StillVerdict
    pictures: int
    scatter_mm: FloatArray | None
    edges_mm: FloatArray | None
    noise_mm: FloatArray | None
    chi2: float | None
    expected: tuple[float, float]
    covers: bool | None = None


def noises_of(stands: Sequence[StillSample]) -> dict[str, tuple[float, float]]:
    """Noise of the edges of each feature that all pictures show, where it can be estimated."""
    names = set.intersection(*(set(stand.sightings) for stand in stands)) if stands else set()
    found = {name: edge_noise([stand.sightings[name] for stand in stands]) for name in sorted(names)}
    return {name: noise for name, noise in found.items() if noise is not None}


def judged(stands: Sequence[StillSample | None], by_noise: FloatArray | None = None) -> StillResult:
    """Judge pictures, in the order they were taken; None for one in which the part was not measured.

    by_noise (3, 3) : covariance of the place explained by the noise of the edges; None if not known.
    """
    count = len(stands)
    honest = low, high = interval(3 * (count - 1))
    seen = [stand for stand in stands if stand is not None]
    if len(seen) < count or count < LEAST:
        return StillResult("vanished", count, None, None, None, None, honest)
    places = np.array([stand.place_mm for stand in seen])
    stated = np.mean([stand.by_edges for stand in seen], axis=0)
    scatter_mm, edges_mm = places.std(axis=0, ddof=1), np.sqrt(np.diag(stated))
    gaps = places - places.mean(axis=0)
    noise_mm, explained = None, stated
    if (
        by_noise is not None
        and np.isfinite(by_noise).all()
        and np.linalg.eigvalsh(by_noise).min() > LEAST_MM2
    ):
        noise_mm, explained = np.sqrt(np.diag(by_noise)), by_noise
        honest = low, REWEIGHED * high
    if _has_moved(places, stated, explained):
        return StillResult("moving", count, scatter_mm, edges_mm, noise_mm, None, honest)
    covered, chi2 = (
        _mean_square(gaps, covariance) * count / (count - 1) for covariance in (stated, explained)
    )
    covers = covered <= high
    larger = not covers or chi2 > honest[1]
    verdict: StillVerdict = "larger" if larger else "smaller" if chi2 < low else "honest"
    return StillResult(verdict, count, scatter_mm, edges_mm, noise_mm, chi2, honest, covers)


def interval(freedom: int) -> tuple[float, float]:
    """95 % interval of chi² / freedom.

    To half a percent from 12 degrees of freedom on. Source: E. B. Wilson, M. M. Hilferty, PNAS 17, 1931.

    >>> low, high = interval(87)
    >>> round(low, 2), round(high, 2)
    (0.73, 1.32)
    """
    spread = 2 / (9 * max(freedom, 1))
    low, high = ((1 - spread + side * COVERAGE_SIGMA * math.sqrt(spread)) ** 3 for side in (-1, 1))
    return max(low, 0.0), high


def _has_moved(places: FloatArray, stated: FloatArray, explained: FloatArray) -> bool:
    """Whether the part lay elsewhere in some picture, or drifted.

    A part that drifts, or was pushed once, differs less between successive pictures than over all of them
    (J. von Neumann, "Distribution of the Ratio of the Mean Square Successive Difference", 1941).
    """
    away = np.abs(places - np.median(places, axis=0))
    if (away / np.sqrt(np.diag(stated))).max() > FAR:
        return True
    whole = _mean_square(places - places.mean(axis=0), explained)
    steps = 0.5 * _mean_square(np.diff(places, axis=0), explained)
    return whole > DRIFT * steps and whole > interval(places.size - 3)[1]


def _mean_square(gaps: FloatArray, covariance: FloatArray) -> float:
    """Mean square of vectors (N, 3), in units of a covariance (3, 3), per coordinate."""
    return float(np.sum(gaps * np.linalg.solve(covariance, gaps.T).T) / gaps.size)
