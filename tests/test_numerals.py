"""Numbers in foreign texts: only usual notations are accepted, in every reader."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import ezdxf
import numpy as np
import pytest

from edged.commands.teach import parse_contrast, parse_region
from edged.commands.verify import parse_length
from edged.domain.arrays import FloatArray
from edged.domain.numerals import json_of
from edged.errors import UserError
from edged.files.dxf import read_dxf
from edged.files.pairs import next_number
from edged.files.rigformats.files import Fields, parse_size
from edged.files.stl import read_stl
from edged.identity.auditchain import head_in
from edged.robot.pendant import numbers_in
from edged.setup.calibration.boards import stated_boards
from edged.sim.console import number

TEXTS = ["1_0", "\u0661\u0662", "\uff11", "nan", "inf", "-infinity", "1e400", "1__"]
"""Texts that Python's `int` or `float` mostly reads."""


def _stl(text: str, folder: Path) -> object:
    """A tetrahedron with a corner at this number."""
    corners = [f"{text} 0 0", "0 10 0", "0 0 10", "0 0 0"]
    facets = [
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {corners[n]}\n" for n in face)
        + "endloop\nendfacet\n"
        for face in ((0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2))
    ]
    file = folder / "part.stl"
    file.write_text("solid a\n" + "".join(facets) + "endsolid a\n", encoding="utf-8")
    return read_stl(file)


def _drawing(text: str, folder: Path) -> list[FloatArray]:
    """A square with a corner at this number."""
    document = ezdxf.new(units=4)
    document.modelspace().add_lwpolyline([(7.25, 0), (20, 0), (20, 20), (0, 20)], close=True)
    out = io.StringIO()
    document.write(out)
    file = folder / "part.dxf"
    file.write_text(re.sub(r"(?m)^7\.25$", text, out.getvalue()), encoding="utf-8")
    return read_dxf(file)


def _head(text: str, _folder: Path) -> object:
    """The head of an audit with a text as number."""
    found = head_in(json.dumps({"number": text, "hash": "0" * 64}).encode())
    if found is None:
        raise UserError("no head")
    return found


def _camera_field(text: str, folder: Path) -> object:
    return Fields(folder / "cam.yaml", {"K": [text, 1.0, 2.0]}).numbers("K")


DOORS: dict[str, Callable[[str, Path], object]] = {
    "a model's corner": _stl,
    "a drawing's corner": _drawing,
    "a rig's field": _camera_field,
    "an audit's head": _head,
    "a pasted pose": lambda text, _: numbers_in(f"X {text}, Y 2, Z 3", (3,)),
    "--length": lambda text, _: parse_length(f"c0={text}"),
    "--region": lambda text, _: parse_region(f"0,0,{text},50"),
    "--contrast": lambda text, _: parse_contrast(f"{text},99"),
    "an image size": lambda text, _: parse_size(f"{text}x960"),
    "a square's length": lambda text, _: stated_boards(text),
    "a fault of a virtual camera": lambda text, _: number("loss", text, 0, 1e9),
}


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("door", DOORS)
def test_what_only_python_reads_is_no_number(door: str, text: str, tmp_path: Path) -> None:
    """Underscores, digits of other alphabets and values that are not finite are refused."""
    with pytest.raises(UserError):
        DOORS[door](text, tmp_path)


@pytest.mark.parametrize("text", ["1", "12.5", "-3", "1e1", ".5"])
def test_what_is_one_is_read(text: str, tmp_path: Path) -> None:
    """Numbers with signs, points and exponents are read."""
    expected = float(text)
    assert (expected, 2.0, 3.0) == numbers_in(f"X {text}, Y 2, Z 3", (3,))
    assert 1 == len(_drawing(text, tmp_path))
    found = Fields(tmp_path, {"K": [text, 1, 2.0]}).numbers("K")
    np.testing.assert_array_equal([expected, 1.0, 2.0], found)


@pytest.mark.parametrize("text", ["NaN", "[Infinity]", '{"a": -Infinity}', "1e400", "[1.0e999]"])
def test_json_has_finite_numbers_alone(text: str) -> None:
    """NaN and infinities in JSON are refused (RFC 8259, 6)."""
    with pytest.raises(ValueError, match="number"):
        json_of(text)
    assert {"a": [1, 2.5, None]} == json_of('{"a": [1, 2.5, null]}')


def test_a_head_beyond_all_numbers_is_no_head() -> None:
    """A head with a number that is too large, a float, true or negative is refused."""
    for value in ("1e400", "1.5", "true", "-1"):
        assert None is head_in(f'{{"number": {value}, "hash": "x"}}'.encode())


def test_digits_are_those_of_ascii() -> None:
    r"""No source uses `\d`, isdigit, isdecimal or isnumeric, which accept digits of every alphabet."""
    any_digit = re.compile(r"\\d\b|\\d[+*{?)\]]|\.is(?:digit|decimal|numeric)\(")
    sources = (Path(__file__).parents[1] / "edged").rglob("*.py")
    assert [] == [(source, found) for source in sources if (found := any_digit.findall(source.read_text()))]


def test_a_picture_numbered_in_another_alphabet_counts_for_nothing(tmp_path: Path) -> None:
    """A picture with digits of another alphabet, or an underscore, in its number is not counted."""
    for name in ("view_07_left.png", "view_\u0669\u0669_left.png", "view_1_0_left.png"):
        (tmp_path / name).touch()
    assert 8 == next_number(tmp_path, "view")
