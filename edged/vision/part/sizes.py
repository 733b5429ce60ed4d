"""Sizes of a part: radius, distance, angle, width and length, from curves measured together in its face."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Measurement
from edged.vision.curves.planefit import PlaneFit, derived
from edged.vision.part.job import Job, MeasurementSpec, angle_of_lines

Size = Callable[[FloatArray], float]
"""Of the parameters of a `PlaneFit`."""
APART = ("height", "flatness")
"""What is measured by itself, not from the curves together."""
Place = Callable[[FloatArray], FloatArray]


def measure_sizes(job: Job, fit: PlaneFit | None, circles: Sequence[Circle3D]) -> tuple[Measurement, ...]:
    """Every measurement of a job but those `APART`, in its order; NaN where its features were not seen."""
    by_name = {circle.name: circle for circle in circles}
    return tuple(_measured(job, spec, fit, by_name) for spec in job.measurements if spec.kind not in APART)


def as_measurement(spec: MeasurementSpec, value: float, sigma: float) -> Measurement:
    """A measured size in the units for people: angles in degrees."""
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
        one, two = (fit.place(name) for name in spec.of)
        if one is None or two is None:
            return None
        return lambda p: angle_of_lines(float(p[two][2] - p[one][2]), spec.nominal)
    first, second = (place(job, fit, name) for name in spec.of)
    if first is None or second is None:
        return None
    lines = [fit.place(name) for name in spec.of if job.kind_of(name) == "edge"]
    if not lines or lines[0] is None:
        return lambda p: float(np.linalg.norm(second(p) - first(p)))
    return lambda p: _across(p[lines[0]], second(p) - first(p))


def place(job: Job, fit: PlaneFit, name: str) -> Place | None:
    """Where a feature lies in the face, (2,), by the fit's parameters; None if it is missing."""
    corner = next((corner for corner in job.corners if corner.name == name), None)
    if corner is None:
        where = fit.place(name)
        return None if where is None else lambda p: np.asarray(p[where][:2])
    one, two = (fit.place(edge) for edge in corner.edges)
    if one is None or two is None:
        return None
    return lambda p: _meet(p[one], p[two])


def _meet(one: FloatArray, two: FloatArray) -> FloatArray:
    """(2,) where two edges (x, y, angle) meet."""
    normals = np.array([[-math.sin(edge[2]), math.cos(edge[2])] for edge in (one, two)])
    offsets = np.array([normals[0] @ one[:2], normals[1] @ two[:2]])
    return np.asarray(np.linalg.solve(normals, offsets))


def _across(edge: FloatArray, gap: FloatArray) -> float:
    return float(abs(gap @ (-math.sin(edge[2]), math.cos(edge[2]))))
