"""Commands, files, links and names in the documentation exist."""

from __future__ import annotations

import importlib
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import typer

from edged.cli.main import app
from edged.plc.registers import BLOCKS, StatusBit

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
TEXTS = {page: page.read_text() for page in PAGES}
COMMAND = re.compile(r"(?<![\w/.-])edged (?P<name>[a-z][a-z-]*)(?P<rest>[^\n`|;&>#]*)")
TOOL = re.compile(r"(?<![\w./-])tools/(?P<name>[\w.]+)(?P<rest>[^\n`|;&>#]*)")
FILE = re.compile(r"(?<![\w./<-])(?:(?:tools|tests|config|systemd)/[\w./-]*\w|edged/[\w/]+\.py)")
FOLDER = re.compile(r"(?<![\w./<-])edged/[\w./-]*\w")
"""Outside of the explanations edged/cell1/target is a key of Zenoh."""
LINK = re.compile(r"\]\((?P<page>[^)#\s:]*)(?:#(?P<anchor>[^)\s]+))?\)")
SPAN = re.compile(r"`([^`\n]+)`")
MARKED = re.compile(
    r"(?P<shown>[\w.]+)(?: (?:s|KiB|MiB))? "
    r"<!-- (?P<module>edged[\w.]+)\.(?P<name>\w+)(?P<scale> [*/] [\d.]+)? -->"
)
"""A number of the code, as a page shows it: "96 <!-- edged.adapters.web.places.MAX_CONNECTIONS -->"."""
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def _commands(text: str) -> Iterator[tuple[str, list[str], set[str]]]:
    """Each command line of edged: the line, its options, and the options of the command."""
    known = typer.main.get_command(app).commands
    for found in COMMAND.finditer(text.replace("tools/demo", "edged demo")):
        command, words = known.get(found["name"]), found["rest"].split()
        if hasattr(command, "commands"):
            command, words = command.commands.get(words[0].rstrip(",") if words else ""), words[1:]
        if command is None:  # a sentence, not a command
            continue
        takes = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
        yield found[0], _options(words), takes


def _options(words: list[str]) -> list[str]:
    return [word.partition("=")[0].rstrip(",.;:)") for word in words if re.match("--?[a-z]", word)]


def _tools(text: str) -> Iterator[tuple[Path, list[str]]]:
    """Each call of a program in tools/, and its options."""
    for found in TOOL.finditer(text):
        name, words = found["name"].rstrip("."), found["rest"].split()
        if name == "bench" and words and words[0].isalpha():
            name = f"bench_{words[0]}.py"
        if name not in ("demo", "test"):  # they hand their options to `edged demo` and pytest
            yield ROOT / "tools" / name, [word for word in _options(words) if word.startswith("--")]


def _anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", FENCED.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.long
def test_every_option_in_the_documentation_exists() -> None:
    """Every option of every command line on every page exists."""
    for page, text in TEXTS.items():
        for line, given, takes in _commands(text):
            assert set(given) <= takes, (page, line)


def test_every_tool_in_the_documentation_exists() -> None:
    """Every named tool exists, and its options are in its source."""
    for page, text in TEXTS.items():
        for tool, given in _tools(text):
            assert tool.is_file(), (page, tool)
            assert [] == [option for option in given if option not in tool.read_text()], (page, tool)


def test_every_file_in_the_documentation_exists() -> None:
    """Tests, tools, sources and examples that are named by their path exist."""
    named = [(page, file) for page, text in TEXTS.items() for file in FILE.findall(text)]
    assert [] == [(page, file) for page, file in named if not (ROOT / file).exists()]


def test_every_link_leads_somewhere() -> None:
    """Every link leads to an existing page and heading, and every page can be reached from the README."""
    dead, seen, pages = [], {README}, [README]
    while pages:
        page = pages.pop()
        for link in LINK.finditer(FENCED.sub("", page.read_text())):
            target = (page.parent / link["page"]).resolve() if link["page"] else page
            if not target.exists() or (link["anchor"] and link["anchor"] not in _anchors(target)):
                dead.append(f"{_name(page)}: {link[0]}")
            elif target.suffix == ".md" and target not in seen:
                seen.add(target)
                pages.append(target)

    assert [] == dead
    parts = [DOCS / name for name in ("tutorial", "how-to", "explanation")]
    assert set() == {page for page in PAGES if page.parent in parts} - seen


def test_every_command_is_in_the_readme() -> None:
    """Every command is in the README."""
    told = set(re.findall(r"`(?:edged )?([a-z]+)\b", README.read_text()))
    assert set() == set(typer.main.get_command(app).commands) - told


@pytest.mark.long
def test_the_search_finds_commands_and_mistakes() -> None:
    """The search finds the pages' examples, and sees an option that a command does not take."""
    assert sum(len(list(_commands(page.read_text()))) for page in PAGES) > 50
    ((_, given, takes),) = _commands("edged check cell.toml --jsn")
    assert ["--jsn"] == given
    assert "--json" in takes
    ((tool, options),) = _tools("`tools/bench modbus --second 5`")
    assert "--second" in options
    assert ROOT / "tools" / "bench_modbus.py" == tool


REGISTERS = re.compile(
    r"(?P<names>[A-Z][A-Z0-9_]*(?:, [A-Z][A-Z0-9_]*)*) \((?P<first>\d+)(?:-(?P<last>\d+))?(?=[,;)])"
)
"""A register, a block, or several, with the place in brackets: "START_EPOCH (344", "SIGMA_X, SIGMA_Y
(324-325"."""


def test_each_register_that_the_documents_name_lies_where_they_say() -> None:
    """Every register in the documents has the address that they state; of several, the first and the last."""
    places = defaultdict[str, set[tuple[int, int]]](set)
    for block in BLOCKS:
        places[block.name.upper()].add((block.address, block.address + block.words - 1))
        for register in block.registers:
            places[register.name].add((register.address, register.address + register.kind.words - 1))
    for found in (found for text in TEXTS.values() for found in REGISTERS.finditer(text)):
        names = found["names"].split(", ")
        if set(names) <= places.keys():
            assert int(found["first"]) in {first for first, _ in places[names[0]]}, found[0]
            lasts = {last for _, last in places[names[-1]]}
            assert not found["last"] or int(found["last"]) in lasts, found[0]


def test_each_bit_of_the_status_that_the_documents_name_is_the_one_they_say() -> None:
    """Every bit in the documents, as in "READY (201, bit 0)" or "ACK (bit 1)", is the right one."""
    named = re.compile(r"([A-Z_]{2,}) \((?:201, )?bit (\d+)\)")
    for name, number in (found for text in TEXTS.values() for found in named.findall(text)):
        if name in StatusBit.__members__:
            assert 1 << int(number) == StatusBit[name], name


def _sources() -> Iterator[str]:
    """The texts of all sources in which a documented name may be."""
    for folder in ("edged", "config", "systemd", "tools", "tests"):
        for path in (ROOT / folder).rglob("*"):
            if (
                path.is_file()
                and path.suffix in SOURCES
                and MANUAL not in path.parents
                and path != Path(__file__)
            ):
                yield path.read_text(errors="ignore")


@cache
def _names() -> set[str]:
    """Every word and option of the sources."""
    return {name for text in _sources() for name in re.findall(r"--[\w-]+|\w+", text)} | ELSEWHERE | FIELDS


SOURCES = {"", *(f".{kind}" for kind in ("py", "js", "j2", "toml", "json", "yml", "service", "tsv"))}
MANUAL = ROOT / "edged/adapters/web/manual"


def _options_of(group: typer.core.TyperGroup) -> Iterator[str]:
    """The options of all its commands."""
    for command in group.commands.values():
        if isinstance(command, typer.core.TyperGroup):
            yield from _options_of(command)
        for one in command.params:
            yield from (*one.opts, *one.secondary_opts)


ELSEWHERE = {
    "ModbusServer",
    "FB_EDGED_S7_DB",
    "KAREL_ENB",
    "MACHINE_DEF",
    "HOSTC_CFG",
    "SERVER_PORT",
    "NO_REF_TIME",
}
"""Names of a maker's tool, a controller, or a standard."""
FIELDS = {"EDGED_RESULT", "EDGED_AUDIT"}
"""Journal names, made of the names of fields."""
CAPITALS = re.compile(r"\b(?:[A-Z]+[a-z]+){2,}\b|\b[A-Z]{2,}(?:_[A-Z0-9]+)+\b")
"""A class, a constant, a register, or a bit."""


@pytest.mark.long
def test_every_name_in_the_documentation_exists() -> None:
    """Classes, constants and options in code spans of the documentation exist."""
    spans = [span for text in TEXTS.values() for span in SPAN.findall(FENCED.sub("", text))]
    named = [name for span in spans for name in CAPITALS.findall(span)]
    named += [span.split()[0].partition("=")[0] for span in spans if span.startswith("--")]

    known = _names() | set(_options_of(typer.main.get_command(app)))
    assert [] == [name for name in named if name not in known]


def test_every_folder_that_is_explained_exists() -> None:
    """Packages by path (`edged/cell`) and modules by name (`edged.vision.part`) exist."""
    about = (ROOT / "CONTRIBUTING.md", *(DOCS / "explanation").glob("*.md"))
    text = "\n".join(TEXTS[page] for page in about)
    places = [*FOLDER.findall(text), *(module.replace(".", "/") for module in MODULE.findall(text))]
    places = [re.sub("/[A-Z]+(?=[./]|$).*", "", place) for place in places]  # FORMAT stands for any

    assert [] == [
        place for place in places if not any((ROOT / f"{place}{end}").exists() for end in ("", ".py"))
    ]


MODULE = re.compile(r"(?<=`)edged(?:\.[a-z]+)+(?=`)")


def test_each_number_that_is_marked_is_that_of_the_code() -> None:
    """Every marked number is that of the code, in the unit of the sentence."""
    for found in (found for text in TEXTS.values() for found in MARKED.finditer(text)):
        value = getattr(importlib.import_module(found["module"]), found["name"])
        factor = float((found["scale"] or "* 1").split()[1])
        expected = value / factor if "/" in (found["scale"] or "") else value * factor
        shown = found["shown"].lower()
        assert expected == WRITTEN.get(shown) or expected == float(shown), found[0]


WRITTEN = {"eight": 8, "ten": 10, "sixteen": 16, "twenty": 20}


def test_most_limits_are_marked() -> None:
    """The page about limits has at least 18 marked numbers."""
    assert len(MARKED.findall((DOCS / "explanation/limits.md").read_text())) >= 18
