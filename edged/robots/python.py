"""The Python client: `cell_client` with the map written out; it needs pymodbus and nothing of edged."""

from __future__ import annotations

from pathlib import Path

from edged.domain.events import CommandKind
from edged.plc.answers import Reason
from edged.plc.registers import (
    ADDRESS,
    BLOCKS,
    MAGIC,
    MAP_VERSION,
    ROWS,
    Flag,
    Option,
    ResultCode,
    StatusBit,
)

BEGIN, END = "# <map>\n", "# </map>\n"


def python_source() -> str:
    """A module with the class `EdgedCell`, as text."""
    # read, not imported: printing a client takes no pymodbus
    source = Path(__file__).with_name("cell_client.py").read_text(encoding="utf-8")
    head, _, rest = source.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return head + _map() + tail


def _map() -> str:
    lines = [
        "# Written by `edged registers --format python` from the schema of the registers.",
        f"MAGIC = 0x{MAGIC:04X}",
        f"MAP_VERSION = {MAP_VERSION}",
        "BLOCKS: dict[str, tuple[int, tuple[tuple[str, str], ...]]] = {",
    ]
    for block in (one for one in BLOCKS if not any(one in rows[1:] for rows in ROWS)):
        lines.append(f'    "{block.name}": (')
        lines.append(f"        {block.address},")
        lines.append("        (")
        lines += [
            f'            ("{register.name}", "{register.kind.value}"),' for register in block.registers
        ]
        lines += ["        ),", "    ),"]
    lines.append("}")
    lines.append(
        f"HIGH_FIRST = { ({block.name for block in BLOCKS if block.high_first})!r}".replace("'", '"')
    )
    names = ("COMMAND", "CMD_SEQ", "ACK_SEQ", "CLIENT_HEARTBEAT", "OPTIONS", "TIMEOUT", "BOX")
    lines.append(f"ADDRESS = { ({name: ADDRESS[name] for name in names})!r}".replace("'", '"'))
    for name, codes in (
        ("COMMANDS", CommandKind),
        ("RESULTS", ResultCode),
        ("NACK_REASONS", Reason),
        ("STATUS_BITS", StatusBit),
        ("FLAGS", Flag),
        ("OPTIONS", Option),
    ):
        lines.append(f"{name} = {{")
        lines += [f'    "{code.name}": {code.value},' for code in codes]
        lines.append("}")
    return "\n".join(lines) + "\n"
