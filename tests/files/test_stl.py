"""STL files give circles and edges, with the uncertainty of their facets; other files are refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.stlfiles import binary, ring, text
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.errors import FileFormatError
from edged.files.step import read_step
from edged.files.stl import MAX_FACETS, read_stl
from edged.vision.teaching.cadmodel import ModelCurves, curves_towards
from edged.vision.teaching.facets import faceted_curves

DATA = Path(__file__).parent.parent / "data" / "cad"
UP = np.array([0.0, 0.0, 1.0])
PLATE = ring(24, 12.0, 3.0, 5.0)


def saved(folder: Path, data: bytes | str) -> Path:
    """Save the data as a file."""
    path = folder / "part.stl"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def seen(path: Path, unit: str | None = None) -> ModelCurves:
    """The curves that its z side shows."""
    return faceted_curves(read_stl(path, unit), UP)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["D1", "D2", "D3", "D4"])
def test_triangles_of_a_step_file_say_what_its_faces_say(tmp_path: Path, part: str) -> None:
    """The triangles of a STEP file give its circles and straight edges to a tenth of a micrometre."""
    model = read_step(DATA / f"{part}.step")
    exact = curves_towards(model, -UP)
    path = saved(tmp_path, binary(model.points_mm[model.triangles]))
    found = faceted_curves(read_stl(path), -UP)
    assert len(exact.circles) == len(found.circles)
    for one in exact.circles:
        true = np.array([*one.centre_mm, one.radius_mm])
        near = min(found.circles, key=lambda c: float(np.linalg.norm([*c.centre_mm, c.radius_mm] - true)))
        assert np.linalg.norm([*near.centre_mm, near.radius_mm] - true) < 1e-4
        assert one.hole == near.hole
        assert one.span == pytest.approx(near.span, abs=1e-3)
        assert 0 < near.sigma_mm < 0.003
    assert len(exact.edges) == len(found.edges)
    for line in exact.edges:
        ends = np.sort(np.stack([line.start_mm, line.end_mm]), axis=0)
        gaps = [np.abs(np.sort(np.stack([e.start_mm, e.end_mm]), axis=0) - ends).max() for e in found.edges]
        assert min(gaps) < 1e-4
        assert np.allclose(line.away, found.edges[int(np.argmin(gaps))].away, atol=1e-6)


@pytest.mark.slow
@settings(max_examples=20)
@given(count=st.integers(12, 300), turn=st.floats(0, 6.0), as_text=st.booleans())
def test_a_faceted_circle_has_no_bias_and_the_sigma_of_its_chords(
    tmp_path_factory: pytest.TempPathFactory, count: int, turn: float, as_text: bool
) -> None:
    """Both rims of a ring get the radius of their corners, for any number of chords."""
    corners = ring(count, 12.0, 3.0, 5.0, turn)
    path = saved(tmp_path_factory.mktemp("stl"), text(corners) if as_text else binary(corners))
    disc, hole = seen(path).circles
    assert (False, True) == (disc.hole, hole.hole)
    for one, radius_mm in ((disc, 12.0), (hole, 3.0)):
        assert radius_mm == pytest.approx(one.radius_mm, abs=1e-5)
        assert np.abs(one.centre_mm).max() < 1e-5
        sagitta_mm = radius_mm * (1 - math.cos(math.pi / count))
        assert sagitta_mm / math.sqrt(12) == pytest.approx(one.sigma_mm, rel=0.01)
    assert () == seen(path).edges


@pytest.mark.parametrize("count", [3, 4, 6, 8, 11])
def test_a_polygon_is_no_circle(tmp_path: Path, count: int) -> None:
    """Fewer than twelve chords are straight edges, each once."""
    found = seen(saved(tmp_path, binary(ring(count, 12.0, 8.0, 5.0))))
    assert () == found.circles
    assert 2 * count == len(found.edges)
    lengths = sorted(float(np.linalg.norm(one.end_mm - one.start_mm)) for one in found.edges)
    assert 2 * 8.0 * math.sin(math.pi / count) == pytest.approx(lengths[0], abs=1e-5)


def test_inches_are_told_by_a_person(tmp_path: Path) -> None:
    """Numbers are taken as mm, with --unit in as inches; an unknown unit is refused."""
    path = saved(tmp_path, binary(PLATE / 25.4))
    assert 12.0 / 25.4 == pytest.approx(seen(path).circles[0].radius_mm, abs=1e-6)
    assert 12.0 == pytest.approx(seen(path, "in").circles[0].radius_mm, abs=1e-5)
    with pytest.raises(FileFormatError, match="unit 'feet': expected one of mm, cm, m, in"):
        read_stl(path, "feet")


def test_a_binary_file_may_say_solid(tmp_path: Path) -> None:
    """A binary file that starts with "solid" is read as binary."""
    assert 2 == len(seen(saved(tmp_path, binary(PLATE, b"solid facetless part"))).circles)


def test_a_part_turned_inside_out_is_the_same_part(tmp_path: Path) -> None:
    """A part whose facets have their corners in the other order gives the same circles."""
    disc, hole = seen(saved(tmp_path, binary(PLATE[:, ::-1]))).circles
    assert (False, True) == (disc.hole, hole.hole)


@pytest.mark.long
def test_a_part_of_200_000_facets_is_read(tmp_path: Path) -> None:
    """A part of 208,000 facets, with rims of 2,000 chords each, is read as two circles."""
    corners = ring(2000, 30.0, 20.0, 5.0, rows=50)
    assert 208_000 <= len(corners)
    found = seen(saved(tmp_path, binary(corners)))
    assert [30.0, 20.0] == [pytest.approx(one.radius_mm, abs=1e-4) for one in found.circles]


def with_a_number(value: float) -> bytes:
    """A binary file with this value in one corner."""
    corners = PLATE.copy()
    corners[5, 1, 2] = value
    return binary(corners)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "0 bytes: expected an STL file"),
        (binary(PLATE)[:-20], r"cut off, or no STL file: 192 facets take 9684"),
        (binary(PLATE) + b"\0" * 7, "no STL file, or damaged: 192 facets"),
        (binary(PLATE)[:80] + b"\xff" * 4 + binary(PLATE)[84:], "cut off, or no STL file: 4294967295"),
        (bytes(80) + (MAX_FACETS + 1).to_bytes(4, "little") + bytes(50 * MAX_FACETS + 50), "at most 500000"),
        (b"\0" * 84, "no facet"),
        (with_a_number(math.nan), "coordinates that are no numbers"),
        (with_a_number(math.inf), "coordinates that are no numbers"),
        (with_a_number(1e30), r"coordinates beyond 100000 mm"),
        (binary(np.repeat(PLATE[:1], 6, axis=0)), "not closed"),
        (binary(PLATE[:-10]), "not closed: 30 of the 546 sides"),
        (binary(np.concatenate([PLATE, PLATE + 40.0])), "2 bodies: expected the model of one part"),
        (binary(np.zeros((20, 3, 3))), "0 facets that have an area"),
        (text(PLATE)[:-400], "cut off: expected endsolid"),
        (text(PLATE).replace("vertex", "vortex", 1), "damaged: 575 corners of 192 facets"),
        (text(PLATE).replace("vertex ", "vertex one", 1), "damaged: 575 corners"),
        (b"ISO-10303-21;" + b" " * 200, "cut off, or no STL file"),
    ],
)  # fmt: skip
def test_what_is_no_part_is_named(tmp_path: Path, data: bytes | str, said: str) -> None:
    """Files that are cut off, with false counts, invalid numbers, open or several parts are refused."""
    with pytest.raises(FileFormatError, match=said):
        read_stl(saved(tmp_path, data))


@pytest.mark.long
@settings(max_examples=150)
@given(st.binary(max_size=600), st.integers(0, 9000), st.booleans())
def test_damaged_bytes_end_in_a_message(
    tmp_path_factory: pytest.TempPathFactory, noise: bytes, at: int, as_text: bool
) -> None:
    """Any bytes written over a part's file are read, or refused with the file's name."""
    data = bytearray(text(PLATE).encode() if as_text else binary(PLATE))
    data[at : at + len(noise)] = noise
    path = saved(tmp_path_factory.mktemp("stl"), bytes(data))
    try:
        faceted_curves(read_stl(path), UP)
    except FileFormatError as error:
        assert str(error).startswith(f"{path}: ")
