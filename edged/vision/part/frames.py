"""Features of a face in the rig frame, with the covariance that they have there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Corner3D, Edge3D, Slot3D, Target
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face
from edged.vision.curves.planefit import CurveFit, PlaneFit, derived
from edged.vision.part.job import Job
from edged.vision.part.sizes import place

_PLACE_AND_RADIUS = np.ix_([0, 1, 2, 6], [0, 1, 2, 6])


@dataclass(frozen=True, slots=True, eq=False)
class FoundCircle:
    """A circle in the rig frame, and the edges it stands on.

    pose_covariance (6, 6) : of its centre (mm) and of the rotation of its plane (rad, rig axes), in which
    nothing turns about the normal.
    """

    circle: Circle3D
    pose_covariance: FloatArray
    fit: CurveFit


def circle_in_rig(fit: PlaneFit, name: str) -> FoundCircle | None:
    """A circle of a fit in the rig frame; None when it was not measured."""
    one, where = fit.fit_of(name), fit.place(name)
    if one is None or where is None:
        return None
    x, y, radius = one.curve.parameters
    height, face = one.curve.height_mm, fit.face
    u, v, n = face.axes
    # by height and slopes of the plane, x, y, radius: as the plane tilts, what stands on it moves sideways
    lift = np.zeros((7, 6))
    lift[:3, 0], lift[:3, 1], lift[:3, 2] = n, x * n - height * u, y * n - height * v
    lift[:3, 3], lift[:3, 4] = u, v
    lift[3:6, 1], lift[3:6, 2] = -v, u
    lift[6, 5] = 1.0
    plane, known = slice(0, PLANE_PARAMETERS), np.empty((6, 6))
    known[:3, :3], known[:3, 3:] = fit.covariance[plane, plane], fit.covariance[plane, where]
    known[3:, :3], known[3:, 3:] = fit.covariance[where, plane], fit.covariance[where, where]
    covariance = lift @ known @ lift.T
    circle = Circle3D(
        name,
        face.to_rig(np.array([[x, y, height]]))[0],
        n if n[2] < 0 else -n,
        float(radius),
        covariance[_PLACE_AND_RADIUS],
    )
    return FoundCircle(circle, covariance[:6, :6], one)


def circles_in_rig(fit: PlaneFit) -> list[FoundCircle]:
    """All circles of a fit, in its order."""
    found = (circle_in_rig(fit, one.name) for one in fit.fits if one.curve.kind == "circle")
    return [one for one in found if one is not None]


def with_features(target: Target, job: Job, fit: PlaneFit) -> Target:
    """The target with the edges, slots and corners that were measured."""
    by_name = {one.curve.name: one.curve for one in fit.fits}
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
    height = next(one.curve.height_mm for one in fit.fits if one.name in edges)
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
