"""Points of a measured part, wide enough apart to fix its pose."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Target

AROUND = np.array([(math.cos(t), math.sin(t)) for t in np.arange(8) * math.pi / 4])
"""(8, 2) points on the unit circle: enough that it matters little where the first one lies."""


def rim_of(circle: Circle3D) -> FloatArray:
    """Points (8, 3) around a circle, rig frame."""
    across = np.linalg.svd(circle.normal[None])[2][1:]
    return np.asarray(circle.centre_mm + circle.radius_mm * AROUND @ across)


def points_of(target: Target) -> FloatArray:
    """Points (N, 3) on a part's circles, edges and slots, rig frame."""
    points: list[FloatArray] = []
    for circle in target.circles:
        points += [*rim_of(circle)]
    for edge in target.edges:
        points += [edge.start_mm, edge.end_mm]
    for slot in target.slots:
        points += [slot.centre_mm + sign * 0.5 * slot.length_mm * slot.direction for sign in (1, -1)]
    return np.array(points).reshape(-1, 3)
