"""Buffers that come out of a stream, as images: numbered, timed, whole, 8-bit grey, in their place."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edged.adapters.aravis.clock import host_ns
from edged.adapters.aravis.setup import Placement
from edged.domain import Image
from edged.vision.pixelformats import BY_CODE, grey8

PUMP_POLL_US = 20_000
"""How long a stopping pump may still wait; nothing else depends on it."""

BLOCK_IDS = 65_535
"""GigE Vision 1.x counts frames from 1 to 65535 and then from 1 again."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A buffer that came out of the stream.

    image : (H, W) uint8, or None with the `problem`. frame_id : counted on over restarts and over the
    wrap of 16-bit counters. arrived_ns : host time (`clock.host_ns`) of the first packet.
    """

    frame_id: int
    device_ns: int
    arrived_ns: int
    image: Image | None
    problem: str = ""


class FrameCounter:
    """Frame ids that only rise, from a camera's counter that wraps and starts again.

    A counter that stands still or falls a little gives the same or a smaller id: a repeated frame.
    """

    def __init__(self, first: int) -> None:
        self._base = self._highest = first
        self._last_raw = 0

    def restart(self) -> None:
        """The camera may count from 1 again, or may not: what comes next counts on from here."""
        self._last_raw = 0
        self._base = self._highest

    def count(self, raw: int) -> int:
        """The frame id for the camera's own number."""
        if self._last_raw == 0:
            self._base = self._highest + 1 - raw
        elif raw <= BLOCK_IDS and self._last_raw - raw > BLOCK_IDS // 2:
            self._base += BLOCK_IDS
        self._last_raw = raw
        frame_id = self._base + raw
        self._highest = max(self._highest, frame_id)
        return frame_id


def pump(
    aravis: Any,
    stream: Any,
    stop: threading.Event,
    counter: FrameCounter,
    placement: Placement | None,
    deliver: Callable[[Arrival], None],
) -> None:
    """Take buffers out of the stream until told to stop; each goes back at once, copied."""
    while not stop.is_set():
        buffer = stream.timeout_pop_buffer(PUMP_POLL_US)
        if buffer is None:
            continue
        try:
            arrival = _arrival(aravis, buffer, counter, placement)
        finally:
            stream.push_buffer(buffer)
        deliver(arrival)


def _arrival(aravis: Any, buffer: Any, counter: FrameCounter, placement: Placement | None) -> Arrival:
    frame_id = counter.count(buffer.get_frame_id())
    device_ns = buffer.get_timestamp()
    arrived_ns = host_ns() - (time.time_ns() - buffer.get_system_timestamp())

    def failed(problem: str) -> Arrival:
        return Arrival(frame_id, device_ns, arrived_ns, None, problem)

    status = buffer.get_status()
    if status != aravis.BufferStatus.SUCCESS:
        return failed(f"frame {frame_id} is incomplete: {status.value_nick.replace('-', ' ')}")
    if buffer.get_payload_type() != aravis.BufferPayloadType.IMAGE:
        return failed(f"frame {frame_id} carries {buffer.get_payload_type().value_nick}, not an image")
    pixels = BY_CODE.get(buffer.get_image_pixel_format())
    if pixels is None:
        return failed(f"frame {frame_id} has an unknown pixel format 0x{buffer.get_image_pixel_format():08x}")
    width, height = buffer.get_image_width(), buffer.get_image_height()
    data = np.frombuffer(buffer.get_data(), np.uint8)
    try:
        image = grey8(data, pixels, width, height)
    except ValueError as error:
        return failed(f"frame {frame_id}: {error}")
    if placement is not None:
        image = _placed(image, placement)
    return Arrival(frame_id, device_ns, arrived_ns, image)


def _placed(region: Image, placement: Placement) -> Image:
    """The region where it lies in the whole image; black around it."""
    height, width = region.shape
    image = np.zeros((placement.height, placement.width), np.uint8)
    image[placement.y : placement.y + height, placement.x : placement.x + width] = region
    return image
