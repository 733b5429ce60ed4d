"""Names that an interpreter meets where a program declares them, each held against its maker's table.

The table is the generators' own; where a name is declared, each interpreter finds in its own way.
"""

from __future__ import annotations

from edged.robots.grammar import grammar


class Declared:
    """Refuses, as the controller does, a word of the language and a name that is none, or too long.

    names : those that were declared, as they are written.
    """

    def __init__(self, language: str) -> None:
        self.grammar = grammar(language)
        self.names: set[str] = set()

    def __call__(self, name: str) -> str:
        """The name, declared."""
        self.names.add(self.grammar.allow(name))
        return name

    def lines(self, source: str) -> list[str]:
        """Lines of a source, none of which is too long."""
        return [self.grammar.fits("line", line) for line in source.splitlines()]
