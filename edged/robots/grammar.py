"""Reserved words and limits on names, lines and strings of the makers' languages, from `grammars/*.toml`.

There is one table for each language, with its source. Every program is checked against it when it is
generated; the interpreters in the tests check programs against the same table, but find the names in their
own way.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Grammar:
    """Names, lines and strings that a language allows; a generated program that breaks these rules is a bug.

    words : reserved, or predefined and not to be declared again; in capitals where case is ignored.
    shape : of a name. longest : characters of a "name", a "line", a "text"; a missing one has no known limit.
    declared : patterns of declarations. refused : patterns that controllers reject, and why.
    """

    language: str
    source: str
    ignores_case: bool
    words: frozenset[str]
    shape: re.Pattern[str]
    longest: Mapping[str, int]
    comment: re.Pattern[str]
    text: re.Pattern[str]
    declared: tuple[re.Pattern[str], ...]
    refused: tuple[tuple[re.Pattern[str], str], ...]
    line_end: str

    def allow(self, name: str) -> str:
        """Return the name if a program may declare it. Raises `ValueError` otherwise."""
        if (name.upper() if self.ignores_case else name) in self.words:
            raise ValueError(f"{self.language}: {name} is a word of the language")
        if not self.shape.fullmatch(name):
            raise ValueError(f"{self.language}: {name} is no name")
        return self.fits("name", name)

    def fits(self, kind: str, text: str) -> str:
        """Return the name, line or string. Raises `ValueError` if it is too long."""
        limit = self.longest.get(kind)
        if limit is not None and len(text) > limit:
            raise ValueError(
                f"{self.language}: {text!r} has {len(text)} characters, a {kind} at most {limit}"
            )
        return text

    def checked(self, source: str) -> str:
        """Return the program with its language's line ends.

        Raises `ValueError` for a name, line, string or pattern that its controller would not accept.
        """
        for line in source.splitlines():
            self.fits("line", line)
        for name in self.names(source):
            self.allow(name)
        bare = self.comment.sub("", source)
        for literal in self.text.finditer(bare):
            self.fits("text", literal[1])
        for pattern, why in self.refused:
            if found := pattern.search(source):
                raise ValueError(f"{self.language}: {found[0]!r}: {why}")
        return source.replace("\n", self.line_end)

    def names(self, source: str) -> Iterator[str]:
        """Names that a program declares, some more than once."""
        bare = self.comment.sub("", source)
        for pattern in self.declared:
            yield from (found[1] for found in pattern.finditer(bare))


@cache
def grammar(language: str) -> Grammar:
    """Load the table of a language."""
    text = files("edged.robots").joinpath(f"grammars/{language}.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    ignores_case = table["ignores_case"]
    words = f"{table['reserved']} {table['predefined']}"
    return Grammar(
        language=language,
        source=" ".join(table["source"].split()),
        ignores_case=ignores_case,
        words=frozenset((words.upper() if ignores_case else words).split()),
        shape=re.compile(table["shape"]),
        longest=table["longest"],
        comment=re.compile(table["comment"], re.M),
        text=re.compile(table["text"]),
        declared=tuple(re.compile(pattern, re.M) for pattern in table["declared"]),
        refused=tuple((re.compile(row["pattern"], re.M), row["why"]) for row in table.get("refused", ())),
        line_end=table.get("line_end", "\n"),
    )
