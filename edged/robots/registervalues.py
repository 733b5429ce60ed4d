"""Template values from the schema of the registers."""

from __future__ import annotations

import enum
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from edged import __version__
from edged.domain.events import CommandKind
from edged.plc.answers import NackReason
from edged.plc.processimage import FROM_CELL, TO_CELL, TO_CELL_BYTES
from edged.plc.registers import (
    ADDRESS,
    BELT,
    BLOCKS,
    COMMAND,
    GRASP,
    JOBS,
    MAGIC,
    MAP_VERSION,
    PLACE,
    RESULT,
    ROWS,
    STATUS,
    TABLE,
    TRAY,
    UR,
    UR_GRASP,
    UR_OFFSET,
    Block,
    CellBit,
    Flag,
    Kind,
    Option,
    Register,
    ResultCode,
    StatusBit,
)
from edged.robot.orientations import Convention

TITLES = {TABLE[0]: f"target table, {len(TABLE)} rows", JOBS[0]: f"jobs, {len(JOBS)} rows"}


@dataclass(frozen=True, slots=True)
class Area:
    """A block, or the first of several alike. end : address after the last. at : offset of each register."""

    name: str
    title: str
    address: int
    words: int
    end: int
    writable: bool
    high_first: bool
    registers: tuple[Register, ...]
    at: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Variable:
    """A register, or half of one, in structured text. conversion : expression on the words of its block."""

    name: str
    type: str
    conversion: str
    comment: str


@dataclass(frozen=True, slots=True)
class ImageField:
    """A register in a PLC's own memory. type : of IEC 61131-3. byte : number of its first one of 192."""

    name: str
    type: str
    byte: int
    comment: str


@dataclass(frozen=True, slots=True)
class ImageFields:
    """Both process images. bit, number : value and number of each of BITS. unused_words : after TO_CELL."""

    to_cell: tuple[ImageField, ...]
    from_cell: tuple[ImageField, ...]
    bit: Mapping[str, int]
    number: Mapping[str, int]
    unused_words: int


IEC = {Kind.U16: "UINT", Kind.I32: "DINT", Kind.U32: "UDINT", Kind.F32: "REAL"}


def image_fields() -> ImageFields:
    """The process image, field by field."""
    unused = TO_CELL_BYTES // 2 - sum(register.kind.words for register in TO_CELL)
    bits = _numbers(CellBit)
    numbers = {name: value.bit_length() - 1 for name, value in bits.items()}
    return ImageFields(_fields(TO_CELL, 0), _fields(FROM_CELL, TO_CELL_BYTES), bits, numbers, unused)


def _fields(registers: Iterable[Register], start: int) -> tuple[ImageField, ...]:
    return tuple(
        ImageField(
            register.name,
            "WORD" if register.unit == "bits" and register.name != "CONTROL" else IEC[register.kind],
            start + 2 * register.address,
            "" if register.unit in ("", "bits") else _plain(register.unit),
        )
        for register in registers
    )


def _plain(text: str) -> str:
    """Text in ASCII, as compilers differ in their encodings."""
    return text.replace("µ", "u").replace("°", " degrees").strip()


def register_values() -> dict[str, object]:
    """Values for all templates: numbers by name, blocks, and the poses of a registration."""
    used = {"STATUS": STATUS, "RESULT": RESULT, "GRASP": GRASP, "COMMAND": COMMAND, "UR": UR}
    used |= {"TRAY": TRAY, "PLACE": PLACE, "BELT": BELT}
    numbers = {
        "command": _numbers(CommandKind),
        "reason": _numbers(reason for reason in NackReason if reason),
        "flag": _numbers(Flag),
        "bit": _numbers(StatusBit),
        "result": _numbers(ResultCode),
        "option": _numbers(Option),
        "convention": _numbers(Convention),
    }
    return {
        **numbers,
        **{name: _area(block) for name, block in used.items()},
        "UR_GRASP": _area(UR_GRASP),
        "UR_OFFSET": _area(UR_OFFSET),
        "edged_version": __version__,
        "magic": MAGIC,
        "map_version": MAP_VERSION,
        "blocks": [_area(block) for block in BLOCKS if not any(block in rows[1:] for rows in ROWS)],
        "address": ADDRESS,
        "image": image_fields(),
        "python_tables": {
            "COMMANDS": numbers["command"],
            "RESULTS": _numbers(ResultCode),
            "NACK_REASONS": _numbers(NackReason),
            "STATUS_BITS": numbers["bit"],
            "FLAGS": numbers["flag"],
            "OPTIONS": numbers["option"],
        },
        # COMMAND to BOX, in one write
        "control_words": ADDRESS["BOX"] - COMMAND.address + 1,
        "result_variables": list(_variables(RESULT, "Result")),
        "grasp_variables": list(_variables(GRASP, "Grasp")),
        # both blocks are read in one request, which begins with tray
        "more_words": PLACE.address + PLACE.words - TRAY.address,
        "tray_variables": list(_variables(TRAY, "Tray", "More")),
        "place_variables": list(_variables(PLACE, "Place", "More", PLACE.address - TRAY.address)),
        # both blocks are read in one request, which begins with ur
        "ur": {
            register.name: register.address - UR.address
            for block in (UR, UR_GRASP)
            for register in block.registers
        },
        "xor_of_4_bits": [a ^ b for a in range(16) for b in range(16)],
        "crc_of_4_bits": [_crc_of_4_bits(bits) for bits in range(16)],
        "walk": [(*shift, *turn) for shift, turn in zip(SHIFTS_MM, TURNS_DEG, strict=True)],
        "settle_s": SETTLE_S,
    }


def _numbers(members: Iterable[enum.IntEnum | enum.IntFlag]) -> dict[str, int]:
    return {str(member.name): member.value for member in members}


def _area(block: Block) -> Area:
    last = next((rows[-1] for rows in ROWS if block in rows), block)
    return Area(
        name=block.name,
        title=TITLES.get(block, block.name),
        address=block.address,
        words=block.words,
        end=last.address + last.words,
        writable=block.writable,
        high_first=block.high_first,
        registers=block.registers,
        at={register.name: register.address - block.address for register in block.registers},
    )


def _variables(block: Block, place: str, read_as: str = "", first: int = 0) -> Iterator[Variable]:
    """Variables of a block's registers; 64 bits become two UDINT, lengths and angles get a REAL in addition.

    place : its structure is named "st" + place. read_as : its words are the array "aw" + read_as, or "aw" +
    place, from index `first`.
    """
    low_first, words = "xLowWordFirst := xLowWordFirst", f"aw{read_as or place}"
    for register in block.registers:
        if "RESERVED" in register.name or register.name.endswith("CRC16"):
            continue
        name, at = re.sub("^[GPL]_", "", register.name), first + register.address - block.address
        comment = f"{register.unit}: {register.help}" if register.unit else register.help
        comment = _plain(comment)
        joined = f"F_EDGED_DWORD(wFirst := {words}[{at}], wSecond := {words}[{at + 1}], {low_first})"
        if register.kind is Kind.U16:
            yield Variable(f"ui{name}", "UINT", f"WORD_TO_UINT({words}[{at}])", comment)
        elif register.kind is Kind.I32:
            yield Variable(f"di{name}", "DINT", f"DWORD_TO_DINT({joined})", comment)
            # 24 bits: exact to 16 m; an unknown value is -2147483.6, as far out as its DINT
            unit = "mm" if register.unit == "µm" else "degrees"
            thousandth = f"DINT_TO_REAL(st{place}.di{name}) / 1000.0"
            yield Variable(f"r{name}", "REAL", thousandth, f"{unit}: di{name}")
        elif register.kind is Kind.U32:
            yield Variable(f"ud{name}", "UDINT", f"DWORD_TO_UDINT({joined})", comment)
        else:
            for half, number in (("HIGH", 0), ("LOW", 1)):
                taken = f"awWords := {words}, iAt := {at}, iHalf := {number}, {low_first}"
                yield Variable(f"ud{name}_{half}", "UDINT", f"F_EDGED_UDINT_OF_64({taken})", comment)


def _crc_of_4_bits(bits: int) -> int:
    """Four steps of the reflected polynomial 0x8005 ("MODBUS over serial line", section 6.2.2)."""
    for _ in range(4):
        bits = (bits >> 1) ^ (0xA001 if bits & 1 else 0)
    return bits


# ten poses for a registration, relative to the robot's current one and the same for every robot: turned about
# two axes across the tool by more than a hand-eye calibration needs, and about the tool's axis; shifted so
# that the board is seen in other parts of both pictures
TURNS_DEG = ((0, 0, 0), (14, 0, 0), (-14, 0, 5), (0, 14, 0), (0, -14, -5),
             (8, 3, 20), (-10, 10, -20), (10, -10, 30), (-10, -10, -30), (0, 0, 40))  # fmt: skip
"""Turns about x, y, z of the tool."""
SHIFTS_MM = ((0, 0, 0), (8, 4, 5), (-8, 4, -5), (8, -4, 5), (-8, -4, -5),
             (0, 6, 8), (0, -6, -8), (10, 0, 0), (-10, 0, 0), (0, 0, 10))  # fmt: skip
"""Shifts along x, y, z of the tool."""
SETTLE_S = 0.5
"""Wait at each pose before the picture, until the arm has come to rest."""
