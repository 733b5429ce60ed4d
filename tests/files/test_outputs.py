"""Outputs that cannot be written, or would overwrite something, are refused before the work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from edged.errors import FileFormatError, UserError
from edged.files.atomic import write_file
from edged.files.outputs import check_folder, check_outputs

FORBIDDEN = Path("/proc")
"""A folder that takes no new file, not even root's."""


def test_two_outputs_with_one_path_are_refused(tmp_path: Path) -> None:
    """Two outputs with the same file, however it is written, are refused."""
    again = tmp_path / "x" / ".." / "x.json"
    with pytest.raises(UserError, match="--output and --report are the same file"):
        check_outputs({"--output": tmp_path / "x.json", "--report": again})
    check_outputs({"--output": tmp_path / "x.json", "--report": tmp_path / "x.html", "--cloud": None})


def test_an_output_that_is_an_input_is_refused(tmp_path: Path) -> None:
    """An output that would replace an input is refused."""
    with pytest.raises(UserError, match=r"--overlay is LEFT, .* would be lost"):
        check_outputs({"--overlay": tmp_path / "a.png"}, {"LEFT": tmp_path / "a.png"})


@pytest.mark.parametrize(
    ("path", "expected"),
    [(FORBIDDEN / "x.json", "cannot be written into /proc"), (Path("/nowhere/x"), "no folder /nowhere")],
)
def test_a_place_that_takes_no_file_is_refused(path: Path, expected: str) -> None:
    """A place that takes no file is refused with the folder and the reason."""
    with pytest.raises(UserError, match=expected):
        check_outputs({"--output": path})


def test_a_folder_is_looked_at_where_it_would_be_made(tmp_path: Path) -> None:
    """For a folder that does not exist yet the nearest one above is checked; a file in the way is named."""
    check_folder(tmp_path / "a" / "b")
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "b", FORBIDDEN / "a" / "b"):
        with pytest.raises(UserError, match=re.escape(str(path))):
            check_folder(path)
    assert ["file"] == [entry.name for entry in tmp_path.iterdir()]


def test_what_the_disc_refuses_is_an_error_of_ours() -> None:
    """If the system refuses to write, the error is a FileFormatError with the path."""
    with pytest.raises(FileFormatError, match=r"/proc/x.json: cannot be written"):
        write_file(FORBIDDEN / "x.json", b"x")
