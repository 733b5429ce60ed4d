"""Decides whether two frames belong to one exposure, using the best clock that both cameras share.

    both locked to PTP                   their own time stamps, to the microsecond
    both mapped to the host's clock      `exposed_ns`, to about 0.1 ms
    command time known, no stamps        when the commands were sent
    only arrival known                   arrival, with a limit of its own, and both frame counters

A camera that claims to be locked to PTP is not trusted blindly: its stamps must agree with the map of its
clock.
"""

from __future__ import annotations

from dataclasses import dataclass

from edged.domain.frames import Frame, TimeBase

CLOCK_DRIFT = 400e-6
"""Largest relative drift of two camera clocks: crystals of ±200 ppm each over temperature and age."""


@dataclass(frozen=True, slots=True)
class Skew:
    """Time between two exposures: left minus right, and its limit, in ns; what : what was compared."""

    ns: int
    limit_ns: int
    what: str

    @property
    def is_one_exposure(self) -> bool:
        """Whether the skew is within the limit."""
        return abs(self.ns) <= self.limit_ns

    def __str__(self) -> str:
        return f"{self.what} {abs(self.ns) * 1e-6:.2f} ms apart, allowed {self.limit_ns * 1e-6:g} ms"


class Pairing:
    """Compares frames of two cameras; remembers the last pair.

    max_skew_s : limit of the time between two frames of one exposure.
    max_arrival_skew_s : limit if only their arrival is known.
    """

    def __init__(self, max_skew_s: float, max_arrival_skew_s: float) -> None:
        self._limit_ns = round(max_skew_s * 1e9)
        self._arrival_limit_ns = round(max_arrival_skew_s * 1e9)
        self._last: tuple[Frame, Frame] | None = None

    def forget(self) -> None:
        """Forget the last pair, as a reopened camera may restart its clock and counter."""
        self._last = None

    def accept(self, left: Frame, right: Frame) -> None:
        """Store two frames of one exposure as the reference for the next pair."""
        # without their images, which the comparison does not need
        self._last = (_without_image(left), _without_image(right))

    def skew(self, left: Frame, right: Frame) -> Skew:
        """Return the skew of two exposures by the best clock they share."""
        bases = {left.time_base, right.time_base}
        apart_ns = left.exposed_ns - right.exposed_ns
        if TimeBase.ARRIVAL in bases:
            return Skew(apart_ns, self._arrival_limit_ns, "arrivals")
        if bases == {TimeBase.PTP}:
            by_ptp_ns = left.device_ns - right.device_ns
            doubt_ns = (left.exposed_bound_ns or 0) + (right.exposed_bound_ns or 0)
            if abs(by_ptp_ns - apart_ns) <= doubt_ns:
                return Skew(by_ptp_ns, self._limit_ns, "exposures by PTP")
        return Skew(apart_ns, self._limit_ns, "exposures")

    def problem(self, left: Frame, right: Frame) -> str:
        """Return why two frames are not one exposure; "" if they are."""
        skew = self.skew(left, right)
        if not skew.is_one_exposure:
            return str(skew)
        bases = {left.time_base, right.time_base}
        if TimeBase.ARRIVAL in bases and (text := self._counters(left, right)):
            return text
        return "" if bases <= {TimeBase.PTP, TimeBase.CAMERA} else self._clocks(left, right)

    def _counters(self, left: Frame, right: Frame) -> str:
        """Problem if the cameras counted different numbers of frames since the last pair; "" otherwise."""
        if self._last is None:
            return ""
        ours, theirs = left.frame_id - self._last[0].frame_id, right.frame_id - self._last[1].frame_id
        if ours == theirs:
            return ""
        return f"since the last pair left counted {ours} frames, right {theirs}"

    def _clocks(self, left: Frame, right: Frame) -> str:
        """Problem if the cameras' own clocks counted different times since the last pair; "" otherwise.

        This needs no common epoch, and it detects what host time cannot: a camera that reacted late to its
        trigger.
        """
        if self._last is None:
            return ""
        ours, theirs = left.device_ns - self._last[0].device_ns, right.device_ns - self._last[1].device_ns
        if ours <= 0 or theirs <= 0:  # a camera without a clock, or whose clock was set
            return ""
        skew = Skew(ours - theirs, self._limit_ns, "exposures by the cameras' own clocks")
        drifted_ns = CLOCK_DRIFT * max(ours, theirs)
        return "" if abs(skew.ns) <= skew.limit_ns + drifted_ns else str(skew)


def _without_image(frame: Frame) -> Frame:
    return Frame(frame.camera, frame.frame_id, frame.image[:0, :0].copy(), frame.device_ns, frame.exposed_ns)
