"""The images of one exposure."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Self

from edged.domain.arrays import Image, Side


class TimeBase(enum.StrEnum):
    """Where the time of an exposure comes from, best first."""

    PTP = "ptp"
    CAMERA = "camera"
    HOST = "host"
    ARRIVAL = "arrival"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of one camera.

    image : (H, W) uint8, owned by the frame (never a view of a driver's buffer).
    frame_id : the camera's own counter.
    device_ns : the camera's time stamp, its own epoch; with `TimeBase.PTP` the epoch of all such cameras.
    exposed_ns : host UTC ns of the exposure's begin, as well as it is known.
    exposed_bound_ns : the true time, by the host's clock, is no further away; None: not known.
    time_base : PTP and CAMERA: the camera's stamp, by a map between its clock and the host's. HOST: when the
        command left. ARRIVAL: when the image came.
    count : of the encoder or counter at the exposure, as the camera sent it along; None: it was not asked to.
    """

    camera: str
    frame_id: int
    image: Image
    device_ns: int
    exposed_ns: int
    exposed_bound_ns: int | None = None
    time_base: TimeBase = TimeBase.HOST
    count: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """The two frames of one exposure.

    missed : exposures since the previous pair that were lost or skipped.
    """

    left: Frame
    right: Frame
    missed: int = field(default=0, kw_only=True)

    @classmethod
    def of_images(cls, left: Image, right: Image) -> Self:
        """A pair of pictures (H, W) uint8 that no camera has just taken."""
        return cls(Frame("left", 0, left, 0, 0), Frame("right", 0, right, 0, 0))

    def side(self, side: Side) -> Frame:
        """The frame of one camera."""
        return self.left if side == "left" else self.right

    @property
    def images(self) -> tuple[Image, Image]:
        """Both pictures."""
        return self.left.image, self.right.image

    @property
    def exposed_ns(self) -> int:
        """The earlier of both exposures, UTC ns."""
        return self._earlier.exposed_ns

    @property
    def exposed_bound_ns(self) -> int | None:
        """The bound of its error; None: not known."""
        return self._earlier.exposed_bound_ns

    @property
    def count(self) -> int | None:
        """The encoder's count at the exposure of the camera that has it; None without one."""
        return self.right.count if self.left.count is None else self.left.count

    @property
    def _earlier(self) -> Frame:
        return min(self.left, self.right, key=lambda frame: frame.exposed_ns)
