"""A conveyor belt: how parts go on with the count of an encoder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from edged.domain.arrays import FloatArray

Source = Literal["command", "camera"]
"""Who says the count: the client with its command, or a camera with its image."""


@dataclass(frozen=True, slots=True)
class Belt:
    """A belt, in the frame of the published coordinates.

    step_mm (x, y, z) : by how much a part goes on with one count. first_mm : origin of the belt's frame.
    counts : after so many the encoder begins again at 0. source : of the count: the client with its command,
    or a camera with its image. speed_mm_s : where nobody says it. jitter_s : one sigma of when the count was
    read. exposure_s : how long the cameras expose. focal_px : the longer one of both. same_mm : parts that
    are nearer to each other are the same.
    """

    step_mm: tuple[float, float, float]
    first_mm: tuple[float, float, float]
    counts: int
    source: Source
    speed_mm_s: float
    jitter_s: float
    exposure_s: float
    focal_px: float
    same_mm: float


@dataclass(frozen=True, slots=True)
class BeltReading:
    """The encoder as a client read it. read_ns : UTC ns when its command came."""

    count: int
    speed_mm_s: float
    read_ns: int


@dataclass(frozen=True, slots=True)
class BeltMoment:
    """The belt in the middle of an exposure.

    count : with its fraction. speed_mm_s : along the travel. sigma_mm : one sigma of where it is.
    """

    count: float
    speed_mm_s: float
    sigma_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class OnBelt:
    """A part on the belt.

    number : from 1, the same as often as it is seen. covariance (6, 6) : of its pose by where the belt is,
    rig frame. belt_from_part (4, 4) : at the whole count. belt_covariance (6, 6) : of it.
    """

    number: int
    covariance: FloatArray
    belt_from_part: FloatArray
    belt_covariance: FloatArray


@dataclass(frozen=True, slots=True)
class PartSeen:
    """Where a part lay at a count, frame of the published coordinates."""

    number: int
    count: float
    place_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PartsSeen:
    """Parts that were seen on the belt and have not gone far since. last : the newest number."""

    parts: tuple[PartSeen, ...] = ()
    last: int = 0
