"""Markdown as used in the manual, and documentation in the code that is not available at run time."""

from __future__ import annotations

import ast
import enum
import inspect
import re
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, numbers: int = 0) -> str:
    """A table; its first columns, as many as `numbers` says, are aligned to the right."""
    lines = [
        "| " + " | ".join(head) + " |",
        "|" + "|".join("---:" if column < numbers else "---" for column in range(len(head))) + "|",
    ]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: object) -> str:
    return re.sub(r"[ \n]+", " ", str(value).replace("|", "\\|")).strip()


def code(value: object) -> str:
    """Format as code."""
    return f"`{value}`"


def number(value: float) -> str:
    """1500000 as 1 500 000, with no-break spaces; fractions as they are."""
    if float(value).is_integer():
        return f"{int(value):,}".replace(",", "\N{NO-BREAK SPACE}")
    return f"{value:g}"


def anchor(heading: str) -> str:
    """The address of a heading on its page, as Python-Markdown and the usual repository pages make it."""
    kept = "".join(sign for sign in heading.lower() if sign.isalnum() or sign in " -_")
    return "-".join(kept.split())


def first_line(thing: object) -> str:
    """The first line of a docstring, without its full stop."""
    return (inspect.getdoc(thing) or "").partition("\n")[0].removesuffix(".")


def member_docs(codes: type[enum.Enum]) -> dict[str, str]:
    """The string below each member of an enumeration: "" if there is none."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(codes))).body
    assert isinstance(body, ast.ClassDef)
    found: dict[str, str] = {}
    name = ""
    for statement in body.body:
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)]):
                found[name] = ""
            case ast.Expr(value=ast.Constant(value=str(text))) if name:
                found[name] = " ".join(text.split())
    return {member: found[member] for member in codes.__members__}
