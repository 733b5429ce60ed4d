"""Process image that a PLC without Modbus exchanges with the cell, in the PLC's own memory.

The 64 bytes to the cell are the command block of the map, the 128 bytes from it the words of the map that a
program needs for one part. This module only defines the layout; registers and handshake are the cell's.
Values of 32 bits lie at multiples of four bytes, so that no compiler pads a structure before them.

A copy of the image is whole when SEQ_HEAD = SEQ_TAIL: BITS and SEQ_HEAD are near its beginning, SEQ_TAIL is
its last word. When a result appears, all three change; when it is withdrawn, BITS and SEQ_TAIL do. So in
whichever direction a copy is torn, one of them does not match.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterable, Mapping
from dataclasses import replace

from edged.plc.registers import BLOCKS, COMMAND, Number, Option, Register

TO_CELL_BYTES, FROM_CELL_BYTES = 64, 128
IMAGE_BYTES = TO_CELL_BYTES + FROM_CELL_BYTES

_SHOWN = """
    MAGIC MAP_VERSION HEARTBEAT BITS BITS_REASON STATE STATUS_BITS NACK_REASON
    CMD_SEQ_ECHO DONE_SEQ LAST_SEQ ERROR WARNING ACTIVE_JOB START_EPOCH
    SEQ_HEAD RESULT JOB REJECT COUNT REMAINING SCORE FLAGS F_X F_Y F_Z F_A F_B F_C
    G_X G_Y G_Z G_A G_B G_C G_APPROACH_X G_APPROACH_Y G_APPROACH_Z G_RETREAT
    GRASP G_FLAGS SIGMA_X SIGMA_Y SIGMA_Z CONVENTION CONTROL SEQ_TAIL
"""
"""Register names in the order of the image from the cell. CONTROL is the value that the cell has read."""


def _placed(registers: Iterable[Register]) -> tuple[Register, ...]:
    """The registers placed one after the other; each address counts words from 0."""
    placed, end = list[Register](), 0
    for register in registers:
        placed.append(replace(register, address=end))
        end += register.kind.words
    return tuple(placed)


_MAP = {register.name: (register, block) for block in BLOCKS for register in block.registers}
"""Register and block by name. JOB occurs in two blocks; the later one, of the result, counts."""
TO_CELL = _placed(COMMAND.registers)
"""Registers that the PLC writes; the words after them are 0."""
FROM_CELL = _placed(_MAP[name][0] for name in _SHOWN.split())
"""Registers that the cell writes."""
SHOWN_BLOCKS = tuple(block for block in BLOCKS if block in {_MAP[name][1] for name in _SHOWN.split()})
"""Blocks of the map that the image from the cell is made of, in the order of the map."""


def image_from_cell(values: Mapping[str, Number], *, little: bool) -> bytes:
    """Encode the 128 bytes. values : of `SHOWN_BLOCKS` by name. little : the PLC's low byte comes first."""
    return _form(FROM_CELL, little).pack(*(values[register.name] for register in FROM_CELL))


def values_to_cell(image: bytes, *, little: bool) -> dict[str, Number]:
    """Decode the values of the command block by name; image : 64 bytes.

    Only ALL_JOBS, SKIP and BELT of OPTIONS are kept: an image stays in the PLC's memory, so ONCE would run an
    old command after each start, and RELEASE would give up the right to write with every read.
    """
    form = _form(TO_CELL, little)
    values: dict[str, Number] = {
        register.name: value for register, value in zip(TO_CELL, form.unpack_from(image), strict=True)
    }
    return values | {"OPTIONS": int(values["OPTIONS"]) & (Option.ALL_JOBS | Option.SKIP | Option.BELT)}


NO_IMAGE = bytes(FROM_CELL_BYTES)
"""Image from a cell that does not run: no bit is set, and there is no result."""


@functools.cache
def _form(registers: tuple[Register, ...], little: bool) -> struct.Struct:
    kinds = "".join(register.kind.value for register in registers)
    return struct.Struct(("<" if little else ">") + kinds)
