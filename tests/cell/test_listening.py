"""The stereo head with cameras that expose by themselves: frames are paired by time, and none is lost."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from edged.cell.stereohead import REOPEN_AFTER, HeadSettings, StereoHead
from edged.domain.frames import Frame, FramePair, TimeBase
from edged.errors import CaptureError, FrameIncomplete, FrameTimeout, FrameUnpaired


class Streaming:
    """A camera that delivers the test's frames; unfetched ones wait."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.frames: asyncio.Queue[Frame | CaptureError] = asyncio.Queue()
        self.number = 0
        self.opened = 0

    async def open(self) -> None:
        self.opened += 1

    async def trigger(self) -> None:
        pass

    async def frame(self) -> Frame:
        frame = await self.frames.get()
        if isinstance(frame, CaptureError):
            raise frame
        return frame

    async def close(self) -> None:
        pass

    def expose(self, at_ms: float, *, skip: int = 0) -> None:
        """Deliver a frame exposed at this time; skip : number of frames lost before it."""
        self.number += 1 + skip
        image = np.full((2, 2), self.number % 200, np.uint8)
        image[0, 0] = 255
        at_ns = 10**18 + round(at_ms * 1e6)
        self.frames.put_nowait(
            Frame(self.name, self.number, image, round(at_ms * 1e6), at_ns, 100_000, TimeBase.CAMERA)
        )

    def damage(self) -> None:
        """Deliver an incomplete frame."""
        self.number += 1
        self.frames.put_nowait(FrameIncomplete(self.name, "packets missing"))


@asynccontextmanager
async def streaming(**options: Any) -> AsyncIterator[tuple[StereoHead, Streaming, Streaming]]:
    """A head with two such cameras; no task may survive."""
    left, right = Streaming("left"), Streaming("right")
    head = StereoHead(left, right, HeadSettings(**{"timeout_s": 0.1, "max_skew_s": 0.005, **options}))
    before = asyncio.all_tasks()
    try:
        yield head, left, right
    finally:
        await head.close()
        assert before == asyncio.all_tasks(), "a task was left behind"


def numbers(pair: FramePair) -> tuple[int, int]:
    """Frame ids of left and right."""
    return pair.left.frame_id, pair.right.frame_id


async def test_free_running_cameras_are_paired_by_time() -> None:
    """Older frames are dropped until two match, and frames that never match are a fault."""
    async with streaming(free_running=True) as (head, left, right):
        for at_ms in (0, 50, 100):
            left.expose(at_ms)
        for at_ms in (98, 148):
            right.expose(at_ms)
        assert (3, 1) == numbers(await head.capture())
        left.expose(200)
        with pytest.raises(FrameUnpaired, match="no two frames match within"):
            await head.capture()


async def test_exposures_that_others_trigger_are_heard_in_order() -> None:
    """Pairs come in order, however late one image is."""
    async with streaming() as (head, left, right):
        left.expose(0)
        left.expose(50)
        right.expose(1)
        asyncio.get_running_loop().call_later(0.02, right.expose, 51)
        assert [(1, 1), (2, 2)] == [numbers(await head.listen()) for _ in range(2)]


async def test_an_exposure_that_one_camera_missed_is_a_fault_and_the_next_is_a_pair() -> None:
    """A missing partner is a fault, and the next exposure is a pair again."""
    async with streaming() as (head, left, right):
        left.expose(0)
        with pytest.raises(FrameUnpaired, match=r"right: no partner for frame 1 of left within 0\.1 s"):
            await head.listen()
        left.expose(100)
        left.expose(200)
        right.expose(201)
        with pytest.raises(
            FrameUnpaired, match=r"right: no partner for frame 2 of left: exposures 101\.00 ms"
        ):
            await head.listen()
        pair = await head.listen()
        assert (3, 1) == numbers(pair)


async def test_a_damaged_image_takes_its_partner_with_it() -> None:
    """A damaged frame is the fault, its partner is dropped, and the next exposure is a pair."""
    async with streaming() as (head, left, right):
        left.expose(0)
        right.damage()
        with pytest.raises(FrameIncomplete, match="right"):
            await head.listen()
        left.expose(100)
        right.expose(100)
        assert (2, 2) == numbers(await head.listen())


async def test_listening_can_be_interrupted_without_losing_a_frame() -> None:
    """If listening is cancelled after one image, the next call returns both."""
    async with streaming(timeout_s=5.0) as (head, left, right):
        await head.open()
        left.expose(0)
        listening = asyncio.create_task(head.listen())
        await asyncio.sleep(0.01)
        listening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await listening
        right.expose(0)
        assert (1, 1) == numbers(await head.listen())


async def test_a_silent_camera_shows_to_a_listener_that_looks_up_before_its_time_is_over() -> None:
    """A missing partner is a fault even if listening is repeatedly interrupted before its time-out."""
    async with streaming() as (head, left, right):
        left.expose(0)
        for _ in range(1000):
            listening = asyncio.create_task(head.listen())
            await asyncio.wait({listening}, timeout=0.02)
            if listening.done():
                break
            listening.cancel()
            await asyncio.wait({listening})
        with pytest.raises(FrameUnpaired, match="camera right: no partner for frame 1 of left"):
            listening.result()
        left.expose(50)
        right.expose(50)
        assert (2, 1) == numbers(await head.listen())


async def test_exposures_that_nobody_had_time_for_are_counted() -> None:
    """Frame numbers skipped by both cameras are counted as missed exposures."""
    async with streaming() as (head, left, right):
        missed = []
        for at_ms, skip in ((0, 0), (100, 0), (400, 2)):
            left.expose(at_ms, skip=skip)
            right.expose(at_ms, skip=skip)
            missed.append((await head.listen()).missed)
        assert [0, 0, 2] == missed


async def test_a_camera_that_gives_up_waiting_is_listened_to_again() -> None:
    """A camera's own time-out while waiting for a trigger is no fault."""
    async with streaming(timeout_s=5.0) as (head, left, right):
        left.frames.put_nowait(FrameTimeout("left", "no image within 10 s"))
        listening = asyncio.create_task(head.listen())
        await asyncio.sleep(0.15)
        left.expose(0)
        right.expose(0)
        assert (1, 1) == numbers(await listening)


async def test_a_command_while_listening_takes_over_the_cameras() -> None:
    """After listening is cancelled, the next frame belongs to the command."""
    async with streaming(timeout_s=5.0) as (head, left, right):
        listening = asyncio.create_task(head.listen())
        await asyncio.sleep(0.01)
        listening.cancel()
        await asyncio.wait({listening})
        commanded = asyncio.create_task(head.capture())
        await asyncio.sleep(0.01)
        left.expose(0)
        right.expose(0)
        assert (1, 1) == numbers(await commanded)


async def test_no_trigger_is_no_fault_of_the_cameras() -> None:
    """A capture without a trigger times out each time, and no camera is reopened."""
    async with streaming(by_others=True, timeout_s=0.02) as (head, left, right):
        for _ in range(2 * REOPEN_AFTER):
            with pytest.raises(FrameTimeout, match=r"both cameras: no trigger came within 0\.02 s") as caught:
                await head.capture()
            assert FrameTimeout is type(caught.value)
        assert (1, 1) == (left.opened, right.opened)
