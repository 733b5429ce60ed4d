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
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.domain.robotmap import MapFigures, RobotMap, RobotShift
from edged.errors import CalibrationError, Undetermined
from edged.robot.touch import register_points

LEAST_POINTS = 12
MOST_POINTS = 100
DEGREES = (1, 2, 3)
POINTS_PER_TERM = 2
"""Half of what was touched is left to tell the noise."""
GROWN = 0.05
"""Share of its length by which the hull counts as larger: parts lie in the plane of the touched ones."""
SHAKEN = 1e-6  # of the places' length
THIN = 1e-4
"""Size of triangles, of the square of the places' length, below which their neighbours' planes stand for
them: shaking turns those of thin ones."""
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
        self._made = made
        self._normals, self._reach = _planes(places, made.hull)
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

    @cached_property
    def figures(self) -> MapFigures:
        """How it does."""
        places = self._made.expected_mm
        alone = register_points(places, self._made.shown_mm).held_out_mm
        return MapFigures(
            self._degree,
            len(places),
            _rms(alone),
            self.trial.held_out_mm,
            self.noise_mm,
            tuple(places.min(axis=0).tolist()),
            tuple(places.max(axis=0).tolist()),
        )

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
    hull = hull_of(expected_mm)
    left = shown_mm - expected_mm
    alone = MapTrial(0, _rms(alone_mm), _bic(float(np.sum(left**2)), left.size, 6))
    tried = {0: alone}
    for degree in DEGREES:
        if count >= POINTS_PER_TERM * math.comb(3 + degree, 3):
            tried[degree] = ErrorMap(RobotMap(expected_mm, shown_mm, degree, hull)).trial
    best = min(tried.values(), key=lambda trial: trial.bic)
    if best.degree and best.held_out_mm < alone.held_out_mm:
        return RobotMap(expected_mm, shown_mm, best.degree, hull), tuple(tried.values())
    return None, tuple(tried.values())


def _rms(lengths_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean(lengths_mm**2)))


def _bic(squares: float, numbers: int, parameters: int) -> float:
    # exact points leave nothing; a nanometre keeps the logarithm
    return numbers * math.log(squares / numbers + 1e-12) + parameters * math.log(numbers)


def hull_of(places: FloatArray) -> I64:
    """Triangles around all places (N, 3), as of `RobotMap`. Raises `Undetermined` for places in one plane.

    Place by place: the triangles that see it give way to others, from their rim to it. Places are shaken by a
    millionth of their length, so that no four lie in one plane (C. B. Barber et al., "The Quickhull Algorithm
    for Convex Hulls", 1996: joggled input).
    """
    shaken = places + SHAKEN * _length(places) * np.random.default_rng(0).uniform(-1, 1, places.shape)
    first, second, third = 0, 1, 2
    across = np.cross(shaken[second] - shaken[first], shaken[third] - shaken[first])
    if across @ (shaken[3] - shaken[first]) < 0.0:
        first, second = second, first
    triangles = [(first, third, second), (first, second, 3), (second, third, 3), (third, first, 3)]
    for place in range(4, len(places)):
        normals, at = _normals(shaken, np.array(triangles))
        sees = np.sum(normals * (shaken[place] - at), axis=1) > 0.0
        seen = [triangles[index] for index in np.flatnonzero(sees)]
        edges = {edge for corners in seen for edge in _edges(corners)}
        triangles = [triangles[index] for index in np.flatnonzero(~sees)]
        triangles += [(begin, end, place) for begin, end in sorted(edges) if (end, begin) not in edges]
    return np.array(triangles)


def _length(places: FloatArray) -> float:
    """The diagonal of the places. Raises `Undetermined` where they lie in one plane."""
    length = float(np.linalg.norm(np.ptp(places, axis=0)))
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if spread[2] < FLAT * spread[0] or not length:
        raise Undetermined("the points of a map lie in one plane: touch some higher, wherever parts may lie")
    return length


def _edges(corners: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    yield from zip(corners, (*corners[1:], corners[0]), strict=True)


def _normals(places: FloatArray, hull: I64) -> tuple[FloatArray, FloatArray]:
    """Normals (F, 3) of triangles, outwards, twice as long as each is large, and a corner of each."""
    first, second, third = places[hull].transpose(1, 0, 2)
    return np.cross(second - first, third - first), first


def _planes(places: FloatArray, hull: I64) -> tuple[FloatArray, FloatArray]:
    """Planes of a hull, grown by `GROWN`: normals (F, 3) outwards, and how far along them; mm.

    Each plane touches the places from outside; that they enclose them all around is asked for: each side of a
    triangle once in either sense, and no triangle within. Raises `Undetermined`.
    """
    length = _length(places)
    edges = [edge for corners in hull.tolist() for edge in _edges(tuple(corners))]
    if len(set(edges)) < len(edges) or {edge[::-1] for edge in edges} != set(edges):
        raise Undetermined("the triangles of the hull do not close around the places")
    normals, at = _normals(places, hull)
    size = np.linalg.norm(normals, axis=1)
    is_wide = size > THIN * length**2
    normals, at = normals[is_wide] / size[is_wide, None], at[is_wide]
    reach = (normals @ places.T).max(axis=1)
    if not len(normals) or float((reach - np.sum(normals * at, axis=1)).max()) > 0.1 * GROWN * length:
        raise Undetermined("places lie outside of the hull")
    return normals, reach + GROWN * length
