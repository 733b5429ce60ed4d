"""What the documentation tells people to type exists."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from edged.cli.main import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMAND = re.compile(r"(?<![\w/.-])edged (?P<name>[a-z][a-z-]*)(?P<rest>[^\n`|;&>#]*)")


def _commands(text: str) -> Iterator[tuple[str, list[str], set[str]]]:
    """Each command line of edged: as it stands, the options it is given, and those that it takes."""
    known = typer.main.get_command(app).commands
    for found in COMMAND.finditer(text):
        command, words = known.get(found["name"]), found["rest"].split()
        if hasattr(command, "commands"):
            command, words = command.commands.get(words[0].rstrip(",") if words else ""), words[1:]
        if command is None:  # a sentence, not a command
            continue
        takes = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
        given = [word.partition("=")[0].rstrip(",.;:)") for word in words if re.match("--?[a-z]", word)]
        yield found[0], given, takes


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_option_in_the_documentation_exists(page: Path) -> None:
    """Of every command line on every page."""
    for line, given, takes in _commands(page.read_text()):
        assert set(given) <= takes, line


def test_every_command_is_in_the_readme() -> None:
    """Nobody has to find one by `edged --help` alone."""
    told = set(re.findall(r"`(?:edged )?([a-z]+)\b", PAGES[0].read_text()))
    assert set() == set(typer.main.get_command(app).commands) - told


def test_the_search_finds_commands_and_mistakes() -> None:
    """As many as there are pages with examples; an option that a command does not take is seen."""
    assert sum(len(list(_commands(page.read_text()))) for page in PAGES) > 50
    ((_, given, takes),) = _commands("edged check cell.toml --jsn")
    assert ["--jsn"] == given
    assert "--json" in takes
