"""Template values for the programs that talk in lines of text: index of each field, and error numbers."""

from __future__ import annotations

import enum
import textwrap
from collections.abc import Iterable

from edged.plc.answers import NackReason
from edged.plc.lines import LineStatus, answer_fields
from edged.robot.orientations import Brand


class Failure(enum.IntEnum):
    """Errors that a program reports in addition to the cell's own `LineStatus`."""

    LATE = 200
    """No answer in time."""
    NO_LINK = 201
    """The cell cannot be reached, or the link was lost."""
    NO_ANSWER = 202
    """Not an answer: wrong number of fields, a field that is no number, or an unrequested line."""
    OTHERS = 203
    """An answer to another request."""


MEANINGS = {
    102: "nothing found",
    103: "not good enough",
    105: "a number that fits no register",
    LineStatus.NOT_VALID: "too old, or acknowledged",
    LineStatus.RIG_FRAME: "the rig is not registered to the robot",
    LineStatus.SIMULATED: "a virtual cell",
    LineStatus.TAKEN_OVER: "another client commanded",
    LineStatus.NOT_YOUR_TURN: "another client may write",
    LineStatus.MAY_NOT_WRITE: "not among the cell's writers",
    LineStatus.NOT_UNDERSTOOD: "no request (a cell older than this program?)",
    LineStatus.NO_FURTHER: "no further target",
    LineStatus.OUT_OF_LIMITS: "where the robot must not go",
    LineStatus.NO_GRASP: "the part has no grasp",
    LineStatus.NO_OFFSET: "no golden part, or it no longer holds",
    LineStatus.NO_TRAY: "the job has no tray, or not this pocket",
    LineStatus.NO_BELT: "the part is on no belt",
    LineStatus.NO_SUCH_BRAND: "a brand that the cell does not know",
    Failure.LATE: "no answer in time",
    Failure.NO_LINK: "no link",
    Failure.NO_ANSWER: "what came is no answer",
    Failure.OTHERS: "an answer to another request",
}
"""Texts of the error numbers; the NACK reasons, 1 to 99, have their own."""
TRAY_FIELDS = ("POCKET", "TAKEN", "EMPTY", "POCKETS", "IS_TAKEN")
"""Fields of the answer to TRAY in place of a pose, in their order."""


BELT_FIELDS = ("COUNT_HIGH", "COUNT_LOW", "SPEED", "PART")
"""Fields of the answer to COUNT in place of a pose, in their order."""


def line_values(brand: Brand, first: int, jobs: Iterable[str] = ()) -> dict[str, object]:
    """Values for a brand's templates; first : index of an array's first element in its language.

    statuses : every error number and its meaning, and the cell's jobs, as lines for a comment.
    """
    fields = answer_fields(brand)
    reasons = {int(reason): reason.name.lower().replace("_", " ") for reason in NackReason if reason}
    meanings = ", ".join(f"{number:d} {meaning}" for number, meaning in (reasons | MEANINGS).items())
    return {
        "brand": brand,
        "n_fields": len(fields),
        "field": {name: index for index, name in enumerate(fields, first)},
        "tray": {name: index for index, name in enumerate(TRAY_FIELDS, first + fields.index("X"))},
        "belt": {name: index for index, name in enumerate(BELT_FIELDS, first + fields.index("X"))},
        "failure": {failure.name: int(failure) for failure in Failure},
        "status": {status.name: int(status) for status in LineStatus},
        "statuses": textwrap.wrap(meanings, 72) + [f"job {job}" for job in jobs],
    }
