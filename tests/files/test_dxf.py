"""Drawings become closed outlines, with every kind of line and unit; others are refused with the reason."""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from ezdxf.document import Drawing
from helpers.waiting import WHOLE_S
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError
from edged.files.dxf import area, read_contour, read_dxf

MM, INCH = 4, 1


def saved(document: Drawing, folder: Path) -> Path:
    """Save the drawing as a file."""
    path = folder / "part.dxf"
    document.saveas(path)
    return path


@functools.cache
def plate_bytes() -> bytes:
    """The bytes of the plate's file, made once because each file has its own time stamp."""
    with tempfile.TemporaryDirectory() as folder:
        return saved(plate(), Path(folder)).read_bytes()


def plate(units: int = MM) -> Drawing:
    """A plate 40 x 25 with one round corner, drawn as loose lines in no order, with a hole and a slot."""
    document = ezdxf.new(units=units)
    space = document.modelspace()
    space.add_line((40, 20), (40, 0))
    space.add_line((0, 25), (0, 0))
    space.add_arc((35, 20), 5, 0, 90)
    space.add_line((0, 0), (40, 0))
    space.add_line((35, 25), (0, 25))
    space.add_circle((10, 10), 4)
    slot = [(20, 5, 0, 0, 0), (30, 5, 0, 0, 1), (30, 9, 0, 0, 0), (20, 9, 0, 0, 1)]
    space.add_lwpolyline(slot, close=True, format="xyseb")
    return document


def areas(outlines: list[FloatArray]) -> list[float]:
    """The areas of all outlines, smallest first."""
    return sorted(abs(area(outline)) for outline in outlines)


def test_loose_lines_arcs_and_bulges_become_closed_outlines(tmp_path: Path) -> None:
    """The areas are those of the drawing, whatever order and direction its lines have."""
    hole, slot = np.pi * 16, 40 + np.pi * 4
    outside = 40 * 25 - (1 - np.pi / 4) * 25

    assert areas(read_dxf(saved(plate(), tmp_path))) == pytest.approx([hole, slot, outside], rel=1e-3)


def test_every_point_lies_on_the_drawn_curve(tmp_path: Path) -> None:
    """Circles, arcs, bulges, ellipses and scaled blocks keep their exact radii."""
    document = ezdxf.new(units=MM)
    space = document.modelspace()
    space.add_circle((10, 10), 14)
    space.add_arc((50, 10), 1.6, 30, 200)
    space.add_arc((50, 10), 1.6, 200, 30)
    space.add_lwpolyline([(96, 0, 1), (104, 0, 1)], close=True, format="xyb")
    space.add_polyline2d([(204, 0, -1), (196, 0, -1)], close=True, format="xyb")
    space.add_ellipse((300, 0), major_axis=(9, 0), ratio=1)
    block = document.blocks.new("hole")
    block.add_circle((0, 0), 2)
    space.add_blockref("hole", (400, 0), dxfattribs={"xscale": -3, "yscale": 3, "zscale": 3})

    found = sorted(read_dxf(saved(document, tmp_path)), key=lambda outline: float(outline[0, 0]))

    expected = [(10, 10, 14), (50, 10, 1.6), (100, 0, 4), (200, 0, 4), (300, 0, 9), (400, 0, 6)]
    for (x, y, radius), outline in zip(expected, found, strict=True):
        distances = np.linalg.norm(outline - (x, y), axis=1)
        assert float(radius) == pytest.approx(distances, abs=1e-9)


def test_units_are_converted(tmp_path: Path) -> None:
    """An inch is 25.4 mm, a drawing without a unit is refused, and a stated unit is used."""
    in_mm = areas(read_dxf(saved(plate(), tmp_path)))
    assert areas(read_dxf(saved(plate(INCH), tmp_path))) == pytest.approx(
        [25.4**2 * a for a in in_mm], rel=1e-3
    )
    silent = saved(plate(0), tmp_path)
    with pytest.raises(FileFormatError, match=r"does not say its unit.*mm, cm, m, in"):
        read_dxf(silent)
    assert areas(read_dxf(silent, units="cm")) == pytest.approx([100 * a for a in in_mm], rel=1e-3)
    with pytest.raises(FileFormatError, match="unit 'furlong'"):
        read_dxf(silent, units="furlong")


def test_blocks_splines_and_ellipses_are_shapes(tmp_path: Path) -> None:
    """Scaled blocks, an ellipse and a spline have the right area; text draws nothing."""
    document = ezdxf.new(units=MM)
    block = document.blocks.new("bolt")
    block.add_circle((0, 0), 1)
    space = document.modelspace()
    for x in (0, 10):
        space.add_blockref("bolt", (x, 0), dxfattribs={"xscale": 2, "yscale": 2})
    space.add_ellipse((0, 20), (5, 0), 0.5)
    t = np.linspace(0, 2 * np.pi, 13)
    space.add_spline(np.column_stack([3 * np.cos(t), 40 + 3 * np.sin(t), 0 * t]).tolist())
    space.add_text("no edge")

    found = areas(read_dxf(saved(document, tmp_path)))
    assert found == pytest.approx([4 * np.pi, 4 * np.pi, 9 * np.pi, 12.5 * np.pi], rel=5e-3)


def test_layers_choose(tmp_path: Path) -> None:
    """Only the chosen layers are read, and none that is off; an unknown layer is refused with the existing
    ones.
    """
    document = plate()
    document.layers.add("construction")
    document.modelspace().add_line((-50, 0), (50, 0), dxfattribs={"layer": "construction"})
    path = saved(document, tmp_path)

    with pytest.raises(FileFormatError, match=r"open: nothing goes on at \(50.000, 0.000\) mm.*layers"):
        read_dxf(path)
    assert len(read_dxf(path, ["0"])) == 3
    with pytest.raises(FileFormatError, match=r"no layer 'parts', there are .*construction"):
        read_dxf(path, ["parts"])
    document.layers.get("construction").off()
    assert len(read_dxf(saved(document, tmp_path))) == 3


Line = tuple[tuple[float, float], tuple[float, float]]


def polygon(corners: int, radius: float, x: float = 0.0) -> list[Line]:
    """The sides of a regular polygon around (x, 0) with a corner at (x + radius, 0)."""
    angles = [2 * np.pi * k / corners for k in range(corners)]
    points = [(x + radius * np.cos(angle), radius * np.sin(angle)) for angle in angles]
    return list(zip(points, [*points[1:], points[0]], strict=True))


def polygon_area(corners: int, radius: float) -> float:
    """The area of a regular polygon."""
    return 0.5 * corners * radius**2 * np.sin(2 * np.pi / corners)


def saved_lines(lines: list[Line], folder: Path) -> Path:
    """A drawing of lines, in this order and direction."""
    document = ezdxf.new(units=MM)
    for start, end in lines:
        document.modelspace().add_line(start, end)
    return saved(document, folder)


def disordered(lines: list[Line], data: st.DataObject, gap_mm: float) -> list[Line]:
    """Lines in any order and direction, whose ends miss each other by less than the gap."""
    flips = data.draw(st.lists(st.booleans(), min_size=len(lines), max_size=len(lines)))
    ends = [end for line in lines for end in line]
    offsets = data.draw(st.lists(st.integers(-100, 100), min_size=2 * len(ends), max_size=2 * len(ends)))
    largest = gap_mm / (2 * np.sqrt(2)) / 100
    moved = [
        (x + largest * dx, y + largest * dy)
        for (x, y), dx, dy in zip(ends, offsets[::2], offsets[1::2], strict=True)
    ]
    pairs = zip(moved[::2], moved[1::2], flips, strict=True)
    return data.draw(st.permutations([(b, a) if flip else (a, b) for a, b, flip in pairs]))


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data(), st.lists(st.integers(3, 7), min_size=1, max_size=4), st.sampled_from([0.0, 0.001, 0.0199]))
def test_lines_in_any_order_and_direction_close(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, corners: list[int], gap_mm: float
) -> None:
    """Each polygon becomes one outline with its area, for any order of lines and gaps within the
    tolerance."""
    lines = [line for k, n in enumerate(corners) for line in polygon(n, 5.0, 25.0 * k)]
    path = saved_lines(disordered(lines, data, gap_mm), tmp_path_factory.mktemp("dxf"))

    found = areas(read_dxf(path))

    assert found == pytest.approx(sorted(polygon_area(n, 5.0) for n in corners), abs=40 * gap_mm + 1e-6)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.data(), st.integers(3, 6), st.sampled_from([2e-4, 0.005, 0.019]))
def test_outlines_that_nearly_touch_stay_two(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, corners: int, distance_mm: float
) -> None:
    """Two outlines whose corners are nearer than the tolerance stay two."""
    lines = polygon(corners, 5.0) + [
        ((10 + distance_mm - ax, ay), (10 + distance_mm - bx, by)) for (ax, ay), (bx, by) in polygon(4, 5.0)
    ]
    path = saved_lines(disordered(lines, data, 1e-4), tmp_path_factory.mktemp("dxf"))

    found = areas(read_dxf(path))

    assert found == pytest.approx(sorted([polygon_area(corners, 5.0), polygon_area(4, 5.0)]), abs=0.01)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.data(), st.integers(3, 7))
def test_a_line_drawn_twice_is_named(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, corners: int
) -> None:
    """A line that is drawn twice is refused with its place, wherever and in whichever direction it is."""
    lines = polygon(corners, 5.0)
    again = data.draw(st.sampled_from(lines))
    path = saved_lines(disordered([*lines, again], data, 1e-4), tmp_path_factory.mktemp("dxf"))

    with pytest.raises(
        FileFormatError, match=r"closes at \(.*\) mm, where 3 ends meet: a branch or .* twice"
    ):
        read_dxf(path)


def bomb(kind: str) -> Drawing:
    """A small drawing that would fill the memory."""
    document = ezdxf.new(units=MM)
    space = document.modelspace()
    match kind:
        case "circle":
            space.add_circle((0, 0), 1e15)
        case "arc":
            space.add_arc((0, 0), 1e15, 0, 90)
        case "ellipse":
            space.add_ellipse((0, 0), major_axis=(1e12, 0), ratio=0.5)
        case "bulge":
            space.add_lwpolyline([(1e12 * (i % 2), i, 1.0) for i in range(50)], format="xyb", close=True)
        case "spline":
            space.add_open_spline([(i, 1e6 * (i % 2)) for i in range(5000)])
        case _:
            for depth in range(8):
                block = document.blocks.new(f"B{depth}")
                for _ in range(20):
                    if depth == 0:
                        block.add_line((0, 0), (1, 0))
                    else:
                        block.add_blockref(f"B{depth - 1}", (0, 0))
            space.add_blockref("B7", (0, 0))
    return document


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["circle", "arc", "ellipse", "bulge", "spline", "blocks"])
def test_a_drawing_that_would_fill_the_memory_is_refused(kind: str, tmp_path: Path) -> None:
    """The drawing is refused before it is drawn in full, with the code "large"."""
    with pytest.raises(FileFormatError, match=r"more than \d+ (points|shapes)|8 deep") as caught:
        read_dxf(saved(bomb(kind), tmp_path), most_points=20_000)
    assert "large" == caught.value.code


@pytest.mark.long
def test_a_drawing_that_costs_too_much_is_refused(tmp_path: Path) -> None:
    """A drawing that takes too much memory or time is refused, and the next one is read as usual."""
    document = ezdxf.new(units=MM)
    for number in range(30_000):
        document.modelspace().add_line((number, 0), (number, 1))
    costly, other = saved(document, tmp_path).rename(tmp_path / "costly.dxf"), saved(plate(), tmp_path)
    script = (
        "import sys\nfrom pathlib import Path\nfrom edged.errors import FileFormatError\n"
        "from edged.files import dxf\n"
        "for memory, seconds in ((4 << 20, 60.0), (1 << 30, 0.25)):\n"
        "    dxf.MAX_MEMORY_BYTES, dxf.MAX_CPU_S = memory, seconds\n"
        "    try:\n        dxf.read_dxf(Path(sys.argv[1]))\n"
        "    except FileFormatError as error:\n        print(error.code, error)\n"
        "dxf.MAX_CPU_S = 60.0\n"
        "print(len(dxf.read_dxf(Path(sys.argv[2]))))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, costly, other],
        capture_output=True,
        text=True,
        timeout=WHOLE_S,
        check=True,
    )

    assert [
        f"large {costly}: takes more than 4 MiB to read: expected one part",
        f"large {costly}: takes more than 0.25 s of processor time to read: expected one part",
        "3",
    ] == ended.stdout.splitlines()


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("first", [False, True])
def test_a_line_that_leads_nowhere_is_named_by_its_loose_end(
    tmp_path: Path, flipped: bool, first: bool
) -> None:
    """The open end of a line is named, not the corner at its start, whichever end comes first in the file."""
    loose = ((-7.0, -8.0), (5.0, 0.0))
    loose = loose[::-1] if flipped else loose
    square = polygon(4, 5.0)

    with pytest.raises(FileFormatError, match=r"open: nothing goes on at \(-7.000, -8.000\) mm"):
        read_dxf(saved_lines([loose, *square] if first else [*square, loose], tmp_path))


@pytest.mark.slow
def test_lines_shorter_than_the_tolerance_are_joined(tmp_path: Path) -> None:
    """A curve of lines of a few micrometres is one outline with all its points."""
    lines = polygon(1000, 0.8)
    shuffled = [lines[k] for k in np.random.default_rng(0).permutation(len(lines))]

    (outline,) = read_dxf(saved_lines(shuffled, tmp_path))

    assert 1000 == len(outline)
    assert abs(area(outline)) == pytest.approx(np.pi * 0.8**2, rel=1e-4)


def test_a_thousand_lines_that_meet_at_one_point_are_no_outline(tmp_path: Path) -> None:
    """A thousand lines that meet at one point are refused."""
    rays = [((0.0, 0.0), (np.cos(t), np.sin(t))) for t in np.linspace(0.0, 6.0, 1000)]
    with pytest.raises(FileFormatError, match=r"at \(1.000, 0.000\) mm|at \(0.000, 0.000\) mm"):
        read_dxf(saved_lines(rays, tmp_path))


def test_what_is_no_flat_closed_drawing_is_named(tmp_path: Path) -> None:
    """An empty drawing, one that is not flat, and another file are refused with the reason."""
    with pytest.raises(FileFormatError, match="no closed outline"):
        read_dxf(saved(ezdxf.new(units=MM), tmp_path))
    spatial = ezdxf.new(units=MM)
    spatial.modelspace().add_line((0, 0, 0), (1, 0, 5))
    with pytest.raises(FileFormatError, match="not flat"):
        read_dxf(saved(spatial, tmp_path))
    (tmp_path / "foreign.dxf").write_bytes(b"\x89PNG\r\n")
    with pytest.raises(FileFormatError, match="not a DXF drawing"):
        read_dxf(tmp_path / "foreign.dxf")
    with pytest.raises(FileFormatError, match="cannot read a drawing"):
        read_dxf(tmp_path / "missing.dxf")


@settings(max_examples=40)
@given(st.data())
def test_a_damaged_drawing_is_an_outline_or_a_clear_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Bytes removed or changed anywhere give outlines or a FileFormatError with the file's name."""
    folder = tmp_path_factory.mktemp("dxf")
    whole = plate_bytes()
    start = data.draw(st.integers(0, len(whole) - 1))
    length = data.draw(st.integers(0, 400))
    junk = data.draw(st.binary(max_size=20))
    (folder / "bad.dxf").write_bytes(whole[:start] + junk + whole[start + length :])
    try:
        outlines = read_dxf(folder / "bad.dxf")
    except FileFormatError as error:
        assert "bad.dxf" in str(error)
    else:
        assert all(np.isfinite(outline).all() for outline in outlines)


def test_a_contour_is_text(tmp_path: Path) -> None:
    """A contour has a point per line, empty lines between outlines, and comments; a bad line is named by
    number."""
    path = tmp_path / "part.csv"
    path.write_text("# plate\n0,0\n10,0\n10;5\n0,5\n0,0\n\n\n2,2\n4,2\n4,4 # corner\n")
    assert areas(read_contour(path)) == pytest.approx([2, 50])
    for text, expected in (
        ("0,0\n1\n", "line 2: expected x,y"),
        ("0,0\n\n1,nan\n", "line 3: expected x,y in mm, got '1, nan'"),
        ("", "empty"),
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=expected):
            read_contour(path)
