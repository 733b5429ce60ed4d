"""Rules for the pages' scripts that tools/scripts does not check."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

STATIC = Path(__file__).resolve().parents[2] / "edged" / "adapters" / "web" / "static"
SCRIPTS = {
    path.relative_to(STATIC).as_posix(): path.read_text()
    for folder in ("run", "setup")
    for path in (STATIC / folder).rglob("*.js")
}
TOPICS = {
    "acceptance",
    "calibration",
    "cell",
    "marking",
    "recordings",
    "registration",
    "releases",
    "teaching",
    "trials",
}
KNOWN = {"recordings", "releases", "shared"}
"""Folders of setup/ that any topic may import."""


def test_no_line_is_longer_than_those_of_python() -> None:
    """No line is longer than Python's lines, also in templates, texts and comments."""
    longer = [(name, line) for name, text in SCRIPTS.items() for line in text.splitlines() if len(line) > 110]

    assert [] == longer


def test_topics_know_each_other_only_through_releases_and_recordings() -> None:
    """Topics import each other only through releases, recordings and shared, and not the module that loads
    the pages."""
    assert TOPICS == {name.split("/")[1] for name in SCRIPTS if name.count("/") == 2} - {"shared"}
    for name, text in SCRIPTS.items():
        folder = posixpath.dirname(name)
        if folder.removeprefix("setup/") not in TOPICS | {"shared"}:
            continue
        imported = {
            posixpath.normpath(posixpath.join(folder, other))
            for other in re.findall(r'(?:from|import) ?\(?"([./]+[\w/]+\.js)"', text)
        }
        allowed = {
            "vendor",
            folder,
            *(f"setup/{known}" for known in (KNOWN if folder != "setup/shared" else ())),
        }
        beyond = {other for other in imported if posixpath.dirname(other) not in allowed}
        assert beyond <= {"setup/steps.js"}, name
