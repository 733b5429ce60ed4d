"""Parts tilted from the bisector of the cameras, thin and thick, with exact truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.sim.render.scene import Part, PlacedPart, Scene, Surface, Table
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import about_z, cross, invert, rotation_matrix, transform, unit
from helpers.cells import PLACE_MM, TEXTURED, pose

BELOW_MM = 24.0
"""Depth of the table below PLACE_MM, so that no part tilted by 45° cuts into it."""


def lying(
    rig: StereoRig,
    tilt_deg: float,
    side_deg: float,
    turn_deg: float,
    place_mm: tuple[float, float, float] = PLACE_MM,
) -> FloatArray:
    """rig_from_part of a face turned about its normal, then tilted away from the cameras' bisector."""
    place = np.array(place_mm)
    z = -unit(unit(-place) + unit(invert(rig.right_from_left)[:3, 3] - place))
    x = unit(cross(np.array([0.0, 1.0, 0.0]), z))
    y = cross(z, x)
    side = math.radians(side_deg)
    tilt = rotation_matrix(math.radians(tilt_deg) * (math.cos(side) * x + math.sin(side) * y))
    return transform(tilt @ np.column_stack([x, y, z]) @ about_z(math.radians(turn_deg)), place)


def thin(part: Part, where: FloatArray) -> Scene:
    """The part alone over a table."""
    return Scene(_table(), (PlacedPart(part, where),))


def thick(part: Part, where: FloatArray, thickness_mm: float, wall: Surface, slices: int = 24) -> Scene:
    """The part with walls along its outline and its holes, over a table."""
    return Scene(_table(), tuple(stacked(part, where, thickness_mm, wall, slices)))


def stacked(
    part: Part, where: FloatArray, thickness_mm: float, wall: Surface, slices: int = 24
) -> list[PlacedPart]:
    """Thin copies of a part stacked along its normal, lowest first: its walls, then the part itself."""
    clear = tuple(replace(hole, transmission=1.0) for hole in part.holes)
    below = replace(part, surface=wall, holes=clear)
    layers = []
    for depth_mm in np.linspace(thickness_mm, 0.0, slices + 1)[:-1]:
        down = np.eye(4)
        down[2, 3] = depth_mm
        layers.append(PlacedPart(below, where @ down))
    return [*layers, PlacedPart(replace(part, holes=clear), where)]


def _table() -> Table:
    return Table(TEXTURED, pose((PLACE_MM[0], PLACE_MM[1], PLACE_MM[2] + BELOW_MM)))
