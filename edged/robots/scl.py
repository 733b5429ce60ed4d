"""Bodies of structured text as SCL writes them, for SIMATIC S7."""

from __future__ import annotations

import re

from edged.robots.structured_text import COMMENT, Code

SHIFT = re.compile(r"\b(SHL|SHR)\(((?:[^(),]|\([^()]*\))+), (\d+)\)")
WORD = re.compile(r"(?<![\w.#\"])[A-Za-z_]\w*(?![\w#])")
FUNCTION = re.compile(r"F_EDGED_\w+")


def scl_body(code: Code) -> str:
    """The statements of a block: its own names with #, functions in quotes, named parameters for shifts."""
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
