"""Registration by the robot's own program: state, quality, and reasons why a command failed."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

UNKNOWN_6 = (math.nan,) * 6


class Method(enum.IntEnum):
    """Method of a registration."""

    NONE = 0
    """No method yet."""
    HAND_EYE = 1
    """Poses of the flange with pictures of a board."""
    TOUCH = 2
    """Points touched by the tool's tip, with pictures of a part there."""


class Obstacle(enum.Enum):
    """Why a registration command was not carried out; a NACK_REASON has the same name."""

    CAPTURE_FAULT = "the cameras gave no pair of images"
    FAILED = "accepted, and then it could not be carried out"
    NO_REGISTRATION = "no registration is under way: it begins with HAND_EYE_START or TOUCH_START"
    NOT_SEEN = "the board or the part is not seen well enough in both pictures"
    SAME_PLACE = "this pose or point is there already"
    TOO_FEW = "too few poses or points"
    TURN_MORE = "the poses do not turn about two axes, or the points lie on one line"
    NOT_GOOD = "the poses or points do not agree within the limit"
    OTHER_READING = "the poses agree when they are read in another way"


@dataclass(frozen=True, slots=True)
class Registration:
    """State of a registration; lengths are NaN until it is solved.

    samples : poses or points taken; used : those not rejected as outliers. worst : number, from 1, of the
    sample that agrees least with the others; 0: none.
    rms_mm, held_out_mm : residual of poses or points to the fit of all, and to the fit of all others, at the
    board or the point; limit_mm : of held_out_mm. sigma : of X, Y, Z (mm) at the centre of the samples, and
    of the rotation about each axis (degrees), in the robot's frame.
    """

    method: Method = Method.NONE
    samples: int = 0
    used: int = 0
    worst: int = 0
    rms_mm: float = math.nan
    held_out_mm: float = math.nan
    limit_mm: float = math.nan
    sigma: tuple[float, ...] = UNKNOWN_6
