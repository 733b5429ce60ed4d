"""Parts that only one detail keeps from looking the same after a rotation, for the decisions bench.

Each comes whole and without its detail (`plain`). The difference of the two pictures is the detail, and shows
how much of it an object in front hides. About 26 mm across, light or dark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from edged.sim.render.scene import (
    Disc,
    Hole,
    PaintedMark,
    Part,
    PolygonShape,
    RoundedBox,
    Shape,
    Slot,
    Surface,
)

HOLE = 0.05
"""Share of the table's light that comes back out of a hole, which is mostly in shadow."""
GROOVE_MM, GROOVE = 0.9, 0.07
"""Pitch of the grooves of a turned face, and the relative darkening of every second one."""
LAY = Surface(1.0, contrast=0.2, feature_mm=0.35, stretch=12.0)
"""The coarse texture of a machined face, by light along it."""
LAYS = {
    "ground": replace(LAY, lay_rad=math.radians(10.0)),
    "faced": replace(LAY, around_mm=(0.0, 0.0)),
    "milled": replace(LAY, around_mm=(45.0, 20.0)),
}
"""Straight, in rings about the middle, and in arcs about a point beside the part."""


@dataclass(frozen=True, slots=True)
class Design:
    """Geometry of a part, in mm.

    shapes : openings.  cuts : shapes cut off the outline.  detail : decides the part's orientation; an
    opening, or a mark or a cut, depending on `kind`.  replaced : shapes in its place if the part were
    symmetric. folds : of that symmetry.
    """

    name: str
    outline: Shape
    folds: int
    shapes: tuple[Shape, ...]
    detail: tuple[Shape, ...] = ()
    replaced: tuple[Shape, ...] = ()
    cuts: tuple[Shape, ...] = ()
    kind: Literal["opening", "mark", "cut"] = "opening"

    def part(self, albedo: float, finish: str, piece: int = 0) -> Part:
        """The part with its detail; piece : number that determines its scratches."""
        return self._made(self.detail, self.kind, albedo, finish, piece)

    def plain(self, albedo: float, finish: str, piece: int = 0) -> Part:
        """The part without its detail."""
        return self._made(self.replaced, "opening", albedo, finish, piece)

    def _made(self, own: tuple[Shape, ...], kind: str, albedo: float, finish: str, piece: int) -> Part:
        surface = Surface(albedo)
        if finish in LAYS:
            surface = replace(LAYS[finish], albedo=albedo, seed=100 + piece)
        if finish == "brushed":
            surface = Surface(albedo, contrast=0.1, feature_mm=0.35, stretch=6.0, seed=1)
        marks = self._grooves(albedo) if finish == "turned" else ()
        holes = [Hole("opening", shape, HOLE) for shape in self.shapes]
        cuts = [Hole("cut", shape, 1.0) for shape in self.cuts]  # not part of it: all light is the table's
        if kind == "mark":
            marks = (*marks, *(PaintedMark(shape, 0.35 * albedo) for shape in own))
        elif kind == "cut":
            cuts += [Hole("cut", shape, 1.0) for shape in own]
        else:
            holes += [Hole("opening", shape, HOLE) for shape in own]
        return Part(self.name, self.outline, surface, (*holes, *cuts), marks)

    def _grooves(self, albedo: float) -> tuple[PaintedMark, ...]:
        """Rings of two shades, from the rim inwards."""
        radius = self.inner_radius_mm - 0.6
        count = int((radius - 1.0) / GROOVE_MM)
        return tuple(
            PaintedMark(Disc(0.0, 0.0, radius - k * GROOVE_MM), albedo * (1 - GROOVE * ((k + 1) % 2)))
            for k in range(count)
        )

    @property
    def inner_radius_mm(self) -> float:
        """Radius of the largest disc about the middle within the outline."""
        match self.outline:
            case Disc():
                return self.outline.radius_mm
            case RoundedBox():
                return 0.5 * min(self.outline.width_mm, self.outline.height_mm)
            case PolygonShape():
                points = np.array(self.outline.points_mm)
                along = np.roll(points, -1, axis=0) - points
                share = np.clip(-(points * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
                return float(np.linalg.norm(points + share[:, None] * along, axis=1).min())
            case _:
                raise ValueError(f"no grooves on {self.outline}")

    @property
    def radius_mm(self) -> float:
        """Radius of the smallest disc about the middle that holds the part."""
        match self.outline:
            case Disc():
                return self.outline.radius_mm
            case RoundedBox():
                return 0.5 * math.hypot(self.outline.width_mm, self.outline.height_mm)
            case PolygonShape():
                return max(math.hypot(x, y) for x, y in self.outline.points_mm)
            case _:
                raise ValueError(f"no radius of {self.outline}")

    @property
    def places_mm(self) -> tuple[tuple[float, float], ...]:
        """Points that a job may take as its reference: centres, ends and corners."""
        places: list[tuple[float, float]] = []
        for shape in (self.outline, *self.shapes, *self.detail):
            match shape:
                case Disc() | Slot():
                    places.append((shape.x_mm, shape.y_mm))
                case PolygonShape():
                    places += shape.points_mm
                case RoundedBox():
                    c, s = math.cos(shape.angle_rad), math.sin(shape.angle_rad)
                    for a, b in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
                        x, y = a * shape.width_mm, b * shape.height_mm
                        places.append((shape.x_mm + c * x - s * y, shape.y_mm + s * x + c * y))
                case _:
                    raise ValueError(f"no places of {shape}")
        return tuple(places)


def _ring(count: int, at_mm: float, radius_mm: float, phase: float = 0.0) -> list[Shape]:
    turns = phase + np.arange(count) * (2 * math.pi / count)
    return [Disc(at_mm * math.cos(t), at_mm * math.sin(t), radius_mm) for t in turns]


def _regular(count: int, radius_mm: float) -> tuple[tuple[float, float], ...]:
    turns = (np.arange(count) + 0.5) * (2 * math.pi / count)
    return tuple((radius_mm * math.cos(t), radius_mm * math.sin(t)) for t in turns)


def _gaps(teeth: int, radius_mm: float, depth_mm: float) -> tuple[Shape, ...]:
    """Gaps between the teeth of a gear."""
    turns = np.arange(teeth) * (2 * math.pi / teeth)
    width_mm = math.pi * radius_mm / teeth
    return tuple(
        RoundedBox(
            radius_mm * math.cos(t), radius_mm * math.sin(t), 2 * depth_mm, width_mm, angle_rad=float(t)
        )
        for t in turns
    )


def _letter_f(x_mm: float, y_mm: float, height_mm: float) -> PolygonShape:
    k = height_mm / 5
    points = ((0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (2.4, 2), (2.4, 3), (1, 3), (1, 5), (0, 5))
    return PolygonShape(tuple((x_mm + k * (x - 1.5), y_mm + k * (y - 2.5)) for x, y in points))


_BORE = Disc(0.0, 0.0, 4.0)
_FOUR = _ring(4, 9.0, 1.5, math.pi / 4)
_SIX = _ring(6, 9.0, 1.4)
_FIVE = _ring(5, 9.0, 1.4)

DESIGNS = (
    Design("slot disc", Disc(0, 0, 13), 4, (_BORE, *_FOUR), (Slot(8.5, 0, 4.0, 1.6),)),
    Design("small hole", Disc(0, 0, 13), 6, (_BORE, *_SIX[1:]), (Disc(9.0, 0, 0.9),), (_SIX[0],)),
    Design("missing hole", Disc(0, 0, 13), 5, (_BORE, *_FIVE[1:]), (), (_FIVE[0],)),
    Design("shifted hole", Disc(0, 0, 13), 4, (_BORE, *_FOUR[1:]), (Disc(7.6, 4.9, 1.5),), (_FOUR[0],)),
    Design("keyway", Disc(0, 0, 13), 6, (_BORE, *_SIX), (RoundedBox(4.2, 0, 2.6, 2.0),)),
    Design("gear", Disc(0, 0, 13), 16, (Disc(0, 0, 5.0),), (RoundedBox(5.4, 0, 3.0, 2.2),), (),
           _gaps(16, 13.0, 1.8)),
    Design("notched rim", Disc(0, 0, 13), 4, (_BORE, *_FOUR), (RoundedBox(13, 0, 3.2, 2.8),), kind="cut"),
    Design("flattened rim", Disc(0, 0, 13), 6, (_BORE, *_SIX), (RoundedBox(16.6, 0, 10, 26),), kind="cut"),
    Design("letter", Disc(0, 0, 13), 4, (_BORE, *_FOUR), (_letter_f(8.6, 0, 4.0),), kind="mark"),
    Design("three slots", Disc(0, 0, 13), 3, (
        _BORE,
        *(Slot(8 * math.cos(t), 8 * math.sin(t), 6.0, 2.0, t + math.pi / 2) for t in (2.0944, 4.1888)),
    ), (Slot(8, 0, 4.4, 2.0, math.pi / 2),), (Slot(8, 0, 6.0, 2.0, math.pi / 2),)),
    Design("cut corner", RoundedBox(0, 0, 18, 18), 4, (_BORE, *_ring(4, 8.4, 1.3, math.pi / 4)),
           (RoundedBox(9, 9, 3.6, 3.6, angle_rad=math.pi / 4),), kind="cut"),
    Design("long plate", RoundedBox(0, 0, 25, 14, 1.0), 2, (Disc(-8.5, 0, 2.0),), (Disc(8.5, 0, 1.5),),
           (Disc(8.5, 0, 2.0),)),
    Design("hexagon", PolygonShape(_regular(6, 13)), 6, (_BORE,), (RoundedBox(4.2, 0, 2.6, 2.0),)),
    Design("square slots", RoundedBox(0, 0, 19, 19, 1.5), 4, (
        Slot(-6, 0, 7, 2, math.pi / 2), Slot(0, 6, 7, 2), Slot(0, -6, 7, 2),
    ), (Slot(6, 0, 4.5, 2, math.pi / 2),), (Slot(6, 0, 7, 2, math.pi / 2),)),
    Design("notched flange", Disc(0, 0, 13), 6, (_BORE, *_SIX), (Disc(7.8, 4.5, 0.7),), (),
           (RoundedBox(13, 0, 2.4, 2.0),)),
    Design("pinned cover", Disc(0, 0, 13), 5, (*_ring(5, 9.6, 1.2), Disc(0, 0, 2.5)), (Disc(0, 5.6, 0.8),)),
    Design("keyed plate", RoundedBox(0, 0, 19, 19, 2.0), 4,
           (*_ring(4, 9.0, 1.2, math.pi / 4), Disc(0, 0, 3.5)),
           (RoundedBox(0, 3.8, 1.8, 2.2),)),
)  # fmt: skip
HELD_OUT = ("pinned cover", "keyed plate")
"""Evaluated last: no choice was based on their results."""


def without_holes(part: Part) -> Part:
    """The part's silhouette, white and without holes."""
    cuts = tuple(hole for hole in part.holes if hole.transmission == 1.0)
    return replace(part, surface=Surface(1.0), holes=cuts, marks=())
