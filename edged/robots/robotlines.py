"""What the clients that talk in lines of text share: where each field stands, and what went wrong."""

from __future__ import annotations

import enum
import re
import textwrap

from edged.plc.answers import Reason
from edged.plc.lines import LineStatus, answer_fields
from edged.robot.orientations import Brand

PORT = 1503


class Failure(enum.IntEnum):
    """What a client says beside the cell's own `LineStatus`."""

    LATE = 200
    """No answer in time."""
    NO_LINK = 201
    """The cell is not reached, or the link was lost."""
    NO_ANSWER = 202
    """What came is no answer: another number of fields, a number that is none, an answer to nothing."""
    OTHERS = 203
    """An answer to another request."""


FAILURES = {
    Failure.LATE: "no answer in time",
    Failure.NO_LINK: "no link",
    Failure.NO_ANSWER: "what came is no answer",
    Failure.OTHERS: "an answer to another request",
}
STATUSES = {
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
    LineStatus.NO_SUCH_BRAND: "a brand that the cell does not know",
}


def statuses(comment: str, width: int = 72) -> str:
    """Every error number and what it means, as lines of comment."""
    known = {int(reason): reason.name.lower().replace("_", " ") for reason in Reason if reason}
    known |= {102: "nothing found", 103: "not good enough", 105: "a number that fits no register"}
    known |= {int(status): text for status, text in STATUSES.items()}
    known |= {int(failure): text for failure, text in FAILURES.items()}
    text = ", ".join(f"{number} {what}" for number, what in sorted(known.items()))
    return "\n".join(comment + line for line in textwrap.wrap(text, width))


def filled(template: str, brand: Brand, first: int, **more: object) -> str:
    """A template with its @NAMES@: brand, numbers of fields (counted from `first`) and failures, `more`."""
    fields = answer_fields(brand)
    values: dict[str, object] = {name: index + first for index, name in enumerate(fields)}
    values |= {"BRAND": brand, "FIELDS": len(fields), "PORT": PORT}
    values |= {**{one.name: int(one) for one in Failure}, **more}
    return re.sub(r"@(\w+)@", lambda name: str(values[name[1]]), template)
