"""The examples in docstrings and on the manual's pages run and give what they show."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import cv2
import pytest

ROOT = Path(__file__).parents[2]
SHOWING = [path for path in sorted((ROOT / "edged").rglob("*.py")) if ">>> " in path.read_text()]
PAGE = ROOT / "docs/tutorial/library.md"


@pytest.mark.parametrize("path", SHOWING, ids=lambda path: str(path.relative_to(ROOT)))
def test_examples_show_what_comes_out(path: Path) -> None:
    """The examples of the module give what they show."""
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    ran = doctest.testmod(importlib.import_module(name))
    assert ran.attempted > 0
    assert 0 == ran.failed


@pytest.mark.long
def test_the_tutorial_of_the_library_shows_what_comes_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tutorial's examples, from public pictures to the ellipse, give what the page shows, and its
    picture."""
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    monkeypatch.chdir(tmp_path)
    ran = doctest.testfile(str(PAGE), module_relative=False, optionflags=doctest.ELLIPSIS)

    assert ran.attempted > 30
    assert 0 == ran.failed
    assert cv2.imread(str(PAGE.with_name("ellipse.png"))).shape == cv2.imread("ellipse.png").shape
