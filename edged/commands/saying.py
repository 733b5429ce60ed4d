"""Prints untrusted text on a terminal."""

from __future__ import annotations

from rich.console import Console

from edged.errors import printable


def print_safe(text: str, console: Console) -> None:
    """Print a line unchanged, except for characters that would control the terminal."""
    console.print(printable(text), markup=False, highlight=False)
