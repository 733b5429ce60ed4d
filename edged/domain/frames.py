"""The images of one exposure."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Self

from edged.domain.arrays import Image, Side


class TimeBase(enum.StrEnum):
    """Source of an exposure's time, best first."""

    PTP = "ptp"
    CAMERA = "camera"
    HOST = "host"
    ARRIVAL = "arrival"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of one camera.

    image : (H, W) uint8, owned by the frame (never a view of a driver's buffer).
    frame_id : the camera's own counter.
    device_ns : the camera's time stamp, in its own epoch; with `TimeBase.PTP`, the epoch shared by all such
    cameras.
    exposed_ns : best estimate of the exposure's start, host UTC ns.
    exposed_bound_ns : bound on the error of exposed_ns, by the host's clock; None: unknown.
    time_base : PTP and CAMERA: the camera's stamp, by a map between its clock and the host's. HOST: when the
        command was sent. ARRIVAL: when the image arrived.
    count : of the encoder or counter at the exposure, sent by the camera; None: not requested.
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
        """Return a pair of pictures (H, W) uint8 that do not come from a camera."""
        return cls(Frame("left", 0, left, 0, 0), Frame("right", 0, right, 0, 0))

    def side(self, side: Side) -> Frame:
        """Return the frame of one camera."""
        return self.left if side == "left" else self.right

    @property
    def images(self) -> tuple[Image, Image]:
        """Both pictures."""
        return self.left.image, self.right.image

    @property
    def exposed_ns(self) -> int:
        """Time of the earlier exposure, UTC ns."""
        return self._earlier.exposed_ns

    @property
    def exposed_bound_ns(self) -> int | None:
        """Bound on the error of `exposed_ns`; None: unknown."""
        return self._earlier.exposed_bound_ns

    @property
    def count(self) -> int | None:
        """Encoder count at the exposure of the camera that sends it; None without one."""
        return self.right.count if self.left.count is None else self.left.count

    @property
    def _earlier(self) -> Frame:
        return min(self.left, self.right, key=lambda frame: frame.exposed_ns)
