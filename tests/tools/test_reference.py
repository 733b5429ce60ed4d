"""The manual's reference agrees with the code and is complete."""

from __future__ import annotations

import enum
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from pydantic import BaseModel
from referencepages.markdown import ROOT, member_docs
from referencepages.pages import PAGES, current, main

from edged import errors
from edged.adapters.zenoh.keys import KEYS, TRIGGER_PARAMETERS
from edged.cli.main import app
from edged.config.configuration import Config
from edged.domain.cell import CalibrationHealth, CellPhase, SetupSource
from edged.domain.events import CommandKind
from edged.domain.measurement import Reject, Status
from edged.files.jobs.schema import JobFile
from edged.files.rig import save_rig
from edged.pictures.captions import REASONS
from edged.plc.answers import NackReason
from edged.plc.registers import BLOCKS, ROWS, Flag, Option, ResultCode, StatusBit, Warn
from edged.robot.orientations import Convention
from edged.sim.cell import demo_rig

CODES: tuple[type[enum.Enum], ...] = (
    *(Status, Reject, CommandKind, CalibrationHealth, NackReason, Convention),
    *(ResultCode, StatusBit, Flag, Option, Warn),
)


def page(name: str) -> str:
    """The committed text of a page."""
    return (ROOT / f"docs/reference/{name}.md").read_text()


def test_every_page_is_current(capsys: pytest.CaptureFixture[str]) -> None:
    """The committed pages are current (if not: tools/reference)."""
    assert (0, "") == (main(["--check"]), capsys.readouterr().err)


@pytest.mark.long
def test_a_page_that_is_not_current_is_named_and_mended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An outdated page is named and rewritten, only in its generated parts."""
    for name in PAGES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    path = tmp_path / "docs/reference/errors.md"
    text = path.read_text()
    path.write_text("Ours.\n" + text.replace("| 101 |", "| 99 |"))

    assert 1 == main(["--check"], tmp_path)
    assert [f"{path}: not current; run tools/reference"] == capsys.readouterr().err.splitlines()
    assert 0 == main([], tmp_path)
    assert "Ours.\n" + text == path.read_text()
    assert 0 == main(["--check"], tmp_path)


def test_a_page_without_a_place_for_a_part_is_refused() -> None:
    """A page without a place for a part, or with one for an unknown part, is refused."""
    for text in ("", "<!-- generated: commands -->\n<!-- end -->\n<!-- generated: x -->\n<!-- end -->\n"):
        with pytest.raises(ValueError, match="expected the parts"):
            current(text, PAGES["docs/reference/cli.md"])


def _commands(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    for word, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, f"{name} {word}")
        else:
            yield f"{name} {word}", command


def test_every_command_and_option_is_there() -> None:
    """Every command is on the page with its help, and every option has a help text."""
    sections = dict(re.findall(r"^### (edged .+?)\n(.*?)(?=^##|\Z)", page("cli"), re.MULTILINE | re.DOTALL))
    found = dict(_commands(typer.main.get_command(app), "edged"))

    assert found.keys() == sections.keys()
    for name, command in found.items():
        assert command.help.split("\n\n")[0] in sections[name]
        for one in command.params:
            assert one.help, f"{name} {one.name}"
            names = (*one.opts, *one.secondary_opts) if one.opts[0].startswith("-") else (one.name.upper(),)
            for word in names:
                assert f"`{word}`" in sections[name], f"{name} {word}"


def _keys(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key of every table that is no table itself."""
    for table in (schema, *schema["$defs"].values()):
        for name, one in table["properties"].items():
            if "$ref" not in json.dumps(one):
                yield name, one


@pytest.mark.parametrize(("model", "name"), [(Config, "configuration"), (JobFile, "files")])
def test_every_key_is_there_with_its_meaning(model: type[BaseModel], name: str) -> None:
    """Every key has a row of its own with a description, and there are no others."""
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]*) \| (.+) \|$", page(name), re.MULTILINE)
    keys = list(_keys(model.model_json_schema()))

    assert sorted(key for key, _ in keys) == sorted(row[0] for row in rows)
    assert [] == [key for key, one in keys if not one.get("description")]
    assert [] == [row[0] for row in rows if not row[3].strip()]


def test_the_bounds_and_defaults_of_a_key_are_there() -> None:
    """Some rows of each kind have the right bounds and defaults."""
    text = page("configuration").replace("\N{NO-BREAK SPACE}", "")
    for row in (
        "| `port` | integer, 1 to 65535 | `1502` | 502 is",
        "| `exposure_us` | number, above 0, up to 10000000 |  | exposure time",
        '| `parity` | `"even"`, `"odd"`, `"none"` | `"even"` |',
        '| `writers` | list of texts | `["127.0.0.0/8", "::1/128"]` |',
        "| `reserved` | table of integer, 1 to 16 |  |",
        "| `rig` | path | required |",
        "## `[cameras.left]`, `[cameras.right]`",
        "## `[cameras.left.strobe]`, `[cameras.right.strobe]`",
    ):
        assert row in text


def test_every_register_bit_and_code_is_there() -> None:
    """Every register is on the page with its address, and every bit and code with its meaning."""
    text = page("registers")
    for block in BLOCKS:
        for register in block.registers if not any(block in rows[1:] for rows in ROWS) else ():
            assert f"| {register.address} | {register.name} | {register.kind.name} |" in text
    for codes in (CommandKind, ResultCode, NackReason, Convention):
        for one, meaning in member_docs(codes).items():
            assert f"| {codes[one].value} | `{one}` | {meaning} |" in text
    for bits in (StatusBit, Flag, Option, Warn, Reject):
        for bit in bits:
            row = rf"\| {bit.bit_length() - 1} \| 0x{bit:04X} \| `{bit.name}` \|"
            assert re.search(row, text), bit


@pytest.mark.parametrize("codes", CODES, ids=lambda codes: codes.__name__)
def test_every_code_says_what_it_means(codes: type[enum.Enum]) -> None:
    """Every code has a meaning in the source, except "nothing is set"."""
    assert {} == {
        name: meaning
        for name, meaning in member_docs(codes).items()
        if not meaning and codes[name] is not Reject.NONE
    }


def test_every_field_of_every_message_is_there() -> None:
    """Every field of every message, also of inner tables, and every key and parameter of Zenoh is on the
    page."""
    text = page("payloads")

    def fields(definition: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        for name, one in definition.get("properties", {}).items():
            yield name, one
            yield from fields(one.get("items", one))

    for name, definition in json.loads((ROOT / "config" / "edged.schema.json").read_text())["$defs"].items():
        (section,) = re.findall(rf"^### {name}\n(.*?)(?=^###|\Z)", text, re.MULTILINE | re.DOTALL)
        for field, one in fields(definition):
            assert re.search(rf"^\| `(\w+(\[\])?\.)*{field}` \|", section, re.MULTILINE), f"{name}.{field}"
            assert "description" in one or "$ref" in one, f"{name}.{field}"
    for key in KEYS:
        assert f"| `edged/<cell>/{key.path}` |" in text
        assert not key.message or f"### {key.message}_message\n" in text
    for parameter in TRIGGER_PARAMETERS:
        assert f"| `{parameter}` |" in text


def test_a_message_may_hold_every_status_reason_and_phase_of_the_code() -> None:
    """Each list in the schema that has one status, reason or phase has all of them and no other."""
    schema = json.loads((ROOT / "config" / "edged.schema.json").read_text())
    listed = [set(names) for names in listed_in(schema)]
    for kind in (Reject, Status, CellPhase, CalibrationHealth, SetupSource):
        members = {member.name for member in kind if member.name != "NONE"}
        found = [names for names in listed if names & members and "NONE" not in names]

        assert found, kind
        assert [members] * len(found) == found


def listed_in(part: object) -> Iterator[list[str]]:
    """Every list of values that a schema allows."""
    if isinstance(part, dict):
        yield from [part["enum"]] if "enum" in part else []
        part = list(part.values())
    for inner in part if isinstance(part, list) else []:
        yield from listed_in(inner)


def test_every_error_fault_and_reason_is_there() -> None:
    """Each exception, each fault number and each reason with its text is on the page."""
    text = page("errors")
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, errors.EdgedError):
            assert f"- `{name}`" in text
            if issubclass(kind, errors.CaptureError):
                assert f"| {kind.code} | `{name}` |" in text
    for reason in Reject:
        assert f"| `{reason.name}` | {REASONS[reason]} |" in text
    for one in (*Status, *CalibrationHealth):
        assert f"| `{one.name}` |" in text


def test_every_field_of_a_rig_is_there(tmp_path: Path) -> None:
    """Every written field of a rig is on the page."""
    save_rig(tmp_path / "rig.json", demo_rig())
    document = json.loads((tmp_path / "rig.json").read_text())
    (section,) = re.findall(r"^## The rig\n(.*?)(?=^## )", page("files"), re.MULTILINE | re.DOTALL)

    assert [] == [key for key in {**document, **document["left"]} if f"`{key}`" not in section]
