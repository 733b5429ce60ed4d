"""Types of the map: kinds of registers, blocks, and the meaning of bits and codes."""

from __future__ import annotations

import enum
import re
import struct
import textwrap
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

MAGIC = 0x4544  # "ED"
MAP_VERSION, MAP_PUBLISHED = 4, datetime(2026, 11, 23, tzinfo=UTC)
INT32_MIN = -(2**31)
INT32_MAX = 2**31 - 1
UINT16_MAX = 0xFFFF
UINT32_MAX = 0xFFFFFFFF
TABLE_ROWS = 16
ROW_WORDS = 20
JOB_ROWS = 16
NAME_WORDS = 15
"""Words of a job's name, two characters each."""

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
    """No result is on display."""
    OK = 1
    """A part within all limits; coordinates where VALID is set."""
    NO_TARGET = 2
    """Nothing found, or nothing that could be measured."""
    LOW_QUALITY = 3
    """Found, but beyond a limit: REJECT says which."""
    CAPTURE_FAULT = 4
    """The cameras gave no pair of images: ERROR says why."""
    OUT_OF_RANGE = 5
    """A number that does not fit its register."""
    GRABBED = 6
    """The pictures were taken, as GRAB requested; nothing was measured for the PLC."""
    VERIFIED = 7
    """Within all limits, as VERIFY requested; without coordinates."""
    RELOADED = 8
    """The basis of the result was replaced since (a reload, a registration, another job): ask again."""
    KEPT = 9
    """The part is the golden one from now on, as GOLDEN requested; without coordinates."""


class StatusBit(enum.IntFlag):
    """Register STATUS_BITS."""

    READY = 1 << 0
    """A command would be carried out: cameras deliver, and the queue has room."""
    ACK = 1 << 1
    """The command of DONE_SEQ was carried out, even if nothing was found."""
    NACK = 1 << 2
    """The command of DONE_SEQ was not carried out: NACK_REASON says why."""
    BUSY = 1 << 3
    """A command is open, or a cycle runs."""
    EXPOSURE_DONE = 1 << 4
    """Both images of the newest command are in memory: the robot may move."""
    RESULT_VALID = 1 << 5
    """The result on display is good, fresh and not yet acknowledged: the only permission to move."""
    OK = 1 << 6
    """Set with RESULT_VALID; after VERIFY: the part is good."""
    NOK = 1 << 7
    """The result on display is bad, or a fault."""
    ERROR = 1 << 8
    """The cell has an error: ERROR says which."""
    OVERRUN = 1 << 9
    """A command came while eight were open; reset by the next one that is accepted."""
    DRIFT_WARN = 1 << 10
    """The calibration drifts, or is invalid."""
    CAL_INVALID = 1 << 11
    """The calibration is wrong: results are refused."""
    CAM_FAULT = 1 << 12
    """A camera does not deliver."""
    LIGHT_FAULT = 1 << 13
    """Reserved, 0."""
    OVERTEMP = 1 << 14
    """Reserved, 0."""
    SIMULATED = 1 << 15
    """The last result came from a virtual cell."""


class Flag(enum.IntFlag):
    """Register FLAGS of a result."""

    VALID = 1 << 0
    """The coordinates may be used."""
    ROBOT_FRAME = 1 << 1
    """Coordinates are in the robot's frame; without this bit in the left camera's."""
    SIMULATED = 1 << 2
    """From a virtual cell: not for a real robot."""
    FREE_RUNNING = 1 << 3
    """The result of a free-running cycle, not of a command: SEQ is the number of the cycle."""


class Option(enum.IntFlag):
    """Register OPTIONS, written by the client."""

    RELEASE = 1 << 0
    """Give up the right to write; reads back as 0."""
    ONCE = 1 << 1
    """With CMD_SEQ in one request: it is written only once, so it runs even as a connection's first."""
    ALL_JOBS = 1 << 2
    """With CMD_SEQ in one request: LOCATE and VERIFY try every job, and the part that agrees best counts."""
    SKIP = 1 << 3
    """With CMD_SEQ in one request: the part that was shown last could not be picked; it now comes last."""
    BELT = 1 << 4
    """With CMD_SEQ in one request: BELT_COUNT and BELT_SPEED give the belt's position and speed."""


class ControlBit(enum.IntFlag):
    """Register CONTROL, written by a client that has no sequences; bits 8 to 15 are the job."""

    START = 1 << 0
    """Rising edge: a command. Falling edge: its result was used, or it is cancelled."""
    NEXT = 1 << 1
    """At the rising edge of START: the next part of the same picture instead of a new picture."""
    ALLOW_SIMULATED = 1 << 2
    """OK also for coordinates of a virtual cell, where there is no real part."""


class CellBit(enum.IntFlag):
    """Register BITS, the answer to CONTROL."""

    READY = 1 << 0
    """START may rise."""
    BUSY = 1 << 1
    """The command runs."""
    EXPOSURE_DONE = 1 << 2
    """The picture is taken: the robot may move."""
    DONE = 1 << 3
    """The command has ended; reset when START falls."""
    OK = 1 << 4
    """DONE, and a robot may use the coordinates now: the only permission to move."""
    NOK = 1 << 5
    """DONE, and a robot may not use them: RESULT, F_RESULT and BITS_REASON say why."""


class Warn(enum.IntFlag):
    """Register WARNING."""

    CLIENT_LOST = 1 << 0
    """The client's heartbeat has stopped: its result is withdrawn."""
    SETUP = 1 << 1
    """The cell is in SETUP: commands end in NACK 7. SETUP_SOURCE says why."""
    UNSYNCHRONISED = 1 << 2
    """No client's CMD_SEQ is known: the next one runs nothing."""


@dataclass(frozen=True, slots=True)
class Register:
    """One named value of the map; address : that of its first word."""

    name: str
    address: int
    kind: Kind
    unit: str
    help: str


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Registers without gaps between them; blocks compare by identity.

    words : its length. high_first : the high word comes first, regardless of the configured word order.
    """

    name: str
    address: int
    registers: tuple[Register, ...]
    words: int
    writable: bool = False
    high_first: bool = False


def make_block(
    name: str, address: int, table: str, *, writable: bool = False, high_first: bool = False
) -> Block:
    """Build a block from a table in the form of `layout`; a line indented further continues a meaning.

    >>> [register.name for register in make_block("place", 0, "P_[XYZ] i32 µm of the part").registers]
    ['P_X', 'P_Y', 'P_Z']
    """
    registers: list[Register] = []
    end = address
    for row in re.sub(r"\n {4} *(?=\S)", " ", textwrap.dedent(table).strip("\n")).strip().splitlines():
        first, kind_name, units, text = row.split(maxsplit=3)
        kind, (stem, _, axes) = Kind[kind_name.upper()], first.rstrip("]").partition("[")
        for axis in axes or ("",):
            length_unit, _, angle_unit = units.partition("/")
            unit = (angle_unit if axis in {*"ABC"} else length_unit).replace("_", " ").strip("-")
            registers.append(Register(stem + axis, end, kind, unit, text))
            end += kind.words
    return Block(name, address, tuple(registers), end - address, writable, high_first)


def list_bits(flags: type[enum.IntFlag]) -> str:
    """ "0 FIRST, 1 SECOND, ..." for documentation."""
    return ", ".join(f"{flag.value.bit_length() - 1} {flag.name}" for flag in flags)


def list_codes(codes: type[enum.IntEnum]) -> str:
    """ "0 FIRST, 1 SECOND, ..." for documentation."""
    return ", ".join(f"{code.value} {code.name}" for code in codes)
