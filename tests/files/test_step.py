"""STEP files give exact circles and edges; other files are refused with their name."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edged.errors import FileFormatError
from edged.files.step import MAX_FACES, read_step
from edged.vision.teaching.cadmodel import ModelCurves, curves_towards

DATA = Path(__file__).parent.parent / "data" / "cad"
SEEN = {"sharp", "break_face", "break_wall"}
"""Outer edges that face the cameras; the others are inner edges, lower rims and upright ones."""
SPHERE = """#9001 = ADVANCED_FACE('',(#9002),#9005,.T.);
#9002 = FACE_BOUND('',#9003,.T.);
#9003 = VERTEX_LOOP('',#9004);
#9004 = VERTEX_POINT('',#9006);
#9005 = SPHERICAL_SURFACE('',#9007,5.);
#9006 = CARTESIAN_POINT('',(0.,0.,-5.));
#9007 = AXIS2_PLACEMENT_3D('',#9008,#9009,#9010);
#9008 = CARTESIAN_POINT('',(0.,0.,0.));
#9009 = DIRECTION('',(0.,0.,1.));
#9010 = DIRECTION('',(1.,0.,0.));
"""
MILLIMETRE = "#1227 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
INCH = """#1227 = ( CONVERSION_BASED_UNIT('INCH',#9102) LENGTH_UNIT() NAMED_UNIT(#9101) );
#9101 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#9102 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#9103);
#9103 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"""


def text_of(part: str) -> str:
    """The text of a part's file."""
    return (DATA / f"{part}.step").read_text()


def saved(folder: Path, text: str) -> Path:
    """Save the text as a file."""
    path = folder / "part.step"
    path.write_text(text)
    return path


def from_above(path: Path) -> ModelCurves:
    """The curves that its -z side shows."""
    return curves_towards(read_step(path), np.array([0.0, 0.0, -1.0]))


def truth_of(part: str, shape: str) -> list[dict[str, Any]]:
    """The circles or lines of a part that the cameras can see, from its list of features."""
    features = json.loads((DATA / f"{part}.json").read_text())["features_in_step"]
    return [one for one in features if one["shape"] == shape and one["role"] in SEEN]


@pytest.mark.long
@pytest.mark.parametrize("part", ["D1", "D2", "D3", "D4"])
def test_circles_are_those_of_the_design(part: str) -> None:
    """The circles that face up are those of the design; centre and radius to a hundredth of a micrometre."""
    found = from_above(DATA / f"{part}.step").circles
    wanted = truth_of(part, "circle")
    assert len(wanted) == len(found)
    for one in wanted:
        true = np.array([*one["centre_part_mm"], one["radius_mm"]])
        near = min(found, key=lambda c: float(np.linalg.norm([*c.centre_mm, c.radius_mm] - true)))
        assert np.linalg.norm([*near.centre_mm, near.radius_mm] - true) < 1e-5
        assert (one["kind"] == "hole") == near.hole


@pytest.mark.long
@pytest.mark.parametrize(("part", "count"), [("D1", 3), ("D2", 11), ("D3", 10), ("D4", 1)])
def test_straight_edges_are_those_of_the_design(part: str, count: int) -> None:
    """Each straight edge lies on a line of the design, with its normal across it."""
    found = from_above(DATA / f"{part}.step").edges
    lines = [np.array(one["ends_part_mm"]) for one in truth_of(part, "line")]
    assert count == len(found)
    for edge in found:
        along = (edge.end_mm - edge.start_mm) / np.linalg.norm(edge.end_mm - edge.start_mm)
        off = [float(np.linalg.norm(np.cross(line - edge.start_mm, along), axis=1).max()) for line in lines]
        assert min(off) < 1e-5
        assert abs(float(along @ edge.away)) < 1e-9


def test_the_outside_of_an_edge_is_known() -> None:
    """The normal of a convex outline points away from the middle."""
    sides = [e for e in from_above(DATA / "D3.step").edges if abs(e.start_mm[0] + e.end_mm[0]) > 28.9]
    assert 2 == len(sides)
    for edge in sides:
        assert edge.away.tolist() == pytest.approx([math.copysign(1.0, edge.start_mm[0]), 0.0, 0.0])


def test_a_cut_rim_is_one_circle() -> None:
    """A rim with a notch of 2.8 % is one circle, not two arcs."""
    rim = max(from_above(DATA / "D1.step").circles, key=lambda one: one.radius_mm)
    assert 1 - 2 * math.asin(1.4 / 16) / math.tau == pytest.approx(rim.span, abs=1e-3)


@pytest.mark.slow
def test_the_underside_shows_its_own_edges() -> None:
    """From below the through holes of the lower face are seen, not the boss."""
    below = curves_towards(read_step(DATA / "D2.step"), np.array([0.0, 0.0, 1.0]))
    assert {8.0} == {round(float(one.centre_mm[2]), 6) for one in below.circles}


@pytest.mark.long
def test_inches_are_read_as_millimetres(tmp_path: Path) -> None:
    """A file in inches gives a part 25.4 times as large."""
    text = text_of("D3")
    assert MILLIMETRE in text
    inches = from_above(saved(tmp_path, text.replace(MILLIMETRE, INCH)))
    assert sorted(25.4 * one.radius_mm for one in from_above(DATA / "D3.step").circles) == pytest.approx(
        sorted(one.radius_mm for one in inches.circles), rel=1e-9
    )


def _two_solids(text: str) -> str:
    return text.replace("(#11,#15)", "(#11,#15,#9200)").replace(
        "#15 = MANIFOLD", "#9200 = MANIFOLD_SOLID_BREP('',#16);\n#15 = MANIFOLD"
    )


def _many_faces(text: str) -> str:
    faces = "".join(f"#{k} = ADVANCED_FACE('',(#1),#1,.T.);\n" for k in range(10_000, 210_000))
    return text.replace("#15 = MANIFOLD", faces + "#15 = MANIFOLD")


def _sphere(text: str) -> str:
    shell = re.sub(r"CLOSED_SHELL\('',\([^)]*\)\);", "CLOSED_SHELL('',(#9001));\n" + SPHERE, text)
    return re.sub(r"#\d+ = ADVANCED_FACE\('',\((?!#9002)[^)]*\)[^;]*;", "", shell)


@pytest.mark.long
@pytest.mark.parametrize(("damage", "expected"), [
    (lambda _: "", "not a STEP file"),
    (lambda _: "solid part\nendsolid part\n", "not a STEP file"),
    (lambda text: text[: len(text) // 2], "cut off"),
    (lambda text: text.replace("MANIFOLD_SOLID_BREP", "GEOMETRIC_SET"), "no solids"),
    (_two_solids, "2 solids"),
    (_many_faces, f"at most {MAX_FACES}"),
    (_sphere, "no plane face"),
    (lambda text: re.sub(r"CARTESIAN_POINT\('',\(", "CARTESIAN_POINT('',(#1,", text), "faces can be read"),
    (lambda text: re.sub(r"= PLANE\(", "= PLAIN(", text), "part.step"),
    (lambda text: text.replace("#16 = CLOSED_SHELL", "#16 = CLOSED_SHALL"), "cannot be read"),
])  # fmt: skip
def test_what_is_no_model_of_a_part_is_named(tmp_path: Path, damage: Any, expected: str) -> None:
    """A file that is no model of a part is refused with its name and what was expected."""
    path = saved(tmp_path, damage(text_of("D3")))
    with pytest.raises(FileFormatError, match=re.escape(expected)) as caught:
        read_step(path)
    assert str(path) in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize(("lost", "curves"), [(3, 14), (4, 5), (17, 14)])
def test_a_gap_in_the_surface_costs_the_curves_beside_it(tmp_path: Path, lost: int, curves: int) -> None:
    """Without a bore, the main face or a wall the other curves are at their places, and none is added."""
    text = text_of("D3")
    shell = re.search(r"CLOSED_SHELL\('',\(([^)]*)\)\)", text)
    assert shell is not None
    faces = shell[1].split(",")
    assert 18 == len(faces)
    kept = ",".join(face for k, face in enumerate(faces) if k != lost)
    found = from_above(saved(tmp_path, text.replace(shell[0], f"CLOSED_SHELL('',({kept}))")))
    whole = from_above(DATA / "D3.step")
    assert curves == len(found.circles) + len(found.edges)
    for one in found.circles:
        gaps = [np.append(one.centre_mm - other.centre_mm, one.radius_mm - other.radius_mm)
                for other in whole.circles]  # fmt: skip
        assert min(float(np.linalg.norm(gap)) for gap in gaps) < 1e-6


COLOURED = """#9001 = COLOUR_RGB('',1.,0.,0.);
#9002 = FILL_AREA_STYLE_COLOUR('',#9001);
#9003 = FILL_AREA_STYLE('',(#9002));
#9004 = SURFACE_STYLE_FILL_AREA(#9003);
#9005 = SURFACE_SIDE_STYLE('',(#9004));
#9006 = SURFACE_STYLE_USAGE(.BOTH.,#9005);
#9007 = PRESENTATION_STYLE_ASSIGNMENT((#9006));
#9008 = STYLED_ITEM('',(#9007),#17);
#9009 = MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',(#9008),#1487);
"""
"""Gives one face a colour, as CAD does with holes that are to be threaded."""
SKETCH = """#9001 = GEOMETRICALLY_BOUNDED_WIREFRAME_SHAPE_REPRESENTATION('',(#9002),#1487);
#9002 = GEOMETRIC_CURVE_SET('',(#9003));
#9003 = TRIMMED_CURVE('',#9004,(PARAMETER_VALUE(0.)),(PARAMETER_VALUE(9.)),.T.,.PARAMETER.);
#9004 = LINE('',#9005,#9006);
#9005 = CARTESIAN_POINT('',(40.,0.,0.));
#9006 = VECTOR('',#9007,1.);
#9007 = DIRECTION('',(1.,0.,0.));
#9008 = SHAPE_REPRESENTATION_RELATIONSHIP('','',#10,#9001);
"""
"""A sketch that was left visible beside the solid."""


@pytest.mark.slow
@pytest.mark.parametrize("beside", [COLOURED, SKETCH], ids=["coloured", "sketch"])
def test_what_cad_leaves_beside_the_shape_changes_nothing(tmp_path: Path, beside: str) -> None:
    """Of 91 public files of single parts four had one of these, and were refused as damaged."""
    text = text_of("D2")
    found, plain = (
        from_above(saved(tmp_path, written))
        for written in (text.replace("ENDSEC;\nEND-ISO", f"{beside}ENDSEC;\nEND-ISO"), text)
    )
    assert len(plain.circles) == len(found.circles) > 0
    for one, other in zip(plain.circles, found.circles, strict=True):
        assert np.array_equal(one.centre_mm, other.centre_mm)
        assert one.radius_mm == other.radius_mm
    assert len(plain.edges) == len(found.edges) > 0


def test_a_surface_that_no_job_could_keep_is_read_with_larger_triangles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a part with more triangles than a job keeps, its edges stay those of the file."""
    fine = read_step(DATA / "D4.step")
    monkeypatch.setattr("edged.files.step.MAX_TRIANGLES", len(fine.triangles) - 1)
    coarse = read_step(DATA / "D4.step")
    assert len(coarse.triangles) < len(fine.triangles)
    up = np.array([0.0, 0.0, -1.0])
    radii = [[circle.radius_mm for circle in curves_towards(model, up).circles] for model in (fine, coarse)]
    assert radii[1] == pytest.approx(radii[0])


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    """A missing file is named."""
    with pytest.raises(FileFormatError, match=r"none\.step"):
        read_step(tmp_path / "none.step")


def test_without_the_reader_its_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the reader's package the message has the line that installs it."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(FileFormatError, match=re.escape("pip install 'edged[cad]'")):
        read_step(DATA / "D3.step")


def test_a_reader_that_cannot_be_loaded_is_not_a_damaged_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader that cannot be loaded is named as such, not as a damaged file."""
    (tmp_path / "cascadio.py").write_text("raise ImportError('libTKernel.so: no such file')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(FileFormatError, match=r"cascadio: libTKernel\.so: no such file"):
        read_step(DATA / "D3.step")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root has rights to give up")
def test_root_parses_no_strangers_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As root the file is parsed in a process of user nobody."""
    (tmp_path / "cascadio.py").write_text(
        "import os, sys\ndef load(*_, **__): sys.exit(f'user {os.getresuid()} {os.getgroups()}')\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(FileFormatError, match=r"user \(65534, 65534, 65534\) \[\]"):
        read_step(DATA / "D3.step")


@pytest.mark.parametrize(("limit", "most", "expected"), [
    ("MAX_MESH_BYTES", 1000, "bytes of triangles, at most 1000"),
    ("MAX_MEMORY_BYTES", 64 << 20, "D3.step: "),
])  # fmt: skip
def test_the_reader_is_bounded(monkeypatch: pytest.MonkeyPatch, limit: str, most: int, expected: str) -> None:
    """A reader that takes too much memory or time ends with a message that names the file."""
    monkeypatch.setattr(f"edged.files.step.{limit}", most)
    with pytest.raises(FileFormatError, match=expected):
        read_step(DATA / "D3.step")
