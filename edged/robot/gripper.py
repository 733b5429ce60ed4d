"""Collision tests of a tool's body with zones and other parts: pure functions of oriented boxes.

For another part only the measured features are known: its body is the box around them, in its own frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Slot3D, Target
from edged.domain.picking import Box, Gripper
from edged.robot.orientations import matrix_fixed_xyz
from edged.vision.geometry.rigid import transform

PARALLEL = 1e-9
"""Sine below which the edges of two boxes are parallel: their cross product separates nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """Oriented box. centre_mm (3,); axes (3, 3) : unit, in columns; half_mm (3,) : half-size along each."""

    centre_mm: FloatArray
    axes: FloatArray
    half_mm: FloatArray

    def moved(self, pose: FloatArray) -> Solid:
        """Return the box moved by pose (4, 4)."""
        return Solid(pose[:3, :3] @ self.centre_mm + pose[:3, 3], pose[:3, :3] @ self.axes, self.half_mm)


def solid_of(box: Box) -> Solid:
    """Convert a box along the axes of its frame to a `Solid`."""
    low, high = np.array(box.min_mm), np.array(box.max_mm)
    return Solid((low + high) / 2, np.eye(3), (high - low) / 2)


def flange_from_tip(gripper: Gripper) -> FloatArray:
    """Pose (4, 4) of the tool's tip on the flange."""
    return transform(matrix_fixed_xyz(*gripper.tip_rad), np.array(gripper.tip_mm))


def swept(gripper: Gripper, along_mm: float) -> Iterator[Solid]:
    """Boxes of the body in the tip's frame, extended along -z over the straight approach and retreat."""
    for box in gripper.boxes:
        x_mm, y_mm, z_mm = box.min_mm
        yield solid_of(Box(box.name, (x_mm, y_mm, z_mm - along_mm), box.max_mm))


def any_meet(some: Iterable[Solid], others: Sequence[Solid]) -> bool:
    """Whether any of the first boxes intersects any of the others: no axis separates them.

    Source: S. Gottschalk, M. C. Lin, D. Manocha, "OBBTree", SIGGRAPH 1996, section 5 (15 axes).
    """
    first = list(some)
    if not first or not others:
        return False
    own, theirs = (np.array([solid.axes.T for solid in solids]) for solids in (first, others))
    own, theirs = own[:, np.newaxis], theirs[np.newaxis]
    edges = np.cross(own[..., np.newaxis, :], theirs[..., np.newaxis, :, :])
    pairs = edges.shape[:2]
    axes = np.concatenate(
        [np.broadcast_to(faces, (*pairs, 3, 3)) for faces in (own, theirs)] + [edges.reshape(*pairs, 9, 3)], 2
    )
    reach = _reach(axes, own, np.array([solid.half_mm for solid in first])[:, np.newaxis])
    reach += _reach(axes, theirs, np.array([solid.half_mm for solid in others])[np.newaxis])
    apart = np.array([[other.centre_mm - solid.centre_mm for other in others] for solid in first])
    gap = np.abs(np.einsum("mnai,mni->mna", axes, apart))
    separates = (gap > reach) & (np.linalg.norm(axes, axis=3) >= PARALLEL)
    return not bool(separates.any(axis=2).all())


def _reach(axes: FloatArray, own: FloatArray, half_mm: FloatArray) -> FloatArray:
    """Half the extent of each box, projected on each axis."""
    return np.asarray(
        np.einsum(
            "mnak,mnk->mna",
            np.abs(axes @ own.swapaxes(-1, -2)),
            np.broadcast_to(half_mm, (*axes.shape[:2], 3)),
        )
    )


def body_of(target: Target) -> Solid | None:
    """Box around the measured features of a part, rig frame; None if there are none."""
    pose = target.rig_from_part
    points = [point for point in _outermost(target) if np.isfinite(point).all()]
    if not points or not np.isfinite(pose).all():
        return None
    own = (np.array(points) - pose[:3, 3]) @ pose[:3, :3]
    low, high = own.min(axis=0), own.max(axis=0)
    return Solid((low + high) / 2, np.eye(3), (high - low) / 2).moved(pose)


def _outermost(target: Target) -> Iterator[FloatArray]:
    """Points around each feature, rig frame."""
    for circle in target.circles:
        yield from _around_circle(circle, target.rig_from_part)
    for edge in target.edges:
        yield from (edge.start_mm, edge.end_mm)
    for slot in target.slots:
        yield from _around_slot(slot, target.rig_from_part)
    for corner in target.corners:
        yield corner.position_mm


def _around_circle(circle: Circle3D, rig_from_part: FloatArray) -> Iterator[FloatArray]:
    """Ends of the circle's diameters along the part's x and y."""
    for axis in rig_from_part[:3, :2].T:
        yield circle.centre_mm + circle.radius_mm * axis
        yield circle.centre_mm - circle.radius_mm * axis


def _around_slot(slot: Slot3D, rig_from_part: FloatArray) -> Iterator[FloatArray]:
    """Corners of the rectangle around the slot."""
    across = np.cross(rig_from_part[:3, 2], slot.direction)
    for along, aside in itertools.product((-0.5, 0.5), repeat=2):
        yield slot.centre_mm + along * slot.length_mm * slot.direction + aside * slot.width_mm * across
