"""What the map is made of: kinds of registers, blocks, and the meaning of bits and codes."""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

MAGIC = 0x4544  # "ED"
MAP_VERSION = 1
INT32_MIN = -(2**31)
INT32_MAX = 2**31 - 1
UINT16_MAX = 0xFFFF
UINT32_MAX = 0xFFFFFFFF
TABLE_ROWS = 16
ROW_WORDS = 20

WordOrder = Literal["high", "low"]
Number = int | float


class Kind(enum.Enum):
    """Type of a register: name and `struct` format (big-endian)."""

    U16 = "H"
    I32 = "i"
    U32 = "I"
    U64 = "Q"
    F32 = "f"

    @property
    def words(self) -> int:
        """Number of 16-bit words."""
        return struct.calcsize(">" + self.value) // 2


class ResultCode(enum.IntEnum):
    """Register RESULT."""

    NONE = 0
    OK = 1
    NO_TARGET = 2
    LOW_QUALITY = 3
    CAPTURE_FAULT = 4
    OUT_OF_RANGE = 5
    GRABBED = 6
    VERIFIED = 7


class StatusBit(enum.IntFlag):
    """Register STATUS_BITS."""

    READY = 1 << 0
    ACK = 1 << 1
    NACK = 1 << 2
    BUSY = 1 << 3
    EXPOSURE_DONE = 1 << 4
    RESULT_VALID = 1 << 5
    OK = 1 << 6
    NOK = 1 << 7
    ERROR = 1 << 8
    OVERRUN = 1 << 9
    DRIFT_WARN = 1 << 10
    CAL_INVALID = 1 << 11
    CAM_FAULT = 1 << 12
    LIGHT_FAULT = 1 << 13
    OVERTEMP = 1 << 14
    SIMULATED = 1 << 15


class Flag(enum.IntFlag):
    """Register FLAGS of a result."""

    VALID = 1 << 0
    ROBOT_FRAME = 1 << 1
    SIMULATED = 1 << 2
    FREE_RUNNING = 1 << 3


class Option(enum.IntFlag):
    """Register OPTIONS, written by the client."""

    RELEASE = 1 << 0


class Warn(enum.IntFlag):
    """Register WARNING."""

    CLIENT_LOST = 1 << 0


@dataclass(frozen=True, slots=True)
class Register:
    """One named value of the map; address is that of its first word."""

    name: str
    address: int
    kind: Kind
    unit: str
    help: str


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Registers without gaps between them; each is one object, which is equal to itself only.

    high_first : the word order setting does not apply, the high word comes first.
    """

    name: str
    address: int
    registers: tuple[Register, ...]
    writable: bool = False
    high_first: bool = False

    @property
    def words(self) -> int:
        """Length in words."""
        last = self.registers[-1]
        return last.address + last.kind.words - self.address


def make_block(
    name: str,
    address: int,
    rows: Iterable[tuple[str, Kind, str, str]],
    *,
    writable: bool = False,
    high_first: bool = False,
) -> Block:
    """A block of rows (name, kind, unit, meaning) that follow each other without gaps."""
    registers = []
    place = address
    for register_name, kind, unit, text in rows:
        registers.append(Register(register_name, place, kind, unit, text))
        place += kind.words
    return Block(name, address, tuple(registers), writable, high_first)


def list_bits(flags: type[enum.IntFlag]) -> str:
    """ "0 FIRST, 1 SECOND, ..." for documentation."""
    return ", ".join(f"{flag.value.bit_length() - 1} {flag.name}" for flag in flags)


def list_codes(codes: type[enum.IntEnum]) -> str:
    """ "0 FIRST, 1 SECOND, ..." for documentation."""
    return ", ".join(f"{code.value} {code.name}" for code in codes)
