"""Map of the robot's error: a low-order polynomial field over the places that its tip touched.

A robot repeats itself to 0.02 to 0.05 mm but is off by 0.1 to 0.5 mm, because lengths and offsets of its axes
differ from those in its controller; this error is smooth over its reach. With e the place that the
registration gives and s what the robot shows there, s - e = f(e) + noise, f a polynomial for each coordinate.
The map belongs to the registration that it was fitted to: it also absorbs the error left by that one's few
points.

The degree is chosen by the lowest BIC (G. Schwarz, "Estimating the Dimension of a Model", 1978), with no map
as one candidate, and the map must predict left-out points better than the registration alone does.
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
"""Least number of points per polynomial term: half of the data is left to estimate the noise."""
GROWN = 0.05
"""Share of its length by which the hull is enlarged: parts may lie in the plane of the touched points."""
SHAKEN = 1e-6  # jitter, as a share of the places' length
THIN = 1e-4
"""Triangles whose doubled area is below this share of the squared length of the places are left out, and the
planes of their neighbours bound the hull there: jitter tilts the planes of thin triangles."""
FLAT = 0.05
"""Least thickness of the touched places, as a share of their length: a thinner set says nothing across."""


@dataclass(frozen=True, slots=True)
class MapFit:
    """Quality of one degree; 0: the registration alone. held_out_mm : rms over points that were left out."""

    degree: int
    held_out_mm: float
    bic: float


class ErrorMap:
    """Fitted map of the robot's error. Raises `CalibrationError` for points that do not determine one."""

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
        # a point's residual is too small by its own pull on the fit (leverage); few points: Student's t
        variance = float(np.mean(np.sum(left**2, axis=1) / kept)) / 3.0
        self.noise_mm = math.sqrt(variance * freedom / (freedom - 2))
        self.trial = MapFit(
            made.degree, _rms(self.held_out_mm), _bic(float(np.sum(left**2)), left.size, 3 * rows.shape[1])
        )

    def at(self, place_mm: FloatArray) -> RobotShift | None:
        """Shift at a place (3,) that the registration gives; None outside of the touched region."""
        if not bool(np.all(self._normals @ place_mm <= self._reach)):
            return None
        row = self._rows(place_mm[None])[0]
        return RobotShift(row @ self._terms, self.noise_mm * (row @ self._to_terms), self.noise_mm)

    @cached_property
    def figures(self) -> MapFigures:
        """Quality figures of the map."""
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
        """Polynomial terms (N, M): products of normalised coordinates up to the degree."""
        own = (places - self._middle) / self._scale
        columns = [np.ones(len(own))]
        for degree in range(1, self._degree + 1):
            every = itertools.combinations_with_replacement(range(3), degree)
            columns.extend(np.prod(own[:, axes], axis=1) for axes in every)
        return np.column_stack(columns)


@lru_cache(maxsize=4)  # by identity: a map is evaluated for each part
def error_map(made: RobotMap) -> ErrorMap:
    """Fit the map, or return the cached one. Raises `CalibrationError`."""
    return ErrorMap(made)


def fit_map(
    expected_mm: FloatArray, shown_mm: FloatArray, alone_mm: FloatArray
) -> tuple[RobotMap | None, tuple[MapFit, ...]]:
    """Best map, None if none improves on the registration alone, and all trials, the one without a map first.

    alone_mm (N,) : distance of each point from the registration by all others. Raises `CalibrationError`.
    """
    count = len(expected_mm)
    if not LEAST_POINTS <= count <= MOST_POINTS:
        raise CalibrationError(
            f"{count} points: a map of the robot's error needs {LEAST_POINTS} to {MOST_POINTS}"
        )
    hull = hull_of(expected_mm)
    left = shown_mm - expected_mm
    alone = MapFit(0, _rms(alone_mm), _bic(float(np.sum(left**2)), left.size, 6))
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
    # exact points leave no residual; a nanometre keeps the logarithm finite
    return numbers * math.log(squares / numbers + 1e-12) + parameters * math.log(numbers)


def hull_of(places: FloatArray) -> I64:
    """Triangles of the convex hull of places (N, 3), as in `RobotMap`. Raises `Undetermined` if coplanar.

    Incremental: for each new place, the triangles that face it are replaced by ones from their rim to it.
    Places are jittered by a millionth of their length, so that no four lie in one plane (C. B. Barber et al.,
    "The Quickhull Algorithm for Convex Hulls", 1996: joggled input).
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
    """Diagonal of the bounding box of the places. Raises `Undetermined` if they lie in one plane."""
    length = float(np.linalg.norm(np.ptp(places, axis=0)))
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if spread[2] < FLAT * spread[0] or not length:
        raise Undetermined("the points of a map lie in one plane: touch some higher, wherever parts may lie")
    return length


def _edges(corners: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    yield from zip(corners, (*corners[1:], corners[0]), strict=True)


def _normals(places: FloatArray, hull: I64) -> tuple[FloatArray, FloatArray]:
    """Outward normals (F, 3) of triangles, with length twice the area, and one corner of each."""
    first, second, third = places[hull].transpose(1, 0, 2)
    return np.cross(second - first, third - first), first


def _planes(places: FloatArray, hull: I64) -> tuple[FloatArray, FloatArray]:
    """Planes of a hull, enlarged by `GROWN`: outward normals (F, 3), and distances along them in mm.

    Each plane touches the places from outside. The hull must be closed: each edge occurs once in either
    direction, and no triangle lies inside. Raises `Undetermined`.
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
