"""Rendering of programs from templates, each a file in the language of its controller.

`templates/FORMAT/FILE.j2` is the template of a file; `any.TcPOU.j2` serves every file with that suffix. A
value is `@{...}`, because some languages index with braces; statements are `{% ... %}`. The comment
`{# ... #}` at the top names the manuals that the program relies on.
"""

from __future__ import annotations

import math
import re
import uuid
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from xml.sax.saxutils import escape

from jinja2 import Environment, PackageLoader, StrictUndefined

from edged.robots.structured_text import COMMENT, Code, codes, structures

NAMESPACE = uuid.UUID("6b1f1c1e-4f0b-5f5e-9a53-edf6e4444544")
"""Namespace for ids of TwinCAT objects: a name has the same id in every output, so a file can be replaced."""


def rendered(fmt: str, file: str, values: Mapping[str, object]) -> str:
    """Text of one file of a format. Raises `jinja2.UndefinedError` if its template lacks a value."""
    names = [f"{fmt}/{file}.j2", f"{fmt}/any{Path(file).suffix}.j2"]
    return _environment().select_template(names).render({"name": Path(file).stem, **values})


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("edged.robots"),
        autoescape=False,
        undefined=StrictUndefined,
        variable_start_string="@{",
        variable_end_string="}",
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "codes": codes,
        "structures": structures,
        "scl_body": scl_body,
        "object_id": lambda name: str(uuid.uuid5(NAMESPACE, name)),
        "listed": lambda numbers: ", ".join(f"{number} {name}" for name, number in numbers.items()),
        "numbered": _numbered,
        "radians": math.radians,
        "word": "16#{:04X}".format,
        "xml": escape,
    }
    return environment


def _numbered(text: str, form: str) -> str:
    """Prefix each line with its number, from 1."""
    return "".join(f"{form % number}{line}\n" for number, line in enumerate(text.splitlines(), 1))


SHIFT = re.compile(r"\b(SHL|SHR)\(((?:[^(),]|\([^()]*\))+), ([0-9]+)\)")
WORD = re.compile(r"(?<![\w.#\"])[A-Za-z_]\w*(?![\w#])")
FUNCTION = re.compile(r"F_EDGED_\w+")


def scl_body(code: Code) -> str:
    """Statements of a block in SCL: own names with #, functions in quotes, named parameters for shifts."""
    own = {variable.name for _, variables in code.sections for variable in variables} | {code.name}
    parts, end = [], 0
    for comment in COMMENT.finditer(code.body):
        parts += [_marked(code.body[end : comment.start()], own), comment[0]]
        end = comment.end()
    return "".join((*parts, _marked(code.body[end:], own)))


def _marked(text: str, own: set[str]) -> str:
    text = SHIFT.sub(r"\1(IN := \2, N := \3)", text)
    depth, marked, end = 0, [], 0
    for word in WORD.finditer(text):
        between = text[end : word.start()]
        depth += between.count("(") - between.count(")")
        name, end_of_word = word[0], word.end()
        is_formal = depth > 0 and text[end_of_word:].lstrip().startswith(":=")
        if name in own and not is_formal:
            name = f"#{name}"
        elif FUNCTION.fullmatch(name):
            name = f'"{name}"'
        marked += [between, name]
        end = end_of_word
    return "".join((*marked, text[end:]))
