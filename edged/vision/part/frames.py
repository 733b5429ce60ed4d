"""Features and sizes of a face in the rig frame, with their covariances."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Corner3D, Edge3D, Measurement, Slot3D, Target
from edged.vision.curves.outlines import PLANE_PARAMETERS, SIZES, Curve, Face
from edged.vision.curves.planefit import CurveFit, PlaneFit, derived
from edged.vision.part.job import Job, MeasurementSpec, angle_of_lines

_PLACE_AND_RADIUS = np.ix_([0, 1, 2, 6], [0, 1, 2, 6])  # of (7, 7): without the rotation, 3 to 5


@dataclass(frozen=True, slots=True, eq=False)
class FoundCircle:
    """A circle in the rig frame, with the fit it comes from.

    pose_covariance (6, 6) : of its centre (mm) and of the rotation of its plane (rad, rig axes), without a
    rotation about the normal.
    """

    circle: Circle3D
    pose_covariance: FloatArray
    fit: CurveFit


def circle_in_rig(fit: PlaneFit, name: str) -> FoundCircle | None:
    """The circle of this name in a fit, rig frame; None if it was not measured."""
    return next((found for found in _circles(fit) if found.circle.name == name), None)


def circles_in_rig(fit: PlaneFit) -> list[FoundCircle]:
    """All circles of a fit in the rig frame, in the order of the fit."""
    return list(_circles(fit))


@lru_cache(maxsize=4)  # called repeatedly while one part is measured
def by_edges_alone(fit: PlaneFit) -> PlaneFit:
    """`PlaneFit.by_edges`, cached."""
    return fit.by_edges()


@lru_cache(maxsize=4)
def _circles(fit: PlaneFit) -> tuple[FoundCircle, ...]:
    circles = [found for found in fit.fits if found.curve.kind == "circle"]
    if not circles:
        return ()
    sizes = [SIZES[found.curve.kind] for found in fit.fits]
    places = itertools.accumulate(sizes, initial=PLANE_PARAMETERS)
    firsts = [first for found, first in zip(fit.fits, places, strict=False) if found.curve.kind == "circle"]
    x, y, radius = np.array([found.curve.parameters for found in circles]).T
    height = np.array([found.curve.height_mm for found in circles])
    face, where = fit.face, np.array([[0, 1, 2, first, first + 1, first + 2] for first in firsts])
    u, v, n = face.axes
    # derivatives by the plane's height and slopes, x, y, radius; as it tilts, points above it move sideways
    lift = np.zeros((len(circles), 7, 6))
    lift[:, :3, 0], lift[:, :3, 3], lift[:, :3, 4] = n, u, v
    lift[:, :3, 1] = x[:, None] * n - height[:, None] * u
    lift[:, :3, 2] = y[:, None] * n - height[:, None] * v
    lift[:, 3:6, 1], lift[:, 3:6, 2] = -v, u
    lift[:, 6, 5] = 1.0
    known = fit.covariance[where[:, :, None], where[:, None, :]]
    covariances = lift @ known @ lift.transpose(0, 2, 1)
    places_mm = np.empty((len(circles), 3))
    places_mm[:, 0], places_mm[:, 1], places_mm[:, 2] = x, y, height
    centres = face.to_rig(places_mm)
    normal = n if n[2] < 0 else -n
    own = covariances[(slice(None), *_PLACE_AND_RADIUS)]
    each = zip(circles, centres, radius.tolist(), own, covariances, strict=True)
    return tuple(
        [
            FoundCircle(Circle3D(found.curve.name, centre, normal, size, small), whole[:6, :6], found)
            for found, centre, size, small, whole in each
        ]
    )


def with_features(target: Target, job: Job, fit: PlaneFit) -> Target:
    """The target with the edges, slots and corners that were measured."""
    by_name = {fitted.curve.name: fitted.curve for fitted in fit.fits}
    corners = [_corner_in_rig(job, fit, corner.name) for corner in job.corners]
    return replace(
        target,
        edges=tuple(_edge_in_rig(fit, by_name[edge.name]) for edge in job.edges if edge.name in by_name),
        slots=tuple(_slot_in_rig(fit, by_name[slot.name]) for slot in job.slots if slot.name in by_name),
        corners=tuple(corner for corner in corners if corner is not None),
    )


def _corner_in_rig(job: Job, fit: PlaneFit, name: str) -> Corner3D | None:
    point = place(job, fit, name)
    if point is None:
        return None
    edges = next(corner.edges for corner in job.corners if corner.name == name)
    position, covariance = derived(
        fit, lambda parameters: lifted(fit.face, parameters, point(parameters)), edges
    )
    height = next(edge.curve.height_mm for edge in fit.fits if edge.name in edges)
    return Corner3D(name, position + height * fit.face.normal, covariance)


def _edge_in_rig(fit: PlaneFit, curve: Curve) -> Edge3D:
    where = fit.place(curve.name)
    x, y, _ = curve.parameters
    half = 0.5 * curve.length_mm * curve.direction
    middle, half = np.array([x, y, curve.height_mm]), np.append(half, 0.0)
    start, end = fit.face.to_rig(np.stack([middle - half, middle + half]))
    lift = curve.lift().T  # its rows are orthonormal: back to shift and angle
    return Edge3D(curve.name, start, end, lift @ fit.covariance[where, where] @ lift.T)


def _slot_in_rig(fit: PlaneFit, curve: Curve) -> Slot3D:
    where = fit.place(curve.name)
    face = fit.face

    def numbers(parameters: FloatArray) -> FloatArray:
        x, y, _, length, width = parameters[where]
        return np.append(lifted(face, parameters, np.array([x, y])), [length, width])

    values, covariance = derived(fit, numbers)
    centre = values[:3] + curve.height_mm * face.normal
    direction = curve.direction @ face.axes[:2]
    return Slot3D(curve.name, centre, direction, float(values[3]), float(values[4]), covariance)


def lifted(face: Face, parameters: FloatArray, point: FloatArray) -> FloatArray:
    """(3,) rig frame: a point of the face, by the parameters of its plane."""
    height, slope_u, slope_v = parameters[:PLANE_PARAMETERS]
    return face.to_rig(np.array([*point, height + slope_u * point[0] + slope_v * point[1]]))


Size = Callable[[FloatArray], float]
"""A size as a function of the parameters of a `PlaneFit`."""
SEPARATE_KINDS = ("height", "flatness")
"""Kinds of measurement that are taken separately, not from the joint fit of the curves."""
Place = Callable[[FloatArray], FloatArray]


def measure_sizes(job: Job, fit: PlaneFit | None, circles: Sequence[Circle3D]) -> tuple[Measurement, ...]:
    """All measurements of a job but the `SEPARATE_KINDS`, in its order; NaN where features were not seen."""
    by_name = {circle.name: circle for circle in circles}
    return tuple(
        _measured(job, spec, fit, by_name) for spec in job.measurements if spec.kind not in SEPARATE_KINDS
    )


def as_measurement(spec: MeasurementSpec, value: float, sigma: float) -> Measurement:
    """A measured size in display units: angles in degrees."""
    unit, scale = ("deg", math.degrees(1)) if spec.kind == "angle" else ("mm", 1.0)
    nominal = None if spec.nominal is None else spec.nominal * scale
    tolerance = None if spec.tolerance is None else spec.tolerance * scale
    return Measurement(spec.name, spec.kind, unit, value * scale, sigma * scale, nominal, tolerance)


def _measured(
    job: Job, spec: MeasurementSpec, fit: PlaneFit | None, circles: dict[str, Circle3D]
) -> Measurement:
    if spec.kind == "radius" and spec.of[0] in circles:
        circle = circles[spec.of[0]]
        return as_measurement(spec, circle.radius_mm, circle.sigma_radius_mm)
    size = None if fit is None else _size(job, spec, fit)
    if fit is None or size is None:
        return as_measurement(spec, math.nan, math.nan)
    values, covariance = derived(fit, lambda parameters: np.array([size(parameters)]))
    return as_measurement(spec, float(values[0]), float(np.sqrt(covariance[0, 0])))


def _size(job: Job, spec: MeasurementSpec, fit: PlaneFit) -> Size | None:
    """The size as a function of the fit's parameters; None when a feature is missing."""
    if spec.kind in ("radius", "width", "length"):
        where = fit.place(spec.of[0])
        column = {"radius": 2, "length": 3, "width": 4}[spec.kind]
        return None if where is None else lambda p: float(p[where][column])
    if spec.kind == "angle":
        line, other = (fit.place(name) for name in spec.of)
        if line is None or other is None:
            return None
        return lambda p: angle_of_lines(float(p[other][2] - p[line][2]), spec.nominal)
    first, second = (place(job, fit, name) for name in spec.of)
    if first is None or second is None:
        return None
    lines = [fit.place(name) for name in spec.of if job.kind_of(name) == "edge"]
    if not lines or lines[0] is None:
        return lambda p: float(np.linalg.norm(second(p) - first(p)))
    return lambda p: _across(p[lines[0]], second(p) - first(p))


def place(job: Job, fit: PlaneFit, name: str) -> Place | None:
    """A feature's place in the face, (2,), as a function of the fit's parameters; None if it is missing."""
    corner = next((corner for corner in job.corners if corner.name == name), None)
    if corner is None:
        where = fit.place(name)
        return None if where is None else lambda p: np.asarray(p[where][:2])
    first, second = (fit.place(edge) for edge in corner.edges)
    if first is None or second is None:
        return None
    return lambda p: _meet(p[first], p[second])


def _meet(first: FloatArray, second: FloatArray) -> FloatArray:
    """Intersection (2,) of two edges (x, y, angle)."""
    normals = np.array([[-math.sin(edge[2]), math.cos(edge[2])] for edge in (first, second)])
    offsets = np.array([normals[0] @ first[:2], normals[1] @ second[:2]])
    return np.asarray(np.linalg.solve(normals, offsets))


def _across(edge: FloatArray, gap: FloatArray) -> float:
    return float(abs(gap @ (-math.sin(edge[2]), math.cos(edge[2]))))
