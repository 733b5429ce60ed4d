"""A map of the robot's error: a low-order field over the places that its tip touched.

A robot repeats itself to 0.02 to 0.05 mm and is off by 0.1 to 0.5 mm, by lengths and offsets of its axes that
are not as its controller has them: smooth over its reach. With e the place that the registration gives and s
what the robot shows there, s - e = f(e) + noise, f a polynomial in each coordinate. The map is part of the
registration that it was fitted beside: it takes up what that one's few points left wrong, too.

The degree is the one of least BIC (G. Schwarz, "Estimating the Dimension of a Model", 1978), none among them,
and it must foretell points that were left out better than the registration alone does.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.robotmap import RobotMap, RobotShift
from edged.errors import CalibrationError, Undetermined

LEAST_POINTS = 12
MOST_POINTS = 100
"""The hull of more takes seconds."""
DEGREES = (1, 2, 3)
POINTS_PER_TERM = 2
"""Half of what was touched is left to tell the noise."""
GROWN = 0.05
"""Share of its length by which the hull counts as larger: parts lie in the plane of the touched ones."""
FLAT = 0.05
"""Least thickness of the touched places, of their length: across it nothing would be known."""


@dataclass(frozen=True, slots=True)
class MapTrial:
    """How well a degree does; 0: the registration alone. held_out_mm : rms over points that were left out."""

    degree: int
    held_out_mm: float
    bic: float


class ErrorMap:
    """A map that is ready to be asked. Raises `CalibrationError` for points that determine none."""

    def __init__(self, made: RobotMap) -> None:
        places = np.asarray(made.expected_mm, np.float64)
        self._normals, self._reach = _hull(places)
        self._middle, self._scale = places.mean(axis=0), float(np.ptp(places, axis=0).max())
        self._degree = made.degree
        rows = self._rows(places)
        if not made.degree or len(places) < POINTS_PER_TERM * rows.shape[1]:
            raise CalibrationError(
                f"{len(places)} points, {POINTS_PER_TERM * rows.shape[1]} are needed for degree {made.degree}"
            )
        orthogonal, upper = np.linalg.qr(rows)
        if np.linalg.cond(upper) > 1e6:
            raise Undetermined("the points do not determine a map: touch them in all corners")
        self._to_terms = np.linalg.inv(upper)
        self._terms = self._to_terms @ orthogonal.T @ (made.shown_mm - places)
        left = made.shown_mm - places - rows @ self._terms
        kept = 1.0 - np.sum(orthogonal**2, axis=1)
        self.held_out_mm = np.asarray(np.linalg.norm(left, axis=1) / kept)
        freedom = 3 * (len(places) - rows.shape[1])
        # what is left of a point is less by what it drew the map to itself; few points: Student's t
        variance = float(np.mean(np.sum(left**2, axis=1) / kept)) / 3.0
        self.noise_mm = math.sqrt(variance * freedom / (freedom - 2))
        self.trial = MapTrial(
            made.degree, _rms(self.held_out_mm), _bic(float(np.sum(left**2)), left.size, 3 * rows.shape[1])
        )

    def at(self, place_mm: FloatArray) -> RobotShift | None:
        """The shift at a place (3,) by the registration; None beyond the touched ones."""
        if not bool(np.all(self._normals @ place_mm <= self._reach)):
            return None
        row = self._rows(place_mm[None])[0]
        return RobotShift(row @ self._terms, self.noise_mm * (row @ self._to_terms), self.noise_mm)

    def _rows(self, places: FloatArray) -> FloatArray:
        """(N, M) products of coordinates up to the degree."""
        own = (places - self._middle) / self._scale
        columns = [np.ones(len(own))]
        for degree in range(1, self._degree + 1):
            every = itertools.combinations_with_replacement(range(3), degree)
            columns.extend(np.prod(own[:, axes], axis=1) for axes in every)
        return np.column_stack(columns)


@lru_cache(maxsize=4)  # by identity: a map is asked for each part
def error_map(made: RobotMap) -> ErrorMap:
    """The map, ready to be asked. Raises `CalibrationError`."""
    return ErrorMap(made)


def map_of(
    expected_mm: FloatArray, shown_mm: FloatArray, alone_mm: FloatArray
) -> tuple[RobotMap | None, tuple[MapTrial, ...]]:
    """The map that earns its place, if one does, and how each degree did, the registration alone first.

    alone_mm (N,) : how far points are from the registration of all others. Raises `CalibrationError`.
    """
    count = len(expected_mm)
    if not LEAST_POINTS <= count <= MOST_POINTS:
        raise CalibrationError(
            f"{count} points: a map of the robot's error needs {LEAST_POINTS} to {MOST_POINTS}"
        )
    left = shown_mm - expected_mm
    alone = MapTrial(0, _rms(alone_mm), _bic(float(np.sum(left**2)), left.size, 6))
    tried = {0: alone}
    for degree in DEGREES:
        if count >= POINTS_PER_TERM * math.comb(3 + degree, 3):
            tried[degree] = ErrorMap(RobotMap(expected_mm, shown_mm, degree)).trial
    best = min(tried.values(), key=lambda trial: trial.bic)
    if best.degree and best.held_out_mm < alone.held_out_mm:
        return RobotMap(expected_mm, shown_mm, best.degree), tuple(tried.values())
    return None, tuple(tried.values())


def _rms(lengths_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(lengths_mm**2)))


def _bic(squares: float, numbers: int, parameters: int) -> float:
    # exact points leave nothing; a nanometre keeps the logarithm
    return numbers * math.log(squares / numbers + 1e-12) + parameters * math.log(numbers)


def _hull(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Planes around all places, grown by `GROWN`: normals (F, 3) outwards, and how far along them; mm."""
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    length = float(np.linalg.norm(np.ptp(places, axis=0)))
    if spread[2] < FLAT * spread[0] or not length:
        raise Undetermined("the points of a map lie in one plane: touch some higher, wherever parts may lie")
    normals, reach = [], []
    for first, second in itertools.combinations(range(len(places) - 1), 2):
        across = np.cross(places[second] - places[first], places[second + 1 :] - places[first])
        size = np.linalg.norm(across, axis=1)
        across = across[size > 1e-9 * length**2] / size[size > 1e-9 * length**2, None]
        along = across @ (places - places[first]).T
        for sign in (1.0, -1.0):
            outer = (sign * along <= 1e-9 * length).all(axis=1)
            normals.extend(sign * across[outer])
            reach.extend(sign * across[outer] @ places[first])
    planes = np.unique(np.round(np.column_stack([normals, reach]), 9), axis=0)
    return planes[:, :3], planes[:, 3] + GROWN * length
