"""The texts of the pages that set a cell up: complete in each language, and all of them used."""

from __future__ import annotations

import re
from pathlib import Path

SETUP = Path(__file__).resolve().parents[2] / "edged" / "adapters" / "web" / "static" / "setup"
SCRIPTS = "\n".join(path.read_text() for path in sorted(SETUP.glob("*.js")))
ENTRY = re.compile(r"^([a-z][a-z0-9-]*) =(.*(?:\n[ }].*)*)", re.MULTILINE)
VALUE = re.compile(r"\$(\w+)")


FAMILIES = set(re.findall(r"`([a-z-]+-)\$\{", SCRIPTS)) | {
    f"{name}-" for name in re.findall(r"\bcoded\(\"([a-z]+)\"", SCRIPTS)
}
"""What ids begin with that are made of a code: state-, why-, step-."""


def texts(language: str) -> dict[str, str]:
    """Ids to texts."""
    return dict(ENTRY.findall((SETUP / f"{language}.ftl").read_text()))


ENGLISH, GERMAN = texts("en"), texts("de")


def test_german_says_what_english_says() -> None:
    """Every text, and in it every value that the page knows."""
    assert list(ENGLISH) == list(GERMAN)
    for name, text in ENGLISH.items():
        assert set(VALUE.findall(text)) == set(VALUE.findall(GERMAN[name])), name
        assert text.strip(), name
        assert GERMAN[name].strip(), name


def test_no_text_stands_twice() -> None:
    """An id has one text in each file."""
    for language in ("en", "de"):
        names = [name for name, _ in ENTRY.findall((SETUP / f"{language}.ftl").read_text())]
        assert len(names) == len(set(names))


def test_every_text_that_a_page_asks_for_is_there() -> None:
    """Whole ids are in the file; of a family, such as step-NAME, at least two are."""
    for name in re.findall(r"\bt\(\s*\"([^\"]+)\"", SCRIPTS):
        assert name in ENGLISH
    for start in FAMILIES:
        assert 2 <= sum(name.startswith(start) for name in ENGLISH), start


def test_every_text_is_used() -> None:
    """By its id, by an id that a condition chooses, or as one of a family."""
    families = tuple(FAMILIES)

    assert [] == [name for name in ENGLISH if f'"{name}"' not in SCRIPTS and not name.startswith(families)]
