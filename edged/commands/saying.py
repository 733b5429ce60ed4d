"""Lines of text from anywhere on a terminal."""

from __future__ import annotations

from rich.console import Console

from edged.errors import printable


def say(text: str, console: Console) -> None:
    """Print a line as it is, but for what would steer the terminal."""
    console.print(printable(text), markup=False, highlight=False)
