"""A stereo head that takes a long and a short exposure in each cycle and merges them into one pair.

Responsible for: switching both cameras between the exposures, and for detecting what a merged picture must
not hide: something that moved, light that changed. Not responsible for: how a pair is captured
(`stereohead`), how it is merged (`pictures.twoexposures`).

A cycle begins with the exposure that the last one ended with, so that each needs only one change.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from edged.cell.stereohead import StereoHead
from edged.cell.tasks import both
from edged.domain.arrays import SIDES, Side
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame, FramePair
from edged.errors import ExposuresDiffer, FrameTimeout
from edged.pictures.twoexposures import MergedExposures, merge_exposures
from edged.ports import Camera

CHANGE_S = 8.0
"""Limit for changing the exposure: some registers, a discarded exposure, and at worst reopening a camera."""
MOST_MOVED_PX = 1.0
"""Limit of the approximate motion between the exposures; truly half a pixel to one. Less blurs a picture no
more than a lens does; a part that is being conveyed moves by many pixels."""
MOST_FLICKER = 0.25
"""Largest relative error of the measured exposure ratio.

Lamps on the mains flicker by less; a camera that applied its new exposure late is off by the whole ratio.
"""

Which = Literal["long", "short"]


@dataclass(frozen=True, slots=True)
class ExposureTimes:
    """Exposures of the last pair. long_us, short_us : left camera. apart_ns : time from first to second."""

    long_us: float
    short_us: float
    apart_ns: int


class TwoExposureHead:
    """A `StereoHead` that exposes twice.

    long_us : configured long exposure of both cameras. ratio : long to short exposure.
    settles : a picture must be discarded after `adjust`, as the cameras do not ensure that it has the new
    exposure.
    """

    def __init__(
        self, head: StereoHead, long_us: Mapping[Side, float], ratio: float, *, settles: bool
    ) -> None:
        self._head, self._ratio, self._settles = head, ratio, settles
        self._configured_us, self._long_us = dict(long_us), dict(long_us)
        self._made_us: dict[Which, tuple[float, ...]] = {}
        self._now: Which | None = None
        self.taken: ExposureTimes | None = None

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right."""
        return self._head.cameras

    async def open(self) -> None:
        """As `StereoHead.open`."""
        await self._head.open()

    async def capture(self) -> FramePair:
        """Return both exposures of both cameras, merged. Raises `CaptureError`.

        Takes up to two time-outs plus the exposure change between them.
        """
        begins = self._now or "long"
        ends: Which = "short" if begins == "long" else "long"
        if self._now is None:
            await self._change_to(begins)
        first = await self._head.capture()
        await self._change_to(ends)
        second = await self._head.capture()
        long, short = (first, second) if begins == "long" else (second, first)
        merged = {side: await self._merged(side, long, short) for side in SIDES}
        apart_ns = second.exposed_ns - first.exposed_ns
        problems = {
            side: problem
            for side, picture in merged.items()
            if (problem := _problem(picture, self._ratio_of(side), apart_ns))
        }
        if problems:
            where, problem = problems.popitem()
            raise ExposuresDiffer("both" if problems else where, problem)
        left, right = (_between(first.side(side), second.side(side), merged[side]) for side in SIDES)
        self.taken = ExposureTimes(self._made_us["long"][0], self._made_us["short"][0], apart_ns)
        return FramePair(left, right, missed=first.missed + second.missed)

    async def listen(self) -> FramePair:
        """Always raise: two exposures cannot be triggered externally; such a configuration is refused."""
        raise FrameTimeout("both", "two exposures are not taken by others' triggers")

    async def adjust(self, side: Side, values: CameraValues) -> CameraValues:
        """As `StereoHead.adjust`; the exposure time is that of the long exposure."""
        await self._be_long()
        made = await self._head.adjust(side, values)
        if values.exposure_us is not None and made.exposure_us is not None:
            self._long_us[side] = made.exposure_us
            self._now = None  # the short exposure changes as well
        return made

    async def limits(self, side: Side) -> CameraLimits:
        """As `StereoHead.limits`."""
        return await self._head.limits(side)

    async def restore(self) -> None:
        """As `StereoHead.restore`; both cameras then have the configured, long exposure."""
        self._long_us, self._now = dict(self._configured_us), None
        await self._head.restore()

    async def close(self) -> None:
        """As `StereoHead.close`."""
        await self._head.close()

    async def _be_long(self) -> None:
        if self._now != "long":
            await self._change_to("long")

    async def _change_to(self, which: Which) -> None:
        """Set the exposure of both cameras. Raises `CaptureError`; their exposure is unknown then."""
        self._now = None
        share = 1.0 if which == "long" else 1.0 / self._ratio
        left, right = (
            self._head.adjust(side, CameraValues(exposure_us=share * self._long_us[side])) for side in SIDES
        )
        try:
            made = await both(left, right, CHANGE_S)
        except TimeoutError:
            raise FrameTimeout("both", f"the exposure time was not changed within {CHANGE_S:g} s") from None
        self._made_us[which] = tuple(values.exposure_us or share for values in made)
        if self._settles:
            await self._head.capture()
        self._now = which

    def _ratio_of(self, side: Side) -> float:
        """Ratio of the exposures as set by the camera, which rounds them."""
        index = SIDES.index(side)
        return self._made_us["long"][index] / self._made_us["short"][index]

    async def _merged(self, side: Side, long: FramePair, short: FramePair) -> MergedExposures:
        images = long.side(side).image, short.side(side).image
        return await asyncio.to_thread(merge_exposures, *images, self._ratio_of(side))


def _problem(picture: MergedExposures, ratio: float, apart_ns: int) -> str:
    """Return why a merged picture must not be measured; "" if it may."""
    between = f"between its two exposures, {apart_ns * 1e-6:.0f} ms apart"
    if picture.moved_px > MOST_MOVED_PX:
        by = f"by about {picture.moved_px:.1f} px " if picture.moved_px < float("inf") else ""
        return f"something moved {by}{between}: the part must lie still"
    if abs(picture.ratio / ratio - 1.0) > MOST_FLICKER:  # False for NaN: not measurable in both exposures
        return f"the light changed {between}: long to short it is {picture.ratio:.1f}, not {ratio:.1f}"
    return ""


def _between(first: Frame, second: Frame, picture: MergedExposures) -> Frame:
    """Return the merged frame, dated midway between both exposures, with a bound that covers both."""
    apart_ns = second.exposed_ns - first.exposed_ns
    bounds = first.exposed_bound_ns, second.exposed_bound_ns
    known = [bound for bound in bounds if bound is not None]
    return Frame(
        second.camera,
        second.frame_id,
        picture.image,
        (first.device_ns + second.device_ns) // 2,
        first.exposed_ns + apart_ns // 2,
        max(known) + (abs(apart_ns) + 1) // 2 if len(known) == 2 else None,
        second.time_base,
    )
