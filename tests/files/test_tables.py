"""Tables in usual variants give the same numbers."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.errors import FileFormatError
from edged.files.tables import number_of, read_table, split

EXPECTED = [("a.json", "412.30", "-88.12", "35.4"), ("b.json", "1", "2.5", "3")]


@pytest.mark.parametrize(
    "data",
    [
        b"a.json,412.30,-88.12,35.4\nb.json, 1, 2.5, 3\n",
        b"\xef\xbb\xbfa.json;412,30;-88,12;35,4\r\nb.json;1;2,5;3\r\n",
        b"a.json\t412,30\t-88,12\t35,4\nb.json\t1\t2.5\t3\n",
        b"Name;X;Y;Z\n;mm;mm;mm\na.json;412,30;-88,12;35,4\nb.json;1;2,5;3\n",
        b"file,x,y,z  # header\n\na.json 412,30 -88,12 35,4\nb.json 1 2,5 3\n",
        b'"a.json","412.30","-88.12","35.4"\n"b.json","1","2.5","3"\n# the end\n',
        "a.json;412,30;-88,12;35,4\nb.json;1;2,5;3\n".encode("utf-16"),
    ],
    ids=["commas", "Excel, German", "tabs", "two headers", "spaces", "quotes", "UTF-16"],
)
def test_a_table_is_read_however_it_was_saved(tmp_path: Path, data: bytes) -> None:
    """Byte order marks, separators, decimal signs, headers and comments are understood."""
    (tmp_path / "t.csv").write_bytes(data)
    assert EXPECTED == [line.cells for line in read_table(tmp_path / "t.csv") if line.cells]


@given(
    st.lists(st.floats(-1e6, 1e6).map(lambda x: round(x, 4)), min_size=2, max_size=8),
    st.sampled_from(";\t ,"),
)
def test_a_line_of_numbers_comes_back(values: list[float], separator: str) -> None:
    """Numbers read back equal, with a decimal comma if the separator is another sign."""
    comma = separator != ","
    text = separator.join(f"{value:.4f}".replace(".", ",") if comma else f"{value:.4f}" for value in values)
    assert values == [number_of(cell) for cell in split(text)]


@pytest.mark.parametrize("cell", ["1_0", "\u0661", "nan", "inf", "1e400", "0x10", "1 0", ""])
def test_what_only_python_takes_for_a_number_is_none(cell: str) -> None:
    """Numbers in Python's own notations are refused."""
    with pytest.raises(ValueError, match="expected a finite number"):
        number_of(cell)


@pytest.mark.parametrize(
    ("data", "expected"), [(b"", "empty"), (b"a;b\n", "no line with numbers"), (b"\xff\xfe\x00", "UTF")]
)
def test_what_is_no_table_is_named(tmp_path: Path, data: bytes, expected: str) -> None:
    """A file that is no table is refused, with a remedy if there is one."""
    (tmp_path / "t.csv").write_bytes(data)
    with pytest.raises(FileFormatError, match=expected):
        read_table(tmp_path / "t.csv")
