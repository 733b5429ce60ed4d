"""Reference marks: their state, their report, and the track of the cameras."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from edged.domain.arrays import FloatArray


class MarksState(enum.IntEnum):
    """State of the correction by reference marks."""

    NONE = 0
    """This cell has no reference marks."""
    CORRECTED = 1
    """The marks agree; results are corrected for the cameras' present poses."""
    COASTING = 2
    """Too few marks are seen; the last correction is used, and sigma grows with time."""
    KNOCKED = 3
    """A camera, the rig or the plate of the marks was moved; no results until the marks agree again."""
    CONTRADICTED = 4
    """Marks contradict each other or are not this cell's; they are excluded, or there are no results."""
    OTHER_CALIBRATION = 5
    """The marks were taught with another calibration of the rig; results are not corrected."""


@dataclass(frozen=True, slots=True)
class MarksReport:
    """Report of the marks in one exposure.

    valid : whether results may be given. seen : marks that were used, of `taught`. excluded : codes of those
    that disagree. fit : squared misfit relative to the expected one, about 1; None if nothing was compared.
    left_mm, right_mm : displacement of each camera since teaching; None before the first exposure.
    why : text for people; "" if all is well.
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
    """Filter state carried from exposure to exposure; with a pair of pictures it determines the next one.

    displacement (14,) of the cameras, see `edged.vision.geometry.correction`; covariance (14, 14) of it;
    cross (14, 8 N) : its covariance with the dots' taught positions and with the effect of pixel errors on
    them. maps (14,) : displacement for which the rectification maps are made. exposed_ns : of the previous
    exposure, UTC, 0 at first. knocked : a knock was detected, and results are withheld until `wait` more
    exposures agree (for ever without healing). searched : exposures until the next search of the whole
    picture. blank : backoff of that search, grown with each one that found nothing.
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
