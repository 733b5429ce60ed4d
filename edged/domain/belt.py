"""A conveyor belt: how parts move with the count of an encoder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from edged.domain.arrays import FloatArray

Source = Literal["command", "camera"]
"""Source of the count: the client, with its command, or a camera, with its image."""


@dataclass(frozen=True, slots=True)
class Belt:
    """A belt, in the frame of the published coordinates.

    step_mm (x, y, z) : motion of a part per count. first_mm : origin of the belt's frame.
    counts : number of counts after which the encoder wraps to 0. source : of the count: the client with its
    command, or a camera with its image. speed_mm_s : used if no command gives the speed. jitter_s : one sigma
    of the time at which the count was read. exposure_s : exposure time of the cameras. focal_px : the longer
    focal length of the two. same_mm : a part within this distance of the predicted position of a known part
    is that part.
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
    """Encoder reading of a client. read_ns : UTC ns when its command arrived."""

    count: int
    speed_mm_s: float
    read_ns: int


@dataclass(frozen=True, slots=True)
class BeltMoment:
    """The belt in the middle of an exposure.

    count : with a fraction. speed_mm_s : along the travel. sigma_mm : one sigma of its position.
    """

    count: float
    speed_mm_s: float
    sigma_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class OnBelt:
    """A part on the belt.

    number : from 1, the same whenever the part is seen again. covariance (6, 6) : part of its pose's
    covariance that comes from the belt's position, rig frame. belt_from_part (4, 4) : at the rounded count.
    belt_covariance (6, 6) : of belt_from_part.
    """

    number: int
    covariance: FloatArray
    belt_from_part: FloatArray
    belt_covariance: FloatArray


@dataclass(frozen=True, slots=True)
class PartSeen:
    """Position of a part at a count, frame of the published coordinates."""

    number: int
    count: float
    place_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PartsSeen:
    """Parts seen on the belt that have not travelled far since. last : newest number given to a part."""

    parts: tuple[PartSeen, ...] = ()
    last: int = 0
