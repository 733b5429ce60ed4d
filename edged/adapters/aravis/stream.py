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
from edged.domain.arrays import Image
from edged.vision.kernels.pixelformats import BY_CODE, grey8

PUMP_POLL_US = 20_000
"""How long a stopping pump may still wait; nothing else depends on it."""

EXPOSURE_TOLERANCE, EXPOSURE_STEP_US = 0.01, 40.0
"""A camera rounds an exposure to its own steps: some of its lines."""

BLOCK_IDS = 65_535
"""GigE Vision 1.x counts frames from 1 to 65535 and then from 1 again; some cameras from 0 to 65535 and from
0."""

RESTARTED_BY = 100
"""A number that falls by more has begun anew. Aravis drops what falls by less, as late
(ARV_GV_STREAM_DISCARD_LATE_FRAME_THRESHOLD)."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A buffer that came out of the stream.

    image : (H, W) uint8, or None with the `problem`. frame_id : counted on over restarts and over the
    wrap of 16-bit counters. arrived_ns : host time (`clock.host_ns`) of the first packet.
    count : of the encoder at the exposure, where it is sent along.
    """

    frame_id: int
    device_ns: int
    arrived_ns: int
    image: Image | None
    problem: str = ""
    count: int | None = None


class FrameCounter:
    """Frame ids that only rise, from a camera's counter that wraps and starts again.

    A counter that stands still or falls a little gives the same or a smaller id: a repeated frame.
    """

    def __init__(self, first: int) -> None:
        self._base = self._highest = first
        self._last_raw: int | None = None

    def restart(self) -> None:
        """The camera may count from 1 again, or may not: what comes next counts on from here."""
        self._last_raw = None
        self._base = self._highest

    def count(self, raw: int) -> int:
        """The frame id for the camera's own number."""
        fallen = 0 if self._last_raw is None else self._last_raw - raw
        if raw <= BLOCK_IDS and fallen > BLOCK_IDS // 2:
            self._base += BLOCK_IDS + (raw == 0)
        elif self._last_raw is None or fallen > RESTARTED_BY:
            self._base = self._highest + 1 - raw
        self._last_raw = raw
        frame_id = self._base + raw
        self._highest = max(self._highest, frame_id)
        return frame_id


def pump(decoder: Decoder, stream: Any, stop: threading.Event, deliver: Callable[[Arrival], None]) -> None:
    """Copy buffers out of the stream until stopped; each goes back at once.

    Aravis' packet socket hears the whole network interface until its filter is set (`_ring_buffer_loop`,
    Aravis 0.8.26): a stranger's packet gives a buffer that was never filled, and no image of this camera.
    """
    while not stop.is_set():
        buffer = stream.timeout_pop_buffer(PUMP_POLL_US)
        if buffer is None:
            continue
        try:
            arrival = decoder.arrival(buffer) if decoder.was_filled(buffer) else None
        finally:
            stream.push_buffer(buffer)
        if arrival is not None:
            deliver(arrival)


class Decoder:
    """Makes arrivals of buffers.

    placement : where a region belongs. chunks : of a camera that sends something along.
    """

    def __init__(
        self, aravis: Any, counter: FrameCounter, placement: Placement | None, chunks: ChunkReader | None
    ) -> None:
        self._aravis, self._counter, self._placement, self._chunks = aravis, counter, placement, chunks
        self._extended = aravis.BufferPayloadType.EXTENDED_CHUNK_DATA

    def was_filled(self, buffer: Any) -> bool:
        """Whether any packet of an image went into a buffer."""
        return bool(buffer.get_status() != self._aravis.BufferStatus.CLEARED)

    def arrival(self, buffer: Any) -> Arrival:
        """The image in a buffer, or why it has none."""
        frame_id = self._counter.count(buffer.get_frame_id())
        device_ns = buffer.get_timestamp()
        arrived_ns = host_ns() - (time.time_ns() - buffer.get_system_timestamp())
        problem, image, count = self._problem(buffer), None, None
        if not problem:
            try:
                count = None if self._chunks is None else self._chunks.read(buffer)
                image = self._image(buffer)
            except ValueError as error:
                problem = str(error)
        if image is None:
            return Arrival(frame_id, device_ns, arrived_ns, None, f"frame {frame_id}: {problem}")
        if self._placement is not None:
            image = _placed(image, self._placement)
        return Arrival(frame_id, device_ns, arrived_ns, image, count=count)

    def _image(self, buffer: Any) -> Image:
        width, height = buffer.get_image_width(), buffer.get_image_height()
        pixels = BY_CODE[buffer.get_image_pixel_format()]
        data = np.frombuffer(buffer.get_data(), np.uint8)
        if buffer.has_chunks() or buffer.get_payload_type() == self._extended:
            data = data[: pixels.size(width * height)]  # what comes after the image is chunk data
        return grey8(data, pixels, width, height)

    def _problem(self, buffer: Any) -> str:
        status, kind = buffer.get_status(), buffer.get_payload_type()
        if status != self._aravis.BufferStatus.SUCCESS:
            return f"incomplete: {status.value_nick.replace('-', ' ')}"
        if kind not in (self._aravis.BufferPayloadType.IMAGE, self._extended):
            return f"it carries {kind.value_nick}, not an image"
        if buffer.get_image_pixel_format() not in BY_CODE:
            return f"unknown pixel format 0x{buffer.get_image_pixel_format():08x}"
        return ""


class ChunkReader:
    """Reads chunk data: how long an image was exposed, which is compared, and where an encoder stood.

    Firmware that shortens exposures without a word, or a forgotten automatic, gives pictures that look alike.
    parser : Aravis' parser of chunk data; error : what it raises. wanted_us : None takes any exposure; may
    change at any time. exposure : whether its time is there. count : name of the chunk with a count, or "".
    """

    def __init__(
        self, parser: Any, error: type[Exception], wanted_us: float | None, *, exposure: bool, count: str
    ) -> None:
        self._parser, self._error, self.wanted_us = parser, error, wanted_us
        self._exposure, self._count = exposure, count

    def read(self, buffer: Any) -> int | None:
        """The count, where it is wanted. Raises ValueError for data that are not there, a wrong exposure."""
        if not buffer.has_chunks():
            # of the extended chunk payload of GigE Vision 1.x Aravis 0.8 reads the image only
            settings = " and ".join(["chunks = true"] * self._exposure + ["count"] * bool(self._count))
            raise ValueError(f"no chunk data that could be read: leave out {settings} for this camera")
        try:
            if self._exposure:
                self._compare(float(self._parser.get_float_value(buffer, "ChunkExposureTime")))
            return int(self._parser.get_integer_value(buffer, f"Chunk{self._count}")) if self._count else None
        except self._error as error:
            raise ValueError(f"chunk data that are not whole: {error}") from error

    def _compare(self, exposed_us: float) -> None:
        wanted_us = self.wanted_us
        if wanted_us is None:
            return
        if abs(exposed_us - wanted_us) > EXPOSURE_TOLERANCE * wanted_us + EXPOSURE_STEP_US:
            raise ValueError(f"exposed for {exposed_us:g} us, not {wanted_us:g} us")


def _placed(region: Image, placement: Placement) -> Image:
    """The region where it lies in the whole image; black around it."""
    height, width = region.shape
    image = np.zeros((placement.height, placement.width), np.uint8)
    image[placement.y : placement.y + height, placement.x : placement.x + width] = region
    return image
