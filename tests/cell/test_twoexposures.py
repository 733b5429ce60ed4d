"""Two exposures per cycle: with the right values, merged, and a fault if they differ."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from edged.cell.stereohead import HeadSettings, StereoHead
from edged.cell.twoexposures import TwoExposureHead
from edged.domain.arrays import SIDES, Image
from edged.domain.exposure import CameraValues
from edged.errors import CaptureError, ExposuresDiffer, FrameTimeout
from edged.sim.exposure import ExposureRequest
from edged.sim.inprocess import InProcessCamera

LONG_US, RATIO = 4000.0, 8.0
GLINT = 4.0
"""Radiance of the glint, relative to what saturates the long exposure."""


class Metal:
    """A grey part with a glint, on a dark table. moved_px : between two exposures."""

    def __init__(self) -> None:
        self.exposures: list[float] = []
        self.times: list[int] = []
        self.moved_px = 0.0
        self.flicker = 1.0
        self._random = np.random.default_rng(1)

    def __call__(self, request: ExposureRequest) -> Image:
        self.exposures.append(request.exposure_us)
        self.times.append(request.exposed_ns)
        y, x = np.mgrid[: request.height, : request.width].astype(float)
        at_x = 60 + (self.moved_px if len(self.exposures) > 2 else 0.0)
        light = 0.1 + 0.4 * (np.hypot(x - at_x, y - 60) < 40) + GLINT * (np.hypot(x - at_x, y - 60) < 12)
        lamp = self.flicker if len(self.exposures) > 2 else 1.0
        grey = 255 * light * lamp * request.exposure_us / LONG_US + self._random.normal(0, 1, light.shape)
        return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def heads(metal: Metal, **options: Any) -> tuple[TwoExposureHead, tuple[InProcessCamera, InProcessCamera]]:
    """A head that exposes twice, and its cameras."""
    left, right = (InProcessCamera(side, metal, width=128, height=128, exposure_us=LONG_US) for side in SIDES)
    settings = HeadSettings(timeout_s=5.0, max_skew_s=1.0)
    long_us = dict.fromkeys(SIDES, LONG_US)
    return (
        TwoExposureHead(StereoHead(left, right, settings), long_us, RATIO, **{"settles": False, **options}),
        (left, right),
    )


@asynccontextmanager
async def closing(head: TwoExposureHead) -> AsyncIterator[None]:
    """A head that is closed afterwards."""
    try:
        yield
    finally:
        await head.close()


async def test_each_cycle_has_a_long_and_a_short_exposure_and_changes_once() -> None:
    """Each cycle starts with the exposure of the previous one, and every pair shows both glint and table."""
    metal = Metal()
    head, _ = heads(metal)
    pairs = await _captured(head, 3)

    long, short = LONG_US, LONG_US / RATIO
    assert [long] * 2 + [short] * 4 + [long] * 4 + [short] * 2 == metal.exposures
    for pair in pairs:
        image = pair.left.image
        assert 254 > image[60, 60] > 130  # the glint is not white
        assert 5 < image[2, 2] < 30


async def _captured(head: TwoExposureHead, count: int) -> list[Any]:
    return [await head.capture() for _ in range(count)]


async def test_a_camera_that_takes_values_late_has_an_exposure_between_that_is_thrown_away() -> None:
    """With `settles`, one exposure after each change is discarded."""
    metal = Metal()
    head, _ = heads(metal, settles=True)
    await _captured(head, 1)

    assert [LONG_US] * 4 + [LONG_US / RATIO] * 4 == metal.exposures


async def test_the_time_of_a_pair_is_between_both_exposures_and_its_bound_reaches_to_each() -> None:
    """The pair's time lies between both exposures; it has no bound if the cameras know none."""
    metal = Metal()
    head, _ = heads(metal)
    (pair,) = await _captured(head, 1)

    assert max(metal.times[:2]) < pair.exposed_ns < min(metal.times[2:])
    assert head.taken is not None
    assert (LONG_US, LONG_US / RATIO) == (head.taken.long_us, head.taken.short_us)
    assert pair.left.exposed_bound_ns is None  # these cameras do not know their own


@pytest.mark.parametrize("moved_px", [3.0, 30.0])
async def test_a_part_that_moves_between_the_two_is_a_fault(moved_px: float) -> None:
    """Motion between the two exposures is a fault with code 113."""
    metal = Metal()
    metal.moved_px = moved_px
    head, _ = heads(metal)
    with pytest.raises(ExposuresDiffer, match=r"both cameras: something moved .*two exposures") as raised:
        await _captured(head, 1)
    assert 113 == raised.value.code


async def test_light_that_changes_between_the_two_is_a_fault_beyond_flicker() -> None:
    """A change by a tenth is accepted, one of 40 % is a fault."""
    metal = Metal()
    metal.flicker = 0.9
    head, _ = heads(metal)
    await _captured(head, 1)
    metal.exposures.clear()
    metal.flicker = 0.6
    with pytest.raises(ExposuresDiffer, match="the light changed"):
        await _captured(head, 1)


async def test_what_a_person_sets_is_the_long_exposure() -> None:
    """An adjusted value is the long exposure, the short one follows, and `restore` resets both."""
    metal = Metal()
    head, _ = heads(metal)
    async with closing(head):
        await head.capture()
        made = await head.adjust("left", CameraValues())
        assert LONG_US == made.exposure_us
        await head.adjust("left", CameraValues(exposure_us=2 * LONG_US))
        metal.exposures.clear()
        await head.capture()
        assert {2 * LONG_US, LONG_US, 2 * LONG_US / RATIO, LONG_US / RATIO} == set(metal.exposures)
        await head.restore()
        metal.exposures.clear()
        await head.capture()
        assert {LONG_US, LONG_US / RATIO} == set(metal.exposures)


async def test_after_a_fault_the_exposures_are_right_again() -> None:
    """After a camera fault between both exposures, the next pair is complete."""
    metal = Metal()
    head, (left, _) = heads(metal)
    async with closing(head):
        await head.capture()
        left.faults.incomplete_next = 1
        with pytest.raises(CaptureError):
            await head.capture()
        metal.exposures.clear()
        pair = await head.capture()
        assert {LONG_US, LONG_US / RATIO} == set(metal.exposures)
        assert 254 > pair.left.image[60, 60] > 130


async def test_nobody_else_can_trigger_two_exposures() -> None:
    """Listening to external triggers is refused."""
    head, _ = heads(Metal())
    with pytest.raises(FrameTimeout, match="others' triggers"):
        await head.listen()
