"""`edged registers`: the Modbus map for people and programs, from the schema that encodes it."""

from __future__ import annotations

import csv
import io
import json
import sys
from dataclasses import asdict

from edged.errors import UserError
from edged.registers import SCHEMA, WORDS


def registers(fmt: str) -> int:
    """Print the map as md, csv or json."""
    sys.stdout.write(render(fmt))
    return 0


def render(fmt: str) -> str:
    """The map as text. Raises `UserError` for an unknown format."""
    rows = [{**asdict(register), "words": WORDS[register.kind]} for register in SCHEMA]
    if fmt == "json":
        return json.dumps(rows, indent=1, ensure_ascii=False) + "\n"
    columns = ("address", "words", "name", "kind", "unit", "access", "help")
    if fmt == "csv":
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return buffer.getvalue()
    if fmt == "md":
        lines = ["| " + " | ".join(columns) + " |", "|---:|---:|---|---|---|---|---|"]
        lines += ["| " + " | ".join(str(row[column]) for column in columns) + " |" for row in rows]
        return "\n".join(lines) + "\n"
    raise UserError(f"--format {fmt!r}: expected md, csv or json")
