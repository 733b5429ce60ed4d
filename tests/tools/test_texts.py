"""The texts of the pages that set a cell up: complete in each language, and all of them used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

SETUP = Path(__file__).resolve().parents[2] / "edged" / "adapters" / "web" / "static" / "setup"
SCRIPTS = {path.stem: path.read_text() for path in sorted(SETUP.rglob("*.js"))}
ALL_SCRIPTS = "\n".join(SCRIPTS.values())
ENTRY = re.compile(r"^([a-z][a-z0-9-]*) =(.*(?:\n[ }].*)*)", re.MULTILINE)
VALUE = re.compile(r"\$(\w+)")
PAGES = sorted({path.name.split(".")[0] for path in (SETUP / "pages").glob("*.ftl")})
PARTS = ["", *PAGES]
"""Files of texts: around the pages, and of each page."""


def families(script: str) -> set[str]:
    """What ids begin with that are made of a code: state-, why-, step-."""
    made = set(re.findall(r"`([a-z-]+-)\$\{", script))
    return made | {f"{name}-" for name in re.findall(r"\binWords\(\"([a-z-]+)\"", script)}


FAMILIES = families(ALL_SCRIPTS)


def entries(part: str, language: str) -> list[tuple[str, str]]:
    """Ids and texts of a file, in its order."""
    path = SETUP / "pages" / f"{part}.{language}.ftl" if part else SETUP / f"{language}.ftl"
    return [(name, text) for name, text in ENTRY.findall(path.read_text())]


ENGLISH = {part: dict(entries(part, "en")) for part in PARTS}
GERMAN = {part: dict(entries(part, "de")) for part in PARTS}


def scripts_of(page: str) -> set[str]:
    """The modules that a page is made of, down to those it imports."""
    found, wanted = set(), [page]
    while wanted:
        name = wanted.pop()
        if name not in found and name in SCRIPTS:
            found.add(name)
            wanted += re.findall(r'(?:from|import) "[./]+/(\w+)\.js"', SCRIPTS[name])
    return found


@pytest.mark.parametrize("part", PARTS)
def test_german_says_what_english_says(part: str) -> None:
    """Every text, and in it every value that the page knows."""
    assert list(ENGLISH[part]) == list(GERMAN[part])
    for name, text in ENGLISH[part].items():
        assert set(VALUE.findall(text)) == set(VALUE.findall(GERMAN[part][name])), name
        assert text.strip(), name
        assert GERMAN[part][name].strip(), name


@pytest.mark.parametrize("language", ["en", "de"])
def test_no_text_stands_twice(language: str) -> None:
    """An id has one text in each language: which page came first must not matter."""
    names = [name for part in PARTS for name, _ in entries(part, language)]

    assert len(names) == len(set(names))


@pytest.mark.parametrize("page", PAGES)
def test_every_text_that_a_page_asks_for_comes_with_it(page: str) -> None:
    """Whole ids are in its file or that around the pages; of a family (step-NAME) at least two are."""
    there = {**ENGLISH[""], **ENGLISH[page]}
    for script in scripts_of(page):
        for name in re.findall(r"\bt\(\s*\"([^\"]+)\"", SCRIPTS[script]):
            assert name in there, script
        for start in families(SCRIPTS[script]):
            assert 2 <= sum(name.startswith(start) for name in there), (script, start)


def test_every_text_around_the_pages_is_there() -> None:
    """What stands around them speaks before any page has come."""
    for script in scripts_of("main"):
        for name in re.findall(r"\bt\(\s*\"([^\"]+)\"", SCRIPTS[script]):
            assert name in ENGLISH[""], script


def test_every_text_is_used() -> None:
    """By its id, by an id that a condition chooses, or as one of a family."""
    begun = tuple(FAMILIES)
    names = [name for part in PARTS for name in ENGLISH[part]]

    assert [] == [name for name in names if f'"{name}"' not in ALL_SCRIPTS and not name.startswith(begun)]


def test_every_page_has_texts() -> None:
    """A page that is entered asks for its own: NAME.js has NAME.en.ftl."""
    entered = re.findall(r'import\("\./pages/(\w+)\.js"\)', SCRIPTS["steps"])

    assert len(entered) >= 2
    assert PAGES == sorted(entered)
