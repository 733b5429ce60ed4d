"""Binary frames of fixed length: the requests and answers of `lines` for robots that prefer binary data.

A frame begins with two bytes with which no line begins, states its length, and ends with a CRC-32 (as in zlib
and Ethernet) over all bytes before it, so that torn, shifted or foreign frames are rejected. An answer names
the brand of its pose and repeats the sequence of its request, so that an old answer, or one for another
robot, is not mistaken for it. Numbers are big-endian, floats IEEE 754 with 32 bits.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass

from edged.domain.events import CommandKind
from edged.plc.lines import POSE_NAMES, BadRequest, LineAnswer, LineStatus
from edged.robot.orientations import Brand

MAGIC = b"\xed\x46"
VERSION = 1
FLANGE, ALL_JOBS = 1, 2
"""Flags of a request: FLANGE is given; try every job."""
BOX_SHIFT = 4
"""Shift of the upper half of FLAGS: number of the only box that applies, 0: as the register BOX says."""
POSE_SIZE = 7
"""Count of numbers in the longest pose, ABB's."""
REQUEST_ROWS = (
    ("MAGIC", "2s"),
    ("VERSION", "B"),
    ("FLAGS", "B"),
    ("LENGTH", "H"),
    ("SEQUENCE", "H"),
    ("BRAND", "B"),
    ("COMMAND", "B"),
    ("JOB", "H"),
    ("FLANGE", f"{POSE_SIZE}f"),
    ("CRC", "I"),
)
ANSWER_ROWS = (
    ("MAGIC", "2s"),
    ("VERSION", "B"),
    ("BRAND", "B"),
    ("LENGTH", "H"),
    ("SEQUENCE", "H"),
    ("STATUS", "H"),
    ("REMAINING", "H"),
    ("POSE", f"{POSE_SIZE}f"),
    ("SIGMA", "3f"),
    ("AGE", "f"),
    ("CRC", "I"),
)
"""Names and `struct` types of the fields, in their order."""
REQUEST = struct.Struct(">" + "".join(kind for _, kind in REQUEST_ROWS))
ANSWER = struct.Struct(">" + "".join(kind for _, kind in ANSWER_ROWS))
_ONLY_HERE = (
    *("GRASP", "APPROACH", "ACK", "EXPOSE", "RESULT", "AUTO_LOCK", "OFFSET", "OFFSET_PART", "SKIP"),
    *("TRAY", "PLACE", "BELT", "COUNT"),
)
QUERIES = {name: number for number, name in enumerate(_ONLY_HERE, 100)}
COMMANDS = {**{kind.name: int(kind) for kind in CommandKind}, **QUERIES}
"""Values of COMMAND: commands of the registers, and those that exist only in lines and frames."""
BRANDS = {brand: number for number, brand in enumerate(Brand, 1)}
AS_CONFIGURED = 0
"""BRAND of a request without a brand; in older frames this byte was the upper half of COMMAND."""


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """Request in a frame. flange : its numbers in the brand's convention, () if not given.

    brand : of the robot; None: the configured one. box : 0 to 15, as in `edged.adapters.modbus.lines`.
    """

    sequence: int
    command: str
    job: int = 0
    flange: tuple[float, ...] = ()
    tries_all: bool = False
    brand: Brand | None = None
    box: int = 0

    def frame(self) -> bytes:
        """Encode the request as the bytes to send."""
        flags = (FLANGE if self.flange else 0) | (ALL_JOBS if self.tries_all else 0) | self.box << BOX_SHIFT
        flange = self.flange + (0.0,) * (POSE_SIZE - len(self.flange))
        brand = BRANDS[self.brand] if self.brand is not None else AS_CONFIGURED
        head = (MAGIC, VERSION, flags, REQUEST.size, self.sequence, brand, COMMANDS[self.command], self.job)
        return _sealed(REQUEST.pack(*head, *flange, 0))


def read_request(frame: bytes, configured: Brand) -> FrameRequest:
    """Decode a request. configured : brand of a request without one. Raises `BadRequest`.

    >>> read_request(FrameRequest(7, "LOCATE", 2).frame(), Brand.KUKA).job
    2
    """
    try:
        whole, sequence, named, number, job, *flange = _opened(frame, REQUEST)
    except ValueError as error:
        raise BadRequest(str(error), configured) from error
    box, flags = divmod(whole, 1 << BOX_SHIFT)
    command = next((name for name, code in COMMANDS.items() if code == number), None)
    if command is None or flags & ~(FLANGE | ALL_JOBS):
        raise BadRequest(f"no such command or flag: {number}, {flags}", configured)
    brand = next((brand for brand, code in BRANDS.items() if code == named), None)
    if brand is None and named != AS_CONFIGURED:
        raise BadRequest(f"no such brand: {named}", configured, LineStatus.NO_SUCH_BRAND, sequence)
    size = len(POSE_NAMES[brand or configured]) if flags & FLANGE else 0
    return FrameRequest(sequence, command, job, tuple(flange[:size]), bool(flags & ALL_JOBS), brand, box)


def answer_frame(answer: LineAnswer, brand: Brand) -> bytes:
    """Encode an answer as the bytes to send."""
    pose = answer.pose + (0.0,) * (POSE_SIZE - len(answer.pose))
    head = (MAGIC, VERSION, BRANDS[brand], ANSWER.size, answer.sequence, int(answer.status))
    numbers = (*pose, *answer.sigma, answer.age_s)
    return _sealed(ANSWER.pack(*head, answer.remaining, *numbers, 0))


def read_answer(frame: bytes, brand: Brand, sequence: int) -> LineAnswer:
    """Decode the answer to the request with this sequence. Raises ValueError for any other frame.

    An answer with sequence 0 means that the request was invalid.
    """
    written_for, answered, status, remaining, *numbers = _opened(frame, ANSWER)
    if written_for != BRANDS[brand]:
        raise ValueError(f"the answer is written for brand {written_for}, expected {BRANDS[brand]}")
    if answered != sequence and not (answered == 0 and status):
        raise ValueError(f"an answer to {answered}, expected {sequence}")
    if not all(map(math.isfinite, numbers)):
        raise ValueError("a number of the answer is not finite")
    x, y, z, age_s = numbers[POSE_SIZE:]
    return LineAnswer(answered, status, remaining, tuple(numbers[: len(POSE_NAMES[brand])]), (x, y, z), age_s)


def _sealed(frame: bytes) -> bytes:
    """The frame with its CRC in the last four bytes."""
    return frame[:-4] + zlib.crc32(frame[:-4]).to_bytes(4, "big")


def _opened(frame: bytes, form: struct.Struct) -> tuple[int, ...]:
    """The byte after the version, and the numbers between head and CRC. Raises ValueError."""
    if len(frame) != form.size or frame != _sealed(frame):
        raise ValueError("a frame that is torn")
    magic, version, byte, length, *numbers, _crc = form.unpack(frame)
    if (magic, version, length) != (MAGIC, VERSION, form.size):
        raise ValueError("another version, or no frame")
    return (byte, *numbers)
