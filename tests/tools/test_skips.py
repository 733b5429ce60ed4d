"""A run in continuous integration fails if a test is skipped that must not be, and says which."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import skips

BOTH = """
import pytest


def test_that_wants_something():
    pytest.skip("no such thing")


def test_of_nothing():
    assert {holds}
"""


@pytest.mark.slow
@pytest.mark.parametrize(("ci", "holds", "code"), [
    ("true", True, skips.UNEXPECTED),
    ("true", False, skips.UNEXPECTED),  # not that of failed tests, which alone are run again
    ("", True, 0),
    ("", False, 1),
])  # fmt: skip
def test_an_unexpected_skip_fails_a_run_as_nothing_else_does(
    tmp_path: Path, ci: str, holds: bool, code: int
) -> None:
    """The skipped test is named in any case."""
    (tmp_path / "test_both.py").write_text(BOTH.format(holds=holds))
    helpers = Path(skips.__file__).parent.parent
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "helpers.skips",
            "-p",
            "no:cacheprovider",
            "test_both.py",
        ],
        cwd=tmp_path,
        env={**os.environ, "CI": ci, "PYTHONPATH": str(helpers)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code
    assert "test_that_wants_something: no such thing" in done.stdout
