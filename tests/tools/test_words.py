"""The words of the code: one name for one thing, and plain words. Both lists may only get shorter."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@cache
def _trees() -> dict[Path, ast.Module]:
    """Every module, parsed once and only if needed."""
    return {path: ast.parse(path.read_text()) for path in sorted((ROOT / "edged").rglob("*.py"))}


BANNED = {
    **dict.fromkeys(
        (
            *("house", "shelves", "desk", "desks", "doors", "sights", "whoever"),
            *("rooms", "shelf", "door", "guest", "guests", "told"),
        ),
        0,
    ),
    "room": 13,
    "sight": 19,
    "one": 15,
}
"""Words that readers do not know, and the number of names that still have them."""

HALF_SENTENCES = ("Of ", "The same ")
HALF = 2
"""The number of docstrings that only continue the sentence of a name."""


def _names(tree: ast.AST) -> Iterator[str]:
    """Every name that a module defines: classes, functions, arguments, variables, attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case (
                ast.arg(arg=name)
                | ast.Name(id=name, ctx=ast.Store())
                | ast.Attribute(attr=name, ctx=ast.Store())
            ):
                yield name


def _words(name: str) -> list[str]:
    """The words of a camelCase or snake_case name, in lower case."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]


@pytest.mark.long
def test_no_public_class_name_stands_twice() -> None:
    """No two public classes have the same name."""
    places = defaultdict[str, set[Path]](set)
    for path, tree in _trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].add(path)

    assert {} == {name: found for name, found in places.items() if len(found) > 1}


@pytest.mark.slow
def test_names_are_words_of_the_field() -> None:
    """No banned word is in more names than its limit."""
    found = Counter(
        word
        for path, tree in _trees().items()
        for name in (path.stem, *_names(tree))
        for word in _words(name)
        if word in BANNED
    )
    print(dict(found))

    assert {} == {word: count for word, count in found.items() if count > BANNED[word]}


@pytest.mark.slow
def test_a_docstring_is_a_sentence_of_its_own() -> None:
    """No more docstrings than the limit only continue the name that they describe."""
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, tree in _trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if str(node.value.value).startswith(HALF_SENTENCES)
    ]

    assert len(found) <= HALF, found


def test_the_search_finds_what_it_looks_for() -> None:
    """The search finds both spellings of a name, and every place where a name is defined."""
    tree = ast.parse(
        "class OpenDoor:\n    def __init__(self, guest):\n        self.my_room, one = guest, 1\n"
    )

    assert ["open", "door"] == _words("OpenDoor")
    assert {"OpenDoor", "__init__", "self", "guest", "my_room", "one"} == set(_names(tree))
