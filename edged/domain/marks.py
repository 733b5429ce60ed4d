"""Reference marks: whether they correct a result, and what they show."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from edged.domain.arrays import FloatArray


class MarksState(enum.IntEnum):
    """Whether the reference marks hold the cell true."""

    NONE = 0
    """This cell has no reference marks."""
    CORRECTED = 1
    """The marks agree: results are where the cameras are now."""
    COASTING = 2
    """Too few marks are seen: the last correction counts, and sigma grows with time."""
    KNOCKED = 3
    """A camera, the rig or the plate of the marks was moved: no results until the marks agree again."""
    CONTRADICTED = 4
    """Marks contradict each other or are not this cell's: those excluded, or no results."""
    OTHER_CALIBRATION = 5
    """The marks were taught with another calibration of the rig: results are not corrected."""


@dataclass(frozen=True, slots=True)
class MarksReport:
    """What the marks of one exposure say.

    valid : whether results may be given. seen : marks that were used, of `taught`. excluded : codes of those
    that disagree. fit : squared misfit over what is expected, about 1; None where nothing was compared.
    left_mm, right_mm : how far each camera is from where it was taught; None before the first
    exposure. why : text for people; "" if all is
    well.
    """

    state: MarksState = MarksState.NONE
    valid: bool = True
    seen: int = 0
    taught: int = 0
    excluded: tuple[int, ...] = ()
    fit: float | None = None
    left_mm: float | None = None
    right_mm: float | None = None
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MarksTrack:
    """All that is carried from exposure to exposure; with a pair of pictures it decides the next.

    displacement (14,) of the cameras, see `edged.vision.geometry.correction`; covariance (14, 14) of it;
    cross (14, 8 N) : covariance with the dots' taught places, and with what pixels do to them. maps (14,) :
    displacement that the rectified pictures are made for. exposed_ns : of the exposure before, UTC, 0 at the
    beginning. knocked : a knock was found, and results wait for `wait` exposures that agree (without healing
    for ever). searched, blank : exposures until the next search of the whole picture, and how many found
    nothing.
    """

    displacement: FloatArray
    covariance: FloatArray
    cross: FloatArray
    maps: FloatArray
    exposed_ns: int = 0
    knocked: bool = False
    wait: int = 0
    searched: int = 0
    blank: int = 0
