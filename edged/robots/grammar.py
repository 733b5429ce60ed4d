"""Which names a maker's language refuses, and how long names, lines and texts may be: `grammars/*.toml`.

One table for each language, with its source beside it. What is written is held against it here; the
interpreters of the tests hold what they read against the same table, and find the names in their own way.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

_FILES = {
    ".kl": "karel",
    ".ls": "tp",
    ".src": "krl",
    ".dat": "krl",
    ".pgx": "val3",
    ".dtx": "val3",
    ".prg": "melfa",
    ".c": "c",
    ".JBI": "inform",
    ".TcPOU": "iec",
    ".TcDUT": "iec",
}
"""Languages by the ends of files; a configuration (.xml, .pjx) has none."""


@dataclass(frozen=True, slots=True)
class Grammar:
    """Names, lines and texts that a language takes; what it does not take is a bug of whoever wrote it.

    words : reserved, or predefined and not to be declared anew; in capitals where case is ignored. shape : of
    a name. longest : characters of a "name", a "line", a "text"; what is missing has no limit that is known.
    declared : patterns of where names are declared. refused : patterns that no controller reads, and why.
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

    def allow(self, name: str) -> str:
        """The name of something that a program declares. Raises `ValueError`."""
        if (name.upper() if self.ignores_case else name) in self.words:
            raise ValueError(f"{self.language}: {name} is a word of the language")
        if not self.shape.fullmatch(name):
            raise ValueError(f"{self.language}: {name} is no name")
        return self.fits("name", name)

    def fits(self, kind: str, text: str) -> str:
        """A name, a line or a text. Raises `ValueError` for one that is too long."""
        limit = self.longest.get(kind)
        if limit is not None and len(text) > limit:
            raise ValueError(
                f"{self.language}: {text!r} has {len(text)} characters, a {kind} at most {limit}"
            )
        return text

    def check(self, source: str) -> None:
        """Raises `ValueError` for what a controller would not read in a program."""
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

    def names(self, source: str) -> Iterator[str]:
        """What a program declares; some come more than once."""
        bare = self.comment.sub("", source)
        for pattern in self.declared:
            yield from (found[1] for found in pattern.finditer(bare))


@cache
def grammar(language: str) -> Grammar:
    """The table of a language."""
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
        declared=tuple(re.compile(one, re.M) for one in table["declared"]),
        refused=tuple((re.compile(one["pattern"], re.M), one["why"]) for one in table.get("refused", ())),
    )


def language_of(file: str) -> str:
    """By the end of a file's name; "" where it holds no program."""
    return next((language for end, language in _FILES.items() if file.endswith(end)), "")


def checked(files_by_name: Mapping[str, str]) -> dict[str, str]:
    """Files of a client, as they are. Raises `ValueError` for what its controller would not read."""
    for file, source in files_by_name.items():
        if language := language_of(file):
            grammar(language).check(source)
    return dict(files_by_name)
