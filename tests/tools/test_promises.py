"""The page of promises names an existing test for each sentence."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "promises-to-the-plc.md"


def defined(file: Path) -> set[str]:
    """Functions and classes of a test file, and names of hypothesis's state machines."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return found


def flaws(text: str) -> list[str]:
    """Rows without a test, and tests that do not exist. A name without a file belongs to the file before
    it."""
    found = []
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| promise")]
    for row in rows:
        _, promise, tests, _ = re.split(r"\s*\|\s*", row)
        file, names = Path(), re.findall(r"`([^`]+)`", tests)
        if not promise.endswith(".") or not names:
            found.append(f"no sentence, or no test: {row}")
        for name in names:
            path, _, test = name.rpartition("::") if not name.endswith(".py") else (name, "", "")
            file = ROOT / path if path else file
            if not file.is_file() or (
                test and (not test.lower().startswith("test") or test not in defined(file))
            ):
                found.append(f"not there: {name}")
    return [*found, *([] if rows else ["no rows"])]


@pytest.mark.long
def test_every_promise_names_a_test_that_is_there() -> None:
    """Every promise on the page names an existing test."""
    assert [] == flaws(PAGE.read_text())


@pytest.mark.parametrize(
    ("row", "flaw"),
    [
        ("| It works. | |", "no sentence, or no test: | It works. | |"),
        ("| It works. | `tests/nowhere.py::test_it` |", "not there: tests/nowhere.py::test_it"),
        (
            "| It works. | `tests/tools/test_promises.py::test_it` |",
            "not there: tests/tools/test_promises.py::test_it",
        ),
        (
            "| It works. | `tests/tools/test_promises.py::flaws` |",
            "not there: tests/tools/test_promises.py::flaws",
        ),
        ("| It works. | `tests/tools/test_promises.py`, `test_it` |", "not there: test_it"),
    ],
)
def test_a_promise_without_a_test_is_found(row: str, flaw: str) -> None:
    """A row without a test, or with a missing file or test, is found."""
    assert [flaw] == flaws(row)
