"""Every name, line and text of a generated program is valid for its controller."""

from __future__ import annotations

import ast
import inspect
import keyword
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    drl,
    inform,
    karel,
    kawasaki,
    krl,
    melfa,
    pacscript,
    rapid,
    scl,
    spel,
    structured_text,
    urscript,
    val3,
)
from helpers.robotarm import RobotArm
from helpers.robotlink import Link
from helpers.robotwords import Declared
from helpers.teachpendant import TeachPendant

import edged.robots
from edged.robots.formats import FORMATS, ProgramCell, render, written
from edged.robots.grammar import grammar

NOBODY = Link(1)
"""For a program that is only loaded."""
Files = Mapping[str, str]


def _melfa(files: Files) -> Declared:
    declared = Declared("melfa")
    for source in files.values():
        slot = melfa.TaskSlot(melfa.Controller(dict(files), NOBODY), source)
        for name in re.findall(r"\b[MCP][A-Z]\w*[%$]?(?=[=,])", re.sub('"[^"]*"', "", source)):
            slot.named(name)
        declared.names |= slot.declared.names
    return declared


def _scl(files: Files) -> Declared:
    return scl.declared_in(files["edged.scl"])


def _iec(files: Files) -> Declared:
    program = structured_text.Program(files["edged.st"], time.monotonic)
    program.instance("FB_EDGED")
    return program.declared


def _urscript(files: Files) -> Declared:
    return drl.declared(ast.parse(urscript.translate(files["edged.script"])), "urscript")


ARM = RobotArm(np.eye(4), np.eye(4), lambda _: None)
READERS: dict[str, Callable[[Files], Declared]] = {
    "karel": lambda files: karel.load(files["edged.kl"], karel.Controller(NOBODY)).declared,
    "krl": lambda files: krl.load(dict(files), krl.Controller(files["edged.xml"], NOBODY)).declared,
    "rapid": lambda files: rapid.load(files["EDGED.mod"], rapid.Sockets(NOBODY)).declared,
    "val3": lambda files: val3.load(dict(files), val3.Controller(NOBODY)).declared,
    "spel": lambda files: spel.load(files["Edged.prg"], spel.Controller(NOBODY)).declared,
    "as": lambda files: kawasaki.load(files["edged.as"], kawasaki.Controller(NOBODY)).declared,
    "pacscript": lambda files: pacscript.load(files["edged.pcs"], pacscript.Controller(NOBODY)).declared,
    "drl": lambda files: drl.declared(ast.parse(files["edged.drl"]), "drl"),
    "urscript": _urscript,
    "melfa": _melfa,
    "scl": _scl,
    "iec": _iec,
}
"""The names that an interpreter finds declared, by language."""


def program(language: str) -> Files:
    """The files of the format in a language."""
    return written("st" if language == "iec" else language)


RENAMED = {
    "karel": "waited",
    "krl": "REST",
    "rapid": "left_s",
    "val3": "nUnused",
    "spel": "edgedCode",
    "as": "ed_return",
    "pacscript": "waited",
    "drl": "digits",
    "urscript": "weight",
    "melfa": "LACK",
    "scl": "xTaken",
}
"""A name that each program declares."""
languages = pytest.mark.parametrize("language", RENAMED)


def judge(language: str, files: Files) -> None:
    """Check the files as `written` does."""
    for file, source in files.items():
        if its_language := FORMATS[language].files[file]:
            grammar(its_language).checked(source)


def renamed(language: str, other: str) -> Files:
    """The program with one of its names replaced everywhere."""
    pattern = rf"\b{RENAMED[language]}\b"
    return {file: re.sub(pattern, other, source) for file, source in program(language).items()}


@pytest.mark.parametrize("fmt", FORMATS)
def test_a_controller_takes_every_name_line_and_text_of_a_generated_program(fmt: str) -> None:
    """Every file passes the grammar of its language, or is a configuration."""
    unchecked = {f"edged.{kind}" for kind in ("md", "csv", "json", "eds", "xml", "pjx")} | {"edged_cell.py"}
    for file, source in written(fmt).items():
        if language := FORMATS[fmt].files[file]:
            assert source == grammar(language).checked(source.replace("\r\n", "\n"))
        else:
            assert file in unchecked


@pytest.mark.slow
@pytest.mark.parametrize("language", READERS)
def test_no_declared_name_is_overlooked(language: str) -> None:
    """Every name that the interpreter finds declared is found by the generators' patterns."""
    files = program(language)
    found = {name for source in files.values() for name in grammar(language).names(source)}
    if grammar(language).ignores_case:
        found = {name.upper() for name in found}
    declared = READERS[language](files).names
    assert len(declared) > 8
    assert set() == {name.upper() if grammar(language).ignores_case else name for name in declared} - found


@pytest.mark.long
@languages
def test_generator_and_interpreter_refuse_a_word_of_the_language(language: str) -> None:
    """A word of the language as a name is refused by generator and interpreter."""
    words = [word for word in sorted(grammar(language).words) if re.fullmatch(r"[A-Za-z]\w*", word)]
    if language in ("drl", "urscript"):  # read as Python, whose keywords are no names at all
        words = [
            word for word in words if not keyword.iskeyword(word) and word not in ("end", "global", "local")
        ]
    for word in words[:: max(1, len(words) // 9)]:
        files = renamed(language, word)
        with pytest.raises(ValueError, match=f"{word} is a word of the language"):
            judge(language, files)
        with pytest.raises(ValueError, match="is a word of the language"):
            READERS[language](files)


@pytest.mark.parametrize("language", [one for one in RENAMED if "name" in grammar(one).longest])
def test_generator_and_interpreter_refuse_a_name_that_is_too_long(language: str) -> None:
    """A name that is one character too long is refused by both, one of the longest length is not."""
    longest = grammar(language).longest["name"]
    just = RENAMED[language][0] + "x" * (longest - 1)
    judge(language, renamed(language, just))
    READERS[language](renamed(language, just))
    with pytest.raises(ValueError, match=f"has {longest + 1} characters"):
        judge(language, renamed(language, just + "x"))
    with pytest.raises(ValueError, match=f"has {longest + 1} characters"):
        READERS[language](renamed(language, just + "x"))


@pytest.mark.long
def test_the_interpreter_of_structured_text_refuses_a_word_of_the_language() -> None:
    """An operator of instruction lists is refused as a name, though the parser accepts it."""
    source = re.sub(r"\biHalf\b", "LD", render("st"))
    with pytest.raises(ValueError, match="LD is a word of the language"):
        grammar("iec").checked(source)
    program = structured_text.Program(
        "FUNCTION_BLOCK FB\nVAR\n    LD : INT;\nEND_VAR\nEND_FUNCTION_BLOCK", time.monotonic
    )
    with pytest.raises(ValueError, match="LD is a word of the language"):
        program.instance("FB")


def test_a_job_has_labels_that_its_pendant_shows(tmp_path: Path) -> None:
    """A job's labels have at most eight characters, and its declared names are those of the grammar."""
    job = written("motoplus")["EDGED.JBI"]
    read = inform.Controller(tmp_path, tmp_path / "memory", job, NOBODY).declared.names
    assert {"EDGED", "ASK", "WAIT"} < read
    assert read == set(grammar("inform").names(job.replace("\r\n", "\n")))
    with pytest.raises(ValueError, match="9 characters"):
        grammar("inform").checked(job.replace("*LATE", "*MUCHLATER").replace("\r\n", "\n"))


@pytest.mark.parametrize(
    "line",
    [
        *("PR[91,1]=-14 ;", "IF R[81]<>-1,JMP LBL[9] ;", "CALL EDGED(-8,10000,81,81,0) ;"),
        *("CALL EDGED(0,-1) ;", "CALL EDGED(-8) ;", "R[1]=R[2]+-1.5 ;"),
    ],
)
def test_a_listing_has_its_negative_constants_in_parentheses(line: str) -> None:
    """A negative constant without parentheses is refused by the grammar and the interpreter."""
    with pytest.raises(ValueError, match="parentheses"):
        grammar("tp").checked(f"/PROG  EDGEDREG\n   1:  {line}\n")
    listing = f"/PROG  EDGEDREG\n/ATTR\n/MN\n   1:  {line}\n   2:  END ;\n/POS\n/END\n"
    with pytest.raises(AssertionError):
        TeachPendant(ARM, lambda _: None, {}).run(listing)


def test_no_name_that_a_user_gives_stands_in_a_program() -> None:
    """Only jobs' names from a user are in a program, in comments, and a name that could end one is
    refused."""
    assert ["fmt", "cell"] == list(inspect.signature(written).parameters)
    for job in ("1 *) x := 1", "1 */", "1 a\nb", "1 a]]>", "1", "a 1", '1 "'):
        with pytest.raises(ValueError, match="not for a program"):
            ProgramCell(jobs=(job,))
    for address in ('1"', "", "cell", "::1"):
        with pytest.raises(ValueError, match="not for a program"):
            ProgramCell(address)


def test_every_table_names_its_source() -> None:
    """Every table of a grammar names its source, and is used."""
    used = {language for row in FORMATS.values() for language in row.files.values()} - {""}
    tables = (Path(edged.robots.__file__).parent / "grammars").glob("*.toml")
    assert used == {table.stem for table in tables}
    assert all(len(grammar(language).source) > 80 for language in used)
    assert {"iec"} == set(FORMATS["twincat"].files.values())
