"""Flat parts with broken rims: a ring between face and wall, as bright as light and viewpoint make it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.sim.render.scene import Disc, Hole, PaintedMark, Part, PolygonShape, Surface
from edged.vision.geometry.camera import StereoRig
from helpers.cells import pictures, scene
from helpers.flatparts import METAL

RIM_MM, HOLES = 13.0, (("bore", -4.0, 3.0, 3.0), ("pin", 6.0, 4.0, 1.5), ("odd", 2.0, -7.0, 2.0))
DARK, FACE = 0.1, METAL.albedo
WALL = Surface(albedo=DARK)


def half_disc(x_mm: float, y_mm: float, radius_mm: float, side_rad: float) -> PolygonShape:
    """Half of a circle, on the side that faces the direction `side_rad`."""
    phase = side_rad + np.linspace(-0.5 * math.pi, 0.5 * math.pi, 90)
    return PolygonShape(
        tuple((x_mm + radius_mm * math.cos(a), y_mm + radius_mm * math.sin(a)) for a in phase)
    )


def parts(break_mm: float, light: FloatArray, side_rad: float) -> tuple[Part, Part]:
    """Body and face of a disc with three holes.

    light (2,) : albedo of the breaks on the side that faces `side_rad`, and of the others.
    """
    body = Part(
        "body",
        Disc(0, 0, RIM_MM),
        Surface(albedo=float(light[1])),
        marks=(PaintedMark(half_disc(0, 0, RIM_MM - 0.01, side_rad), float(light[0])),),
    )
    rings: list[PaintedMark] = []
    for _, x, y, radius in HOLES:
        # in a hole, the opposite side faces the light
        rings.append(PaintedMark(Disc(x, y, radius + break_mm), float(light[0])))
        rings.append(PaintedMark(half_disc(x, y, radius + break_mm, side_rad), float(light[1])))
    holes = tuple(Hole(name, Disc(x, y, radius), 0.1) for name, x, y, radius in HOLES)
    return body, Part("face", Disc(0, 0, RIM_MM - break_mm), METAL, holes, tuple(rings))


def pair_of(
    rig: StereoRig,
    where: FloatArray,
    break_mm: float,
    lights: FloatArray,
    side_rad: float = 0.0,
    seed: int = 7,
) -> tuple[Image, Image]:
    """Both pictures of the part.  lights (2, 2) : for the left and the right camera, each as in `parts`."""
    lower = where.copy()
    lower[:3, 3] += break_mm * where[:3, 2]
    seen = []
    for light in lights:
        body, face = parts(break_mm, light, side_rad)
        seen.append(pictures(rig, scene((body, lower), (face, where), table=replace(WALL, albedo=0.1)), seed))
    return seen[0][0], seen[1][1]
