"""The Modbus map, and the meaning of each bit and code in it."""

from __future__ import annotations

import enum

from edged.domain.cell import SetupSource
from edged.domain.events import CommandKind
from edged.domain.measurement import Reject
from edged.domain.registration import Method
from edged.pictures.captions import REASONS
from edged.plc.answers import NackReason
from edged.plc.registers import CellBit, ControlBit, Flag, Option, ResultCode, StatusBit, Warn
from edged.robot.orientations import Convention
from edged.robots.formats import render
from edged.robots.registervalues import image_fields
from referencepages.markdown import code, member_docs, table

CODES: dict[str, type[enum.IntEnum]] = {
    "COMMAND": CommandKind,
    "RESULT": ResultCode,
    "NACK_REASON": NackReason,
    "POSE_CONVENTION": Convention,
    "SETUP_SOURCE": SetupSource,
    "H_METHOD": Method,
}
BITS: dict[str, type[enum.IntFlag]] = {
    "STATUS_BITS": StatusBit,
    "FLAGS": Flag,
    "REJECT": Reject,
    "OPTIONS": Option,
    "WARNING": Warn,
    "CONTROL": ControlBit,
    "BITS": CellBit,
}
"""Bits by the register that holds them."""


def the_map() -> str:
    """Every word, as `edged registers` prints it."""
    return render("md").rstrip()


def codes_of(codes: type[enum.IntEnum]) -> str:
    """Value, name and meaning of each code."""
    docs = member_docs(codes)
    rows = ((one.value, code(one.name), docs[one.name]) for one in codes)
    return table(("value", "name", "meaning"), rows, numbers=1)


def bits_of(bits: type[enum.IntFlag]) -> str:
    """Number, value, name and meaning of each bit."""
    docs = member_docs(bits)
    rows = ((one.bit_length() - 1, f"0x{one:04X}", code(one.name), docs[str(one.name)]) for one in bits)
    return table(("bit", "value", "name", "meaning"), rows, numbers=2)


def rejects() -> str:
    """The bits of REJECT, with the words for people that pictures and reports use."""
    docs = member_docs(Reject)
    rows = (
        (one.bit_length() - 1, f"0x{one:04X}", code(one.name), REASONS[one], docs[str(one.name)])
        for one in Reject
    )
    return table(("bit", "value", "name", "in words", "meaning"), rows, numbers=2)


def all_codes() -> str:
    """A section for each register that holds a code."""
    return "\n\n".join(f"### {name}\n\n{codes_of(codes)}" for name, codes in CODES.items())


def all_bits() -> str:
    """A section for each register that holds bits."""
    return "\n\n".join(
        f"### {name}\n\n{rejects() if bits is Reject else bits_of(bits)}" for name, bits in BITS.items()
    )


def the_image() -> str:
    """Both images of a PLC's own memory, byte by byte."""
    fields = image_fields()
    parts = []
    for title, those in (("To the cell", fields.to_cell), ("From the cell", fields.from_cell)):
        start = those[0].byte
        rows = (
            (field.byte, (field.byte - start) // 2, field.name, field.type, field.comment) for field in those
        )
        head = ("byte of 192", "word", "name", "type", "unit")
        parts.append(f"### {title}\n\n{table(head, rows, numbers=2)}")
    return "\n\n".join(parts)


PARTS = {"map": the_map, "image": the_image, "codes": all_codes, "bits": all_bits}
