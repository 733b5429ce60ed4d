"""Faults of cameras in a factory, each over real UDP with the real Aravis.

Every fault is noticed within the time that docs/how-to/cameras.md states, has its own code, publishes only
whole, new pairs, and is over without a restart once its cause is gone.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from helpers.gigecell import LEFT, RIGHT, Cell, Sensor, closing, gige_camera, running
from helpers.needs import needs_aravis

from edged.adapters.aravis import AravisCamera, AravisSettings
from edged.cell.stereohead import REOPEN_AFTER, HeadSettings, StereoHead
from edged.errors import (
    CameraBusy,
    CameraRestarted,
    CameraUnreachable,
    CaptureError,
    FrameFrozen,
    FrameIncomplete,
    FrameRepeated,
    FrameTimeout,
    StreamStalled,
    WrongCamera,
)
from edged.sim.gige.camera import GigeCamera

pytestmark = needs_aravis()

TIMEOUT_S = 1.0
ELSEWHERE = "127.0.40.7"
LOADED_S = 15.0
"""Added to every stated time, because the test machine may be busy."""


class Line:
    """A cell with both cameras, and a head that runs without pause and keeps its pairs and faults."""

    def __init__(self, cell: Cell, **settings: Any) -> None:
        self.cell = cell
        left = AravisSettings(settings.pop("device", LEFT), **settings)
        self.head = StereoHead(
            AravisCamera("left", left),
            AravisCamera("right", AravisSettings(RIGHT)),
            HeadSettings(timeout_s=TIMEOUT_S, max_skew_s=0.8, max_backoff_s=0.2),
        )
        self.faults: list[CaptureError] = []

    async def shoot(self) -> CaptureError | None:
        """One exposure: a fault, or a complete new pair of one exposure."""
        try:
            pair = await asyncio.wait_for(self.head.capture(), 2 * TIMEOUT_S + LOADED_S)
        except CaptureError as error:
            self.faults.append(error)
            await asyncio.sleep(0.02)
            return error
        left, right = self.cell.left_sensor, self.cell.right_sensor
        left.saw(pair.left.image)
        right.saw(pair.right.image)
        assert pair.left.device_ns == left.requests[-1].device_ns
        assert pair.right.device_ns == right.requests[-1].device_ns
        return None

    async def until(self, wanted: type[CaptureError] | None, within_s: float) -> float:
        """Shoot until this fault, or a good pair; returns the seconds it took."""
        began_s = time.monotonic()
        while True:
            error = await self.shoot()
            if (error is None) if wanted is None else (type(error) is wanted):
                return time.monotonic() - began_s
            told = [f"{type(fault).__name__}: {fault}" for fault in self.faults[-5:]]
            assert time.monotonic() < began_s + within_s + LOADED_S, told

    async def good(self) -> None:
        """Check that a good pair comes."""
        await self.until(None, 5)


@asynccontextmanager
async def working(cell: Cell, **settings: Any) -> AsyncIterator[Line]:
    """A line whose cameras work before and after the test."""
    line = Line(cell, **settings)
    async with closing(line.head):
        await line.good()
        line.faults.clear()
        yield line
        await line.good()


@pytest.fixture
def cell() -> Iterator[Cell]:
    """A running cell."""
    with running(Cell()) as cell:
        yield cell
        cell.left.stop()  # the one that a test has put there


def switched_on_again(cell: Cell, *, address: str = LEFT, serial: str = "EDGED-T1") -> GigeCamera:
    """The left camera after its power came back, with no controller."""
    cell.left_sensor = Sensor(3)
    cell.left = gige_camera(address, serial, cell.left_sensor)
    return cell.left


@pytest.mark.slow
async def test_packets_that_are_lost_for_good_are_a_fault_and_never_a_picture(cell: Cell) -> None:
    """With a tenth of the packets lost and no resend a frame is incomplete (105), and pictures are good
    again afterwards."""
    async with working(cell, resend=False, packet_size=1500) as line:
        cell.left.faults.packet_loss = 0.1
        await line.until(FrameIncomplete, TIMEOUT_S)
        for _ in range(4):
            await line.shoot()
        cell.left.faults.packet_loss = 0.0
    assert {"left"} == {fault.camera for fault in line.faults}
    # of a frame without its first packet nothing is known but that it did not come
    assert {type(fault) for fault in line.faults} <= {FrameIncomplete, FrameTimeout, StreamStalled}


@pytest.mark.slow
async def test_packets_that_are_lost_and_sent_again_are_no_fault(cell: Cell) -> None:
    """With resend, every picture is complete although packets are lost."""
    async with working(cell, packet_size=1500) as line:
        cell.left.faults.packet_loss = cell.right.faults.packet_loss = 0.005
        for _ in range(8):
            await line.shoot()
        cell.left.faults.packet_loss = cell.right.faults.packet_loss = 0.0
    assert [] == line.faults


@pytest.mark.long
async def test_a_stream_that_stalls_is_told_from_a_dead_camera(cell: Cell) -> None:
    """If triggers are taken but nothing comes, the fault is 104, then 112 with the third, and heals."""
    async with working(cell) as line:
        cell.left.faults.stalled = True
        await line.until(FrameTimeout, TIMEOUT_S)
        await line.until(StreamStalled, REOPEN_AFTER * TIMEOUT_S)
        cell.left.faults.stalled = False
    assert ["left"] * len(line.faults) == [fault.camera for fault in line.faults]


@pytest.mark.slow
async def test_a_frozen_image_is_caught_with_the_image(cell: Cell) -> None:
    """New frame numbers with the same pixels are fault 110 as long as it lasts."""
    async with working(cell) as line:
        cell.right.faults.frozen = True
        for _ in range(2):
            assert FrameFrozen is type(await line.shoot())
        cell.right.faults.frozen = False
    assert {"right"} == {fault.camera for fault in line.faults}


@pytest.mark.slow
async def test_a_pulled_cable_is_noticed_with_the_next_command_and_heals(cell: Cell) -> None:
    """A pulled cable is fault 101 within the 1.2 s of a command, and heals."""
    async with working(cell) as line:
        cell.left.faults.unplugged = True
        await line.until(CameraUnreachable, 1.2 + TIMEOUT_S)
        cell.left.faults.unplugged = False
    assert {"left"} == {fault.camera for fault in line.faults}


@pytest.mark.slow
async def test_a_camera_that_was_switched_off_and_on_is_taken_again(cell: Cell) -> None:
    """A camera that was switched off and on is opened again, and is not reported as busy."""
    async with working(cell) as line:
        cell.left.stop()
        switched_on_again(cell).start()
        await line.until(CameraRestarted, 1.2 + TIMEOUT_S)
    assert CameraBusy not in {type(fault) for fault in line.faults}


@pytest.mark.slow
async def test_a_camera_that_another_host_took_is_busy_until_it_gives_it_back(cell: Cell) -> None:
    """A camera that another host controls is fault 102 while it lasts, and heals."""
    async with working(cell) as line:
        cell.left.steal_control()
        await line.until(CameraBusy, TIMEOUT_S)
        line.faults.clear()
        for _ in range(5):
            await line.shoot()
        assert {CameraBusy} == {type(fault) for fault in line.faults}
        cell.left.release_control()


@pytest.mark.slow
async def test_a_frame_number_that_stands_still_is_no_new_picture(cell: Cell) -> None:
    """A new picture with an old number is fault 109 if it is delivered, or 104 if the driver drops it.

    Acquisition begins anew then, and the camera counts anew: the next picture has a number of its own.
    """
    async with working(cell) as line:
        cell.right.faults.repeat_id = True
        told = [await line.shoot() for _ in range(4)]
        assert told[0] is not None
        cell.right.faults.repeat_id = False
    assert {"right"} == {fault.camera for fault in line.faults}
    assert {type(fault) for fault in line.faults} <= {FrameRepeated, FrameTimeout, StreamStalled}


@pytest.mark.slow
async def test_packets_that_come_twice_or_in_another_order_are_no_fault(cell: Cell) -> None:
    """With reordered and repeated packets every picture is complete."""
    async with working(cell, packet_size=1500) as line:
        cell.left.faults.reordering = cell.right.faults.duplication = 0.1
        for _ in range(6):
            await line.shoot()
        cell.left.faults.reordering = cell.right.faults.duplication = 0.0
    assert [] == line.faults


@pytest.mark.long
async def test_a_camera_whose_address_changed_is_found_by_its_serial_number(cell: Cell) -> None:
    """A camera with a new address is fault 101, and is then found there by its serial number."""
    async with working(cell, device="EDGED-T1") as line:
        cell.left.stop()
        switched_on_again(cell, address=ELSEWHERE).start()
        await line.until(CameraUnreachable, 1.2)


@pytest.mark.slow
async def test_cameras_that_were_swapped_are_refused_until_they_are_back(cell: Cell) -> None:
    """Another serial number at the left camera's address is fault 108 until the cameras are back."""
    async with working(cell, serial="EDGED-T1") as line:
        cell.left.stop()
        with switched_on_again(cell, serial="EDGED-T9"):
            await line.until(WrongCamera, 1.2 + TIMEOUT_S)
            line.faults.clear()
            for _ in range(3):
                await line.shoot()
            assert {WrongCamera} == {type(fault) for fault in line.faults}
        switched_on_again(cell).start()
