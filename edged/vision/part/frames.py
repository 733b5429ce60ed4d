"""Features of a face in the rig frame, with the covariance that they have there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edged.domain import Corner3D, Edge3D, FloatArray, Slot3D, Target
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face
from edged.vision.curves.planefit import PlaneFit, derived
from edged.vision.part.job import Job
from edged.vision.part.sizes import place


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
    position, covariance = derived(fit, lambda parameters: lifted(fit.face, parameters, point(parameters)))
    return Corner3D(name, position, covariance)


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
