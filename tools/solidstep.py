"""Parts of `solids` as STEP files (ISO 10303-21, AP214): true planes, cylinders, lines and circles."""

from __future__ import annotations

import numpy as np
from solids import UP, Design, Outline, Wall

from edged.domain.arrays import FloatArray

HEADER = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('{name}','2026-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN {{ 1 0 10303 214 1 1 1 1 }}'));
ENDSEC;
DATA;
"""
Loop = list[tuple[int, bool]]
"""Edges, and whether each is walked from its start to its end."""


class _Writer:
    """Numbers the entities of a file; equal texts share a number."""

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}

    def put(self, text: str) -> int:
        return self.numbers.setdefault(text, len(self.numbers) + 1)

    def point(self, place: FloatArray) -> int:
        return self.put(f"CARTESIAN_POINT('',({_numbers(place)}))")

    def frame(self, place: FloatArray, axis: FloatArray) -> int:
        aside = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        aside = aside - (aside @ axis) * axis
        directions = [self.direction(one / np.linalg.norm(one)) for one in (axis, aside)]
        return self.put(f"AXIS2_PLACEMENT_3D('',#{self.point(place)},#{directions[0]},#{directions[1]})")

    def direction(self, along: FloatArray) -> int:
        return self.put(f"DIRECTION('',({_numbers(along)}))")

    def vertex(self, place: FloatArray) -> int:
        return self.put(f"VERTEX_POINT('',#{self.point(place)})")

    def straight(self, start: FloatArray, end: FloatArray) -> int:
        """Add an edge that is a line."""
        along = (end - start) / np.linalg.norm(end - start)
        vector = self.put(f"VECTOR('',#{self.direction(along)},1.)")
        line = self.put(f"LINE('',#{self.point(start)},#{vector})")
        return self.put(f"EDGE_CURVE('',#{self.vertex(start)},#{self.vertex(end)},#{line},.T.)")

    def arc(self, start: FloatArray, end: FloatArray, centre: FloatArray, radius: float) -> int:
        """Add an edge that is an arc, counter-clockwise in x and y."""
        ring = self.put(f"CIRCLE('',#{self.frame(centre, -UP)},{radius:.9f})")
        return self.put(f"EDGE_CURVE('',#{self.vertex(start)},#{self.vertex(end)},#{ring},.T.)")

    def face(self, surface: int, loops: list[Loop], *, agrees: bool = True) -> int:
        bounds = []
        for number, loop in enumerate(loops):
            edges = [self.put(f"ORIENTED_EDGE('',*,*,#{edge},{_flag(ahead)})") for edge, ahead in loop]
            closed = self.put(f"EDGE_LOOP('',({_references(edges)}))")
            bounds.append(self.put(f"FACE_{'OUTER_' if number == 0 else ''}BOUND('',#{closed},.T.)"))
        return self.put(f"ADVANCED_FACE('',({_references(bounds)}),#{surface},{_flag(agrees)})")


def step_text(design: Design) -> str:
    """The nominal part, without its breaks, as STEP text."""
    writer = _Writer()
    faces = [face for wall in design.walls for face in _wall_faces(writer, wall)]
    for z, looks_up, around, within in design.levels():
        plane = writer.put(f"PLANE('',#{writer.frame(np.array([0.0, 0.0, z]), UP if looks_up else -UP)})")
        loops = [_ring(writer, wall.outline, z) for wall in (around, *within)]
        # counter-clockwise in x and y is clockwise seen from above the part
        turned = [loop if (number == 0) != looks_up else _reversed(loop) for number, loop in enumerate(loops)]
        faces.append(writer.face(plane, turned))
    shell = writer.put(f"CLOSED_SHELL('',({_references(faces)}))")
    _product(writer, design.name, writer.put(f"MANIFOLD_SOLID_BREP('',#{shell})"))
    lines = [f"#{number}={text};" for text, number in writer.numbers.items()]
    return HEADER.format(name=design.name) + "\n".join(lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"


def _wall_faces(writer: _Writer, wall: Wall) -> list[int]:
    upper, lower = _ring(writer, wall.outline, wall.top), _ring(writer, wall.outline, wall.bottom)
    places = [np.array(corner) for corner in wall.outline.corners]
    found = []
    for side, centre in enumerate(wall.outline.centres):
        ends = [places[side], places[(side + 1) % len(places)]]
        down = [writer.straight(np.array([*one, wall.top]), np.array([*one, wall.bottom])) for one in ends]
        loop = [upper[side], (down[1], True), (lower[side][0], False), (down[0], False)]
        if not wall.solid:
            loop = _reversed(loop)
        place = np.array([*(ends[0] if centre is None else centre), wall.top])
        if centre is None:
            x, y = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            normal = np.array([y, -x, 0.0]) * (1 if wall.solid else -1)
            surface = writer.put(f"PLANE('',#{writer.frame(place, normal)})")
            found.append(writer.face(surface, [loop]))
        else:
            radius = wall.outline.radius(side)
            surface = writer.put(f"CYLINDRICAL_SURFACE('',#{writer.frame(place, -UP)},{radius:.9f})")
            found.append(writer.face(surface, [loop], agrees=wall.solid))
    return found


def _ring(writer: _Writer, outline: Outline, z: float) -> Loop:
    """The edges of an outline at one level, counter-clockwise in x and y."""
    places = [np.array([*corner, z]) for corner in outline.corners]
    ends = list(zip(places, places[1:] + places[:1], strict=True))
    return [
        (writer.straight(*ends[side]), True)
        if centre is None
        else (writer.arc(*ends[side], np.array([*centre, z]), outline.radius(side)), True)
        for side, centre in enumerate(outline.centres)
    ]


def _reversed(loop: Loop) -> Loop:
    return [(edge, not ahead) for edge, ahead in reversed(loop)]


def _product(writer: _Writer, name: str, solid: int) -> None:
    """Add the product, shape and units that AP214 requires around a solid."""
    put = writer.put
    units = [
        put("(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.))"),
        put("(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.))"),
        put("(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT())"),
    ]
    near = put(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),#{units[0]},'','')")
    context = put(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{near})) "
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({_references(units)})) REPRESENTATION_CONTEXT('',''))"
    )
    frame = writer.frame(np.zeros(3), -UP)
    shape = put(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',(#{frame},#{solid}),#{context})")
    about = put("APPLICATION_CONTEXT('core data for automotive mechanical design processes')")
    put(f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#{about})")
    discipline = put(f"PRODUCT_CONTEXT('',#{about},'mechanical')")
    product = put(f"PRODUCT('{name}','{name}','',(#{discipline}))")
    formation = put(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
    stage = put(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{about},'design')")
    definition = put(f"PRODUCT_DEFINITION('design','',#{formation},#{stage})")
    whole = put(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
    put(f"SHAPE_DEFINITION_REPRESENTATION(#{whole},#{shape})")


def _numbers(values: FloatArray) -> str:
    return ",".join(f"{value:.9f}" for value in values + 0.0)


def _references(numbers: list[int]) -> str:
    return ",".join(f"#{number}" for number in numbers)


def _flag(value: bool) -> str:
    return ".T." if value else ".F."
