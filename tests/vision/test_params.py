"""Numbers of the numerical core: tuned ones are in the Params of their stage, each with its source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

VISION = Path(__file__).parents[2] / "edged" / "vision"
SOURCES = sorted(VISION.rglob("*.py"))
STAGES = sorted(VISION.glob("*/params.py"))


def _undocumented(text: str, body: list[ast.stmt]) -> Iterator[str]:
    """Assignments without a comment on their line or above, and without a docstring below."""
    lines = text.splitlines()
    for statement, below in zip(body, [*body[1:], None], strict=True):
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        beside = "#" in lines[(statement.end_lineno or 1) - 1]
        above = lines[statement.lineno - 2].lstrip().startswith("#")
        told = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if not (beside or above or told):
            yield ast.unparse(statement)


def _is_number(text: str) -> bool:
    value = text.rpartition(" = ")[2]
    return re.fullmatch(r"\(?-?\d[\d.e_-]*(, -?\d[\d.e_-]*)*\)?", value) is not None


@pytest.mark.slow
def test_a_number_of_a_module_says_why_it_is_none_of_its_stage() -> None:
    """Every number of a module outside of a stage's Params has a comment or a docstring."""
    for source in SOURCES:
        text = source.read_text()

        lines = _undocumented(text, ast.parse(text).body)
        assert [] == [line for line in lines if _is_number(line)], source


@pytest.mark.parametrize("source", STAGES, ids=lambda path: path.parent.name)
def test_every_field_of_a_stage_has_its_source(source: Path) -> None:
    """Every field of a stage has a comment or docstring with its source."""
    text = source.read_text()
    stages = [
        node
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef)
        and node.name.endswith("Params")
        and "bench ablate" in (ast.get_docstring(node) or "")
    ]

    assert stages
    assert [] == [line for stage in stages for line in _undocumented(text, stage.body[1:])]


@pytest.mark.long
def test_every_field_of_a_stage_is_read() -> None:
    """Every field of a stage is read somewhere."""
    sources = [ast.parse(source.read_text()) for source in sorted(VISION.parent.rglob("*.py"))]
    read = {node.attr for tree in sources for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    stages = [node for path in STAGES for node in ast.parse(path.read_text()).body]
    names = {
        line.target.id
        for stage in stages
        if isinstance(stage, ast.ClassDef)
        for line in stage.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
    }

    assert len(names) > 400
    assert set() == names - read
