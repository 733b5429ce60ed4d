"""Random machined parts: outlines, their walls and broken edges, as triangles.

A part is a tree of walls. Each wall stands upright on a closed outline of lines and arcs, between the two
level faces that it joins; inside of it is material (the base, a boss) or none (a hole, a pocket). Its upper
edge is sharp, or broken by a chamfer of 45 degrees or a rounding. Frames and units are those of
data/rendered: mm, z = 0 is the base's upper face, z points into the part: a boss stands at negative z.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

from edged.domain.arrays import FloatArray
from edged.vision.teaching.cadmodel import CadModel, FlatSurface, RoundSurface, Surface, welded

SAGITTA_MM, LINE_MM = 6e-4, 0.8
"""Maximum deviation of chords from arcs, and length of the pieces of lines, which the lens bends."""
ROUND_STEPS = 8
CLEAR_MM = 1.5
"""Least distance of two outlines on one face: more than two breaks, and more than the pieces of lines, so
that the triangles of a face end at its outlines."""
TRIES = 60
UP = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class Outline:
    """A closed curve, counter-clockwise in x and y.

    corners (N) : where its sides meet.  centres (N) : of the side from corner k to the next; None for a line.
    Arcs turn counter-clockwise.
    """

    corners: tuple[tuple[float, float], ...]
    centres: tuple[tuple[float, float] | None, ...]

    def offset(self, grow_mm: float) -> Outline:
        """The curve moved outwards by a distance on all sides, with as many corners."""
        before = [self._tangent(k - 1, at_end=True) for k in range(len(self.corners))]
        after = [self._tangent(k, at_end=False) for k in range(len(self.corners))]
        corners = [self._moved(k, before[k], after[k], grow_mm) for k in range(len(self.corners))]
        return Outline(tuple(corners), self.centres)

    def _tangent(self, side: int, *, at_end: bool) -> FloatArray:
        start, end = (np.array(self.corners[(side + k) % len(self.corners)]) for k in (0, 1))
        centre = self.centres[side]
        if centre is None:
            return np.asarray((end - start) / np.linalg.norm(end - start))
        x, y = (end if at_end else start) - centre
        return np.array([-y, x]) / math.hypot(x, y)

    def _moved(self, k: int, before: FloatArray, after: FloatArray, grow_mm: float) -> tuple[float, float]:
        """Corner k of the curve moved outwards by grow_mm."""
        corner, outward = np.array(self.corners[k]), np.array([[a[1], -a[0]] for a in (before, after)])
        if abs(before[0] * after[1] - before[1] * after[0]) < 1e-6:
            return tuple((corner + grow_mm * outward[0]).tolist())
        sides = (self.centres[k - 1], self.centres[k])
        if sides == (None, None):
            return tuple((corner + np.linalg.solve(outward, [grow_mm, grow_mm])).tolist())
        line, centre = (0, sides[1]) if sides[0] is None else (1, sides[0])
        assert sides[line] is None and centre is not None
        along, foot = (before, after)[line], corner + grow_mm * outward[line] - centre
        radius = float(np.linalg.norm(corner - centre)) + grow_mm
        half = math.sqrt(radius**2 - float(foot @ outward[line]) ** 2)
        ends = [centre + (foot @ outward[line]) * outward[line] + sign * half * along for sign in (-1, 1)]
        return tuple(min(ends, key=lambda end: float(np.linalg.norm(end - corner))).tolist())

    def radius(self, side: int) -> float:
        """Radius of an arc."""
        return float(np.linalg.norm(np.subtract(self.corners[side], self.centres[side])))

    def pieces(self) -> tuple[int, ...]:
        """Number of chords into which each side is divided."""
        counts = []
        for side, centre in enumerate(self.centres):
            if centre is None:
                ends = self.corners[side], self.corners[(side + 1) % len(self.corners)]
                counts.append(max(1, math.ceil(math.dist(*ends) / LINE_MM)))
            else:
                chord = 2 * math.acos(1 - SAGITTA_MM / self.radius(side))
                counts.append(max(2, math.ceil(self.angles(side)[1] / chord)))
        return tuple(counts)

    def angles(self, side: int) -> tuple[float, float]:
        """Start angle of an arc, and the angle that it turns, rad."""
        centre = np.array(self.centres[side])
        start, end = (np.array(self.corners[(side + k) % len(self.corners)]) - centre for k in (0, 1))
        first = math.atan2(start[1], start[0])
        return first, (math.atan2(end[1], end[0]) - first) % math.tau or math.tau

    def points(self, pieces: Sequence[int]) -> FloatArray:
        """Points (M, 2) along the curve, each side in a number of pieces, without its end point."""
        found = []
        for side, (centre, count) in enumerate(zip(self.centres, pieces, strict=True)):
            share = np.arange(count)[:, None] / count
            if centre is None:
                start, end = (np.array(self.corners[(side + k) % len(self.corners)]) for k in (0, 1))
                found.append(start + share * (end - start))
            else:
                first, turn = self.angles(side)
                angle = first + share * turn
                found.append(np.array(centre) + self.radius(side) * np.hstack([np.cos(angle), np.sin(angle)]))
        return np.concatenate(found)


def circle(x: float, y: float, radius: float) -> Outline:
    """A circle of two half circles."""
    return Outline(((x + radius, y), (x - radius, y)), ((x, y), (x, y)))


def polygon(points: Sequence[tuple[float, float]]) -> Outline:
    """Straight sides between points that turn from x to y."""
    return Outline(tuple(points), (None,) * len(points))


def box(x: float, y: float, width: float, height: float, corner: float) -> Outline:
    """A rectangle with round corners; corner 0 for sharp ones, half the height for a slot."""
    w, h = 0.5 * width, 0.5 * height
    if corner == 0:
        return polygon([(x - w, y - h), (x + w, y - h), (x + w, y + h), (x - w, y + h)])
    corners: list[tuple[float, float]] = []
    centres: list[tuple[float, float] | None] = []
    for sx, sy in ((1, -1), (1, 1), (-1, 1), (-1, -1)):
        centre = (x + sx * (w - corner), y + sy * (h - corner))
        ends = [(centre[0], y + sy * h), (x + sx * w, centre[1])]
        corners += ends if sx == -sy else ends[::-1]
        centres += [centre, None]
    kept = [k for k in range(8) if math.dist(corners[k], corners[(k + 1) % 8]) > 1e-9]
    return Outline(tuple(corners[k] for k in kept), tuple(centres[k] for k in kept))


def flattened(radius: float, flat: float) -> Outline:
    """A disc about the origin with one side cut straight at x = flat."""
    y = math.sqrt(radius**2 - flat**2)
    return Outline(((flat, y), (-radius, 0.0), (flat, -y)), ((0.0, 0.0), (0.0, 0.0), None))


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright wall between the levels top and bottom (z, mm; top is the smaller).

    parent : number of the wall on whose inner face it stands; -1 of the base.  solid : material is inside.
    break_mm : of its upper edge.  form : "chamfer" or "round".
    """

    name: str
    outline: Outline
    parent: int
    solid: bool
    top: float
    bottom: float
    break_mm: float = 0.0
    form: str = "chamfer"

    def profile(self, *, nominal: bool) -> list[tuple[float, float]]:
        """Offsets of the outline, outwards, and their z, from the upper face down."""
        b, into = 0.0 if nominal else self.break_mm, -1 if self.solid else 1
        if b == 0.0:
            return [(0.0, self.top), (0.0, self.bottom)]
        steps = ROUND_STEPS if self.form == "round" else 1
        turns = 0.5 * math.pi * np.arange(steps + 1) / steps
        rounding = [(into * b * (1 - math.sin(t)), self.top + b * (1 - math.cos(t))) for t in turns.tolist()]
        return [*rounding, (0.0, self.bottom)]


@dataclass(frozen=True, slots=True)
class Design:
    """A part: its walls, the base's first."""

    name: str
    walls: tuple[Wall, ...]

    @property
    def thickness(self) -> float:
        """Thickness of the base."""
        return self.walls[0].bottom

    def levels(self) -> Iterator[tuple[float, bool, Wall, list[Wall]]]:
        """Each level face: z, whether it looks up, the wall around it, and the walls within it."""
        yield self.thickness, False, self.walls[0], [w for w in self.walls if self.is_through(w)]
        for number, wall in enumerate(self.walls):
            if not self.is_through(wall):
                z = wall.top if wall.solid else wall.bottom
                yield z, True, wall, [w for w in self.walls if w.parent == number]

    def is_through(self, wall: Wall) -> bool:
        """Whether the wall is a hole that goes through to the underside."""
        return not wall.solid and wall.bottom == self.thickness


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A part's triangles, and the kind of each one's face: "face", "wall", "break", "under" or "beneath".

    "beneath" is not part of it: it closes the holes at the underside.  hole (M,) : in a hole.
    """

    model: CadModel
    kind: tuple[str, ...]
    hole: FloatArray


def meshed(design: Design, *, nominal: bool, closed_below: bool = False) -> Mesh:
    """The part with its breaks, or nominal; closed_below : through holes are closed in the plane below."""
    corners: list[FloatArray] = []
    surfaces: list[Surface | None] = []
    rows: list[tuple[int, str, bool]] = []

    def add(triangles: FloatArray, surface: Surface | None, kind: str, hole: bool) -> None:
        corners.append(triangles)
        rows.extend([(len(surfaces), kind, hole)] * len(triangles))
        surfaces.append(surface)

    for wall in design.walls:
        _add_strips(wall, nominal, add)
    for z, looks_up, around, within in design.levels():
        outer = _end(around, z, nominal)
        plane = FlatSurface(np.array([0.0, 0.0, z]), UP if looks_up else -UP)
        add(_level(z, looks_up, outer, [_end(w, z, nominal) for w in within]), plane,
            "face" if looks_up else "under", not around.solid)  # fmt: skip
        for hole in within if closed_below and not looks_up else []:
            add(_level(z, True, _end(hole, z, nominal), []), plane, "beneath", True)
    points, triangles = welded(np.concatenate(corners))
    if len(triangles) != len(rows):
        raise ValueError(f"{design.name}: triangles without area")
    numbers = np.array([face for face, _, _ in rows])
    model = CadModel(points, triangles, numbers, tuple(surfaces))
    return Mesh(model, tuple(kind for _, kind, _ in rows), np.array([hole for _, _, hole in rows], float))


def _end(wall: Wall, z: float, nominal: bool) -> FloatArray:
    """Points (M, 2) of the curve where a wall meets a level face at z."""
    grow_mm = next(grow for grow, height in wall.profile(nominal=nominal) if height == z)
    return wall.outline.offset(grow_mm).points(wall.outline.pieces())


def _add_strips(wall: Wall, nominal: bool, add: Any) -> None:
    pieces = wall.outline.pieces()
    sides = np.repeat(np.arange(len(pieces)), pieces)
    for upper, lower in pairwise(wall.profile(nominal=nominal)):
        rings = [
            np.c_[wall.outline.offset(grow).points(pieces), np.full(len(sides), z)]
            for grow, z in (upper, lower)
        ]
        a, b = rings
        c, d = np.roll(b, -1, axis=0), np.roll(a, -1, axis=0)
        quads = np.stack([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)], axis=1)
        if not wall.solid:
            quads = quads[:, :, ::-1]
        is_break = upper[0] != lower[0]
        for side in range(len(pieces)):
            surface = _side_surface(wall, side, upper, lower)
            add(
                quads[sides == side].reshape(-1, 3, 3),
                surface,
                "break" if is_break else "wall",
                not wall.solid,
            )


def _side_surface(
    wall: Wall, side: int, upper: tuple[float, float], lower: tuple[float, float]
) -> Surface | None:
    """Surface of one side of a wall, or of its break; None for a rounding."""
    is_break = upper[0] != lower[0]
    if is_break and wall.form == "round":
        return None
    outline = wall.outline.offset(lower[0])
    centre = outline.centres[side]
    slope = (upper[0] - lower[0]) / (lower[1] - upper[1])
    if centre is not None:
        return RoundSurface(np.array([*centre, lower[1]]), UP, outline.radius(side), slope)
    start, end = np.array(outline.corners[side]), np.array(outline.corners[(side + 1) % len(outline.corners)])
    x, y = (end - start) / np.linalg.norm(end - start)
    normal = np.array([y, -x, slope]) / math.hypot(1.0, slope)
    return FlatSurface(np.array([*start, lower[1]]), normal if wall.solid else -normal)


def _level(z: float, looks_up: bool, outer: FloatArray, inner: list[FloatArray]) -> FloatArray:
    """Triangles (M, 3, 3) of a level face between closed curves."""
    curves = [outer, *inner]
    points = np.concatenate(curves)
    far = 100.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    # corners far outside: otherwise the area between collinear points may become a triangle
    triangles = Delaunay(np.concatenate([points, far])).simplices
    triangles = triangles[(triangles < len(points)).all(axis=1)]
    middles = points[triangles].mean(axis=1)
    inside = is_inside(outer, middles)
    for curve in inner:
        inside &= ~is_inside(curve, middles)
    corners = np.concatenate([points[triangles[inside]], np.full((inside.sum(), 3, 1), z)], axis=2)
    one, two = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    wrong = (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0] > 0) == looks_up
    corners[wrong] = corners[wrong][:, ::-1]
    return np.asarray(corners)


def is_inside(curve: FloatArray, points: FloatArray) -> Any:
    """Mask (N,) of points (N, 2) within a closed curve (M, 2)."""
    ahead = np.roll(curve, -1, axis=0)
    across = (curve[:, 1] > points[:, 1:]) != (ahead[:, 1] > points[:, 1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (points[:, 1:] - curve[:, 1]) / (ahead[:, 1] - curve[:, 1])
        left = points[:, :1] < curve[:, 0] + share * (ahead[:, 0] - curve[:, 0])
    return (across & left).sum(axis=1) % 2 == 1


# --- designs ---------------------------------------------------------------------------------------


def random_design(seed: int) -> Design:
    """A plate, disc, block or bar with bosses, holes, counterbores and pockets; one design for each seed."""
    rng = np.random.default_rng((20, seed))
    base = _base(rng)
    walls = [Wall("base", base, -1, True, 0.0, float(rng.uniform(4, 11)))]
    for number in range(rng.integers(0, 3)):
        _raise_boss(walls, f"boss{number}", rng)
    for number in range(rng.integers(2, 6)):
        _sink_hole(walls, f"hole{number}", rng)
    return Design(f"P{seed}", tuple(_broken(walls, rng)))


def _base(rng: np.random.Generator) -> Outline:
    w, h, kind = rng.uniform(11, 16), rng.uniform(9, 12.5), rng.integers(6)
    if kind == 0:
        return circle(0, 0, w)
    if kind == 1:
        return flattened(w, rng.uniform(0.5, 0.85) * w)
    if kind == 2:
        step, notch = rng.uniform(-3, 3), rng.uniform(-1, 4)
        return polygon([(-w, -h), (w, -h), (w, step), (notch, step), (notch, h), (-w, h)])
    if kind == 3:
        return box(0, 0, 2 * w, 2 * h, rng.choice([0.0, rng.uniform(1.5, 5)]))
    if kind == 4:
        cut = rng.uniform(3, 7)
        return polygon([(-w, -h), (w - cut, -h), (w, -h + cut), (0.7 * w, h), (-w, 0.8 * h)])
    return box(0, 0, 2.2 * w, 1.6 * h, 0.8 * h)


def _raise_boss(walls: list[Wall], name: str, rng: np.random.Generator) -> None:
    """Add a boss on the base, or on another boss; and in most a hole, if there is space."""
    parent = int(rng.choice([k for k, wall in enumerate(walls) if wall.solid]))
    height = float(rng.uniform(0.8, 5))
    for _ in range(TRIES):
        x, y = rng.uniform(-8, 8), rng.uniform(-6, 6)
        radius = rng.uniform(2.8, 7)
        is_round = rng.random() < 0.6
        outline = circle(x, y, radius) if is_round else box(
            x, y, 2 * radius, radius * rng.uniform(0.9, 1.6), rng.choice([0.0, 0.8]))  # fmt: skip
        if _fits(walls, parent, outline):
            top = walls[parent].top
            walls.append(Wall(name, outline, parent, True, top - height, top))
            if is_round and radius > 3 and rng.random() < 0.7:
                bore = circle(x, y, rng.uniform(1.2, radius - CLEAR_MM - 0.3))
                bottom = walls[0].bottom if rng.random() < 0.6 and parent == 0 else top - 0.3 * height
                walls.append(Wall(f"{name}bore", bore, len(walls) - 1, False, top - height, bottom))
            return


def _sink_hole(walls: list[Wall], name: str, rng: np.random.Generator) -> None:
    """Add a round hole through the base, a counterbored one, or a pocket."""
    kind = rng.choice(["through", "through", "through", "blind", "counterbore", "slot", "pocket"])
    for _ in range(TRIES):
        x, y, radius = rng.uniform(-14, 14), rng.uniform(-11, 11), rng.uniform(1, 2.6)
        outline = circle(x, y, radius)
        if kind == "counterbore":
            outline = circle(x, y, radius + 1.6)
        elif kind in ("slot", "pocket"):
            outline = box(x, y, rng.uniform(5, 10), 2 * radius, radius if kind == "slot" else 0.9 * radius)
        if not _fits(walls, 0, outline):
            continue
        shallow = float(rng.uniform(1, 3))
        bottom = walls[0].bottom if kind in ("through", "slot") else shallow
        walls.append(Wall(name, outline, 0, False, 0.0, bottom))
        if kind == "counterbore":
            walls.append(
                Wall(f"{name}bore", circle(x, y, radius), len(walls) - 1, False, shallow, walls[0].bottom)
            )
        return


def _fits(walls: list[Wall], parent: int, outline: Outline) -> bool:
    """Whether an outline lies within its parent's, clear of it and of everything else that cuts there."""
    points = outline.points(outline.pieces())
    for number, wall in enumerate(walls):
        other = wall.outline.points(wall.outline.pieces())
        if np.linalg.norm(points[:, None] - other[None], axis=2).min() < CLEAR_MM:
            return False
        within, around = is_inside(other, points).all(), is_inside(points, other).any()
        if around or bool(within) != _holds(walls, number, parent):
            return False
    return True


def _holds(walls: list[Wall], number: int, parent: int) -> bool:
    """Whether a wall encloses another, or is it."""
    while parent >= 0:
        if parent == number:
            return True
        parent = walls[parent].parent
    return False


def _broken(walls: list[Wall], rng: np.random.Generator) -> Iterator[Wall]:
    """The walls with their breaks: none in one design of four, otherwise of one size, or of several."""
    if rng.random() < 0.2:
        yield from walls
        return
    size, is_mixed, form = rng.uniform(0.05, 0.5), rng.random() < 0.5, rng.random()
    for wall in walls:
        b = size * rng.choice([0.0, 0.5, 1.0]) if is_mixed and wall.parent >= 0 else size
        kind = "round" if form > (0.8 if not is_mixed else 0.6 + 0.4 * rng.random()) else "chamfer"
        yield Wall(
            wall.name, wall.outline, wall.parent, wall.solid, wall.top, wall.bottom, round(float(b), 3), kind
        )
