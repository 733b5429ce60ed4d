"""Parser of structured text: the same types, functions and blocks go into the files of several makers."""

from __future__ import annotations

import re
from dataclasses import dataclass

COMMENT = re.compile(r"\(\*.*?\*\)", re.S)
_TYPE = re.compile(r"^TYPE (?P<name>\w+) :\nSTRUCT\n(?P<fields>.*?)END_STRUCT;\nEND_TYPE$", re.M | re.S)
_CODE = re.compile(
    r"(?P<comment>(?:^\(\*(?:(?!\*\)).)*\*\)\n)?)"
    r"^(?P<keyword>FUNCTION|FUNCTION_BLOCK) (?P<name>\w+)(?: : (?P<returns>\w+))?\n"
    r"(?P<sections>(?:VAR\w*\n.*?END_VAR\n)+)(?P<body>.*?)END_(?P=keyword)$",
    re.M | re.S,
)
_SECTION = re.compile(r"^(VAR\w*)\n(.*?)END_VAR\n", re.M | re.S)
_VARIABLE = re.compile(r"^ *(\w+) : ([^;]*?)(?: := ([^;]*))?;(?: \(\* (.*) \*\))?$", re.M)
_ARRAY = re.compile(r"ARRAY\[([0-9]+)\.\.([0-9]+)\] OF (\w+)")


@dataclass(frozen=True, slots=True)
class DeclaredVariable:
    """One declaration. bounds : of an array, whose elements are of `type`; None if it is not an array."""

    name: str
    type: str
    bounds: tuple[int, int] | None
    initial: str
    comment: str


@dataclass(frozen=True, slots=True)
class Structure:
    """A data type with its fields."""

    name: str
    fields: tuple[DeclaredVariable, ...]


@dataclass(frozen=True, slots=True)
class Code:
    """Function, or function block (returns is ""). declaration : its source without comment and body."""

    keyword: str
    name: str
    returns: str
    comment: str
    declaration: str
    sections: tuple[tuple[str, tuple[DeclaredVariable, ...]], ...]
    body: str


def structures(source: str) -> tuple[Structure, ...]:
    """All data types in a source."""
    return tuple(Structure(found["name"], _variables(found["fields"])) for found in _TYPE.finditer(source))


def codes(source: str) -> tuple[Code, ...]:
    """All functions and function blocks in a source."""
    return tuple(
        Code(
            keyword=found["keyword"],
            name=found["name"],
            returns=found["returns"] or "",
            comment=found["comment"].strip(),
            declaration=source[found.start("keyword") : found.start("body")],
            sections=tuple((name, _variables(text)) for name, text in _SECTION.findall(found["sections"])),
            body=found["body"],
        )
        for found in _CODE.finditer(source)
    )


def _variables(text: str) -> tuple[DeclaredVariable, ...]:
    variables = []
    for name, kind, initial, comment in _VARIABLE.findall(text):
        array = _ARRAY.fullmatch(kind)
        bounds = (int(array[1]), int(array[2])) if array else None
        variables.append(DeclaredVariable(name, array[3] if array else kind, bounds, initial, comment))
    return tuple(variables)
