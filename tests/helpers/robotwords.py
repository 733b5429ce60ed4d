"""Names declared in a robot program, each checked against the language's table.

The table is the generators' own; each interpreter finds the declarations in its own way.
"""

from __future__ import annotations

from edged.robots.grammar import grammar


class Declared:
    """Refuses reserved words and names that are invalid or too long, as the controller does.

    names : the declared names, as written.
    """

    def __init__(self, language: str) -> None:
        self.grammar = grammar(language)
        self.names: set[str] = set()

    def __call__(self, name: str) -> str:
        """Check and record a declared name, and return it."""
        self.names.add(self.grammar.allow(name))
        return name

    def lines(self, source: str) -> list[str]:
        """Lines of a source, each checked for its length."""
        return [self.grammar.fits("line", line) for line in source.splitlines()]
