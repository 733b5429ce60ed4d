"""Error messages on a page have the file's name, not its folder on this machine."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.adapters.web.routes import Problem
from edged.errors import FileFormatError, UserError, without_folders
from edged.files.touched import read_touched
from edged.setup.documents import Trouble
from edged.setup.drafts import trouble_in
from edged.setup.jobs.tasks import TaskProblem

NAMES = st.text(st.characters(exclude_characters="/:;,'\"<>()|", categories=("L", "N", "P")), min_size=1)
PATHS = st.lists(NAMES.filter(lambda name: name not in (".", "..")), min_size=2, max_size=6).map(
    lambda names: PurePosixPath("/", *names)
)
SAYINGS = ["{}: not JSON", "cannot read {}", "[{}] ({}, '{}'); {}", "{}:3: expected 6 values", 'in "{}"']


@given(PATHS, st.sampled_from(SAYINGS))
def test_no_error_of_a_page_says_where_a_file_lies(path: PurePosixPath, saying: str) -> None:
    """The answer to a request, the end of long work and a draft have the file's name without its folder."""
    error = FileFormatError(saying.replace("{}", str(path)))
    answer = Problem(422, "file", str(error)).response().body
    assert isinstance(answer, bytes)
    trouble = trouble_in(error)
    assert trouble is not None
    for said in (
        json.loads(answer)["detail"],
        TaskProblem(code="", detail=str(error)).detail,
        Trouble(code="", text=str(error)).text,
        trouble.text,
    ):
        assert str(path.parent) + "/" not in said
        assert path.name in said
        assert said == without_folders(said)


@pytest.mark.parametrize(
    "text",
    [
        "see /setup",
        "3/4 of the views",
        "http://cell/api/v1/marks",
        "../jobs/flange",
        "~/rig.json",
        "µm/K",
        "a // b",
    ],
)
def test_what_is_no_path_of_the_machine_stays(text: str) -> None:
    """Addresses, shares and relative paths are unchanged."""
    assert text == without_folders(text)


def test_a_touched_point_that_is_wrong_is_said_by_file_and_line(tmp_path: Path) -> None:
    """A wrong touched point is reported on the acceptance page with file and line, without the folder."""
    table = tmp_path / "touched.csv"
    table.write_text("1,2,3\n")
    with pytest.raises((UserError, FileFormatError)) as error:
        read_touched(table)
    assert str(tmp_path) in str(error.value)
    said = TaskProblem(code="input", detail=str(error.value)).detail
    assert said.startswith("touched.csv")
    assert str(tmp_path) not in said
