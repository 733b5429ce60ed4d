"""Lines of text for robots without Modbus: fields and statuses of an answer.

This is the schema of `[modbus.socket]`, as `edged.plc.registers` is that of the registers: the server answers
by it, and the clients in the robots' languages are generated from it.

A request may begin with the brand of its robot: `kuka,7,LOCATE,0`. Its flange is read, and its answer
written, in that maker's pose convention; without a brand, in the configured one. Every generated program
names its brand, because angles in a wrong convention cannot be recognised as such.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from edged.robot.orientations import Brand

MAX_LINE_BYTES = 256
UNKNOWN = -1.0
"""Value of an unknown sigma or age."""
POSE_NAMES: dict[Brand, tuple[str, ...]] = {
    brand: ("X", "Y", "Z", "Q1", "Q2", "Q3", "Q4") if brand is Brand.ABB else ("X", "Y", "Z", "A", "B", "C")
    for brand in Brand
}
"""Names of the numbers of a pose, in the order of `edged.robot.orientations.pose_of`."""


def answer_fields(brand: Brand) -> tuple[str, ...]:
    """Names of an answer's fields, in their order.

    END repeats the sequence: MELFA-BASIC ignores fields beyond the variables that it reads, and would mistake
    the answer for another brand for its own.

    >>> answer_fields(Brand.KUKA)[:4]
    ('SEQUENCE', 'STATUS', 'REMAINING', 'X')
    """
    return (
        "SEQUENCE",
        "STATUS",
        "REMAINING",
        *POSE_NAMES[brand],
        "SIGMA_X",
        "SIGMA_Y",
        "SIGMA_Z",
        "AGE",
        *(("END",) if brand is Brand.MITSUBISHI else ()),
    )


class LineStatus(enum.IntEnum):
    """Second field of an answer. 1 to 99: a NACK_REASON; 102 to 109: 100 plus a RESULT; others are here."""

    OK = 0
    """Carried out; after LOCATE and NEXT: the pose may be used."""
    NOT_VALID = 110
    """Measured, but too old, or already acknowledged."""
    RIG_FRAME = 111
    """The rig is not registered to the robot."""
    SIMULATED = 112
    """From a virtual cell, and `allow_simulated` is not set."""
    TAKEN_OVER = 113
    """Another client's command took the place of this one."""
    NOT_YOUR_TURN = 114
    """Another client holds the right to write."""
    MAY_NOT_WRITE = 115
    """The robot's address is not in `modbus.writers`."""
    NOT_UNDERSTOOD = 116
    """Not a request, or a malformed number."""
    NO_FURTHER = 117
    """NEXT, but there is no further target."""
    OUT_OF_LIMITS = 118
    """Found and good, but in a place where the robot must not go (`[limits]`)."""
    NO_GRASP = 119
    """GRASP, APPROACH or NEXT_GRASP, but the part that was given last has no grasp, or no other one."""
    NO_SUCH_BRAND = 120
    """The request names a brand that this cell does not know."""
    NO_OFFSET = 121
    """OFFSET, OFFSET_PART or PLACE, but the part given last has none: no GOLDEN, or it no longer holds."""
    NO_TRAY = 122
    """TRAY, but the job has no tray, or no such pocket, or the result is withdrawn."""
    NO_BELT = 123
    """BELT or COUNT, but the part that was given last is on no belt."""


class BadRequest(ValueError):
    """Line or frame that is not a valid request.

    brand : brand in whose convention it is answered. sequence : of the request; 0 if unknown.
    """

    def __init__(
        self, why: str, brand: Brand, status: LineStatus = LineStatus.NOT_UNDERSTOOD, sequence: int = 0
    ) -> None:
        self.brand = brand
        self.status = status
        self.sequence = sequence
        super().__init__(why)


@dataclass(frozen=True, slots=True)
class LineAnswer:
    """An answer; an absent pose is 0, absent sigmas and age are -1.

    remaining : targets that NEXT can still give. pose : in the brand's convention. sigma : of X, Y, Z in its
    unit of length. age_s : since the exposure.
    """

    sequence: int
    status: int
    remaining: int = 0
    pose: tuple[float, ...] = ()
    sigma: tuple[float, ...] = (UNKNOWN,) * 3
    age_s: float = UNKNOWN

    def line(self, brand: Brand, end: bytes = b"\n") -> bytes:
        """Encode the answer as a line, always with the same number of fields."""
        pose = self.pose or (0.0,) * len(POSE_NAMES[brand])
        numbers = (f"{number:.6f}" for number in (*pose, *self.sigma, self.age_s))
        whole = (str(self.sequence), str(int(self.status)), str(self.remaining))
        again = (whole[0],) if brand is Brand.MITSUBISHI else ()
        return ",".join((*whole, *numbers, *again)).encode() + end
