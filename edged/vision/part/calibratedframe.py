"""A part measured by corrected cameras, in the calibrated rig's frame and with the correction's uncertainty.

The cameras' displacement is known with a covariance; for fixed pictures, a displacement moves each point of
the part linearly (`geometry.correction`). This is propagated into all covariances of the part: errors of both
cameras that cancel at the part cancel there, too.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Corner3D, Edge3D, Measurement, Reject, Slot3D, Target
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.correction import RigCorrection, shift_by_displacement
from edged.vision.geometry.rigid import apply, skew
from edged.vision.geometry.uncertainty import shifted_pose_covariance
from edged.vision.part.consistency import vaguest_mm
from edged.vision.part.job import Job
from edged.vision.part.points import points_of, rim_of

Feature = TypeVar("Feature", Circle3D, Slot3D, Corner3D)


def in_calibrated_frame(job: Job, target: Target, rig: StereoRig, correction: RigCorrection) -> Target:
    """The target in the calibrated rig's frame; rejected where the correction leaves it too uncertain.

    target : in the frame of the left camera as it is now. rig : as calibrated.
    """
    target = moved(target, correction.world_from_left(rig))
    target = _widened(target, rig, correction)
    limit_mm = job.limits.max_sigma_mm
    sigmas = [vaguest_mm(job, target)]
    if target.reported is not None:
        sigmas.append(math.sqrt(float(np.diag(target.reported.covariance)[:3].max())))
    vague = not max(sigmas) <= limit_mm
    return replace(target, reject=target.reject | (Reject.SIGMA_LIMIT if vague else Reject.NONE))


def moved(target: Target, to_from_rig: FloatArray) -> Target:
    """The target in another frame, by to_from_rig (4, 4); it has no grasp and no offset yet."""
    R = to_from_rig[:3, :3]
    reported = target.reported
    if reported is not None:
        reported = replace(
            reported,
            rig_from_part=to_from_rig @ reported.rig_from_part,
            covariance=_turned(reported.covariance, R, 2),
            by_edges=None if reported.by_edges is None else _turned(reported.by_edges, R, 2),
        )
    return replace(
        target,
        rig_from_part=to_from_rig @ target.rig_from_part,
        covariance=_turned(target.covariance, R, 2),
        by_edges=None if target.by_edges is None else _turned(target.by_edges, R, 2),
        by_doubt=_turned(target.by_doubt, R, 2),
        circles=tuple(_placed(circle, to_from_rig, "centre_mm", "normal") for circle in target.circles),
        edges=tuple(
            replace(edge, start_mm=apply(to_from_rig, edge.start_mm), end_mm=apply(to_from_rig, edge.end_mm))
            for edge in target.edges
        ),
        slots=tuple(_placed(slot, to_from_rig, "centre_mm", "direction") for slot in target.slots),
        corners=tuple(_placed(corner, to_from_rig, "position_mm") for corner in target.corners),
        free_axis=None if target.free_axis is None else R @ target.free_axis,
        rig_from_model=None if target.rig_from_model is None else to_from_rig @ target.rig_from_model,
        reported=reported,
    )


def _placed(feature: Feature, to_from_rig: FloatArray, point: str, *directions: str) -> Feature:
    """The feature in another frame; point, directions : names of its attributes to be transformed."""
    R = to_from_rig[:3, :3]
    changed = {name: R @ getattr(feature, name) for name in directions}
    changed[point] = apply(to_from_rig, getattr(feature, point))
    return replace(feature, covariance=_turned(feature.covariance, R), **changed)


def _turned(covariance: FloatArray, R: FloatArray, vectors: int = 1) -> FloatArray:
    """A covariance in rotated axes; its first rows are those of this many vectors in space."""
    jacobian = np.eye(len(covariance))
    for start in range(0, 3 * vectors, 3):
        jacobian[start : start + 3, start : start + 3] = R
    with np.errstate(invalid="ignore", over="ignore"):  # unknown entries stay NaN
        return np.asarray(jacobian @ covariance @ jacobian.T)


def _widened(target: Target, rig: StereoRig, correction: RigCorrection) -> Target:
    """The target with the covariance of the correction propagated into all of its covariances."""
    place = target.position_mm
    points = points_of(target)
    if len(points) < 3:
        points = place + _TRIPOD_MM @ target.rig_from_part[:3, :3].T
    corners = [corner.position_mm for corner in target.corners]
    shifts = shift_by_displacement(rig, correction, np.concatenate([points, *(c[None] for c in corners)]))
    arms = points - place
    design = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -skew(arms), arms[:, :, None]], axis=2
    )
    motion = np.linalg.lstsq(
        design.reshape(-1, 7), shifts[: len(points)].reshape(3 * len(points), -1), rcond=None
    )[0]
    P = correction.covariance
    by_marks = motion[:6] @ P @ motion[:6].T
    growth = float(motion[6] @ P @ motion[6])
    reported = target.reported
    if reported is not None:
        arm = reported.rig_from_part[:3, 3] - place
        added = shifted_pose_covariance(by_marks, arm)
        reported = replace(reported, covariance=reported.covariance + added)
    rims, ends = shifts[: 8 * len(target.circles)], shifts[8 * len(target.circles) : len(points)]
    of_edges, of_slots = ends[: 2 * len(target.edges)], ends[2 * len(target.edges) :]
    normal = target.rig_from_part[:3, 2]
    return replace(
        target,
        covariance=target.covariance + by_marks,
        by_marks=by_marks,
        reported=reported,
        circles=tuple(_circle(circle, rims[8 * k : 8 * k + 8], P) for k, circle in enumerate(target.circles)),
        edges=tuple(
            _edge(edge, normal, of_edges[2 * k : 2 * k + 2], P) for k, edge in enumerate(target.edges)
        ),
        slots=tuple(_slot(slot, of_slots[2 * k : 2 * k + 2], P) for k, slot in enumerate(target.slots)),
        corners=tuple(
            _corner(corner, shift, P)
            for corner, shift in zip(target.corners, shifts[len(points) :], strict=True)
        ),
        measurements=tuple(_size(size, growth) for size in target.measurements),
    )


_TRIPOD_MM = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
"""Points used for a part that has fewer than three of its own: any part of some size turns as they do."""


def _circle(circle: Circle3D, shifts: FloatArray, P: FloatArray) -> Circle3D:
    """The circle with the correction's covariance P.  shifts (8, 3, 14) : of points on its rim."""
    radial = (rim_of(circle) - circle.centre_mm) / circle.radius_mm
    motion = np.concatenate([shifts.mean(axis=0), np.einsum("ni,nij->j", radial, shifts)[None] / len(radial)])
    return replace(circle, covariance=circle.covariance + motion @ P @ motion.T)


def _edge(edge: Edge3D, normal: FloatArray, shifts: FloatArray, P: FloatArray) -> Edge3D:
    """The edge with the correction's covariance P.  shifts (2, 3, 14) : of its ends."""
    along = edge.end_mm - edge.start_mm
    length = float(np.linalg.norm(along))
    across = np.cross(normal, along / length)
    motion = np.stack([across @ shifts.mean(axis=0), across @ (shifts[1] - shifts[0]) / length])
    return replace(edge, covariance=edge.covariance + motion @ P @ motion.T)


def _slot(slot: Slot3D, shifts: FloatArray, P: FloatArray) -> Slot3D:
    """The slot with the correction's covariance P; its width is taken to grow as its length does.

    shifts (2, 3, 14) : of its ends, first the one along its direction.
    """
    length = slot.direction @ (shifts[0] - shifts[1])
    motion = np.stack([*shifts.mean(axis=0), length, length * slot.width_mm / slot.length_mm])
    return replace(slot, covariance=slot.covariance + motion @ P @ motion.T)


def _corner(corner: Corner3D, shift: FloatArray, P: FloatArray) -> Corner3D:
    return replace(corner, covariance=corner.covariance + shift @ P @ shift.T)


def _size(size: Measurement, growth: float) -> Measurement:
    """The size with the correction's uncertainty.  growth : relative variance of the part's size."""
    if size.unit != "mm":
        return size
    return replace(size, sigma=math.sqrt(size.sigma**2 + growth * size.value**2))
