"""The Modbus map and the clients' sources as text, from the schema that encodes both."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator

from edged.errors import UserError
from edged.plc.registers import BLOCKS, JOBS, MAP_VERSION, ROWS, TABLE, Block, Register
from edged.robots import (
    as_source,
    drl_source,
    karel_files,
    krl_files,
    melfa_files,
    motoplus_files,
    plcopen_source,
    python_source,
    rapid_source,
    scl_source,
    spel_source,
    structured_text_source,
    twincat_files,
    urscript_source,
    val3_files,
)
from edged.robots.grammar import checked, grammar

TITLES = {TABLE[0]: f"target table, {len(TABLE)} rows", JOBS[0]: f"jobs, {len(JOBS)} rows"}


def render(fmt: str) -> str:
    """The map, or a client's source, as text that ends with a newline."""
    writer = FORMATS.get(fmt)
    if writer is None:
        raise UserError(f"--format {fmt}: expected {', '.join((*FORMATS, *SEVERAL))}")
    return writer()


def _rows() -> Iterator[tuple[Block, Register]]:
    for block in BLOCKS:
        for register in block.registers:
            yield block, register


def _markdown() -> str:
    lines = [
        f"Map version {MAP_VERSION}. Addresses are 0-based PDU addresses; function codes 3 and 4 read the "
        "same words. 32-bit and 64-bit values take 2 and 4 words, high word first unless set otherwise.",
    ]
    for block in BLOCKS:
        rows = next((rows for rows in ROWS if block in rows), (block,))
        if block is not rows[0]:
            continue
        last = rows[-1]
        access = "read and write" if block.writable else "read"
        name = TITLES.get(block, block.name)
        lines += [
            "",
            f"### {block.address}-{last.address + last.words - 1}: {name} ({access})",
            "",
            "| address | name | type | unit | meaning |",
            "|---:|---|---|---|---|",
        ]
        lines += [
            f"| {one.address} | {one.name} | {one.kind.name} | {one.unit} | {one.help} |"
            for one in block.registers
        ]
    return "\n".join(lines) + "\n"


def _csv() -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["address", "words", "block", "name", "type", "unit", "access", "meaning"])
    for block, register in _rows():
        access = "rw" if block.writable else "r"
        writer.writerow(
            [
                register.address,
                register.kind.words,
                block.name,
                register.name,
                register.kind.name,
                register.unit,
                access,
                register.help,
            ]
        )
    return out.getvalue()


def _json() -> str:
    rows = [
        {
            "address": register.address,
            "words": register.kind.words,
            "block": block.name,
            "name": register.name,
            "type": register.kind.name,
            "unit": register.unit,
            "access": "rw" if block.writable else "r",
            "meaning": register.help,
        }
        for block, register in _rows()
    ]
    return json.dumps({"map_version": MAP_VERSION, "registers": rows}, indent=1, ensure_ascii=False) + "\n"


def _readable(fmt: str, writer: Callable[[], str]) -> Callable[[], str]:
    """The writer of a program that its controller can read."""

    def write() -> str:
        text = writer()
        grammar(LANGUAGES[fmt]).check(text)
        return text

    return write


LANGUAGES = {
    "st": "iec",
    "plcopen": "iec",
    "scl": "scl",
    "urscript": "urscript",
    "rapid": "rapid",
    "drl": "drl",
    "as": "as",
    "spel": "spel",
}
"""Of programs that are one file, by format."""
FORMATS: dict[str, Callable[[], str]] = {
    "md": _markdown,
    "csv": _csv,
    "json": _json,
    "st": _readable("st", structured_text_source),
    "plcopen": _readable("plcopen", plcopen_source),
    "scl": _readable("scl", scl_source),
    "urscript": _readable("urscript", urscript_source),
    "python": python_source,
    "rapid": _readable("rapid", rapid_source),
    "drl": _readable("drl", drl_source),
    "as": _readable("as", as_source),
    "spel": _readable("spel", spel_source),
}
SEVERAL: dict[str, Callable[[], dict[str, str]]] = {
    "twincat": lambda: checked(twincat_files()),
    "karel": lambda: checked(karel_files()),
    "krl": lambda: checked(krl_files()),
    "val3": lambda: checked(val3_files()),
    "melfa": lambda: checked(melfa_files()),
    "motoplus": lambda: checked(motoplus_files()),
}
