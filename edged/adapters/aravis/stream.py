"""Turning buffers of a stream into images: numbered, timed, checked, 8-bit grey, placed in the full image."""

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
"""How long a pump may take to notice that it must stop; nothing else depends on it."""

EXPOSURE_TOLERANCE, EXPOSURE_STEP_US = 0.01, 40.0
"""Allowed deviations of the exposure time: a camera rounds it to its own steps, some of its line times."""

BLOCK_IDS = 65_535
"""GigE Vision 1.x counts frames from 1 to 65535 and again from 1; some cameras from 0 to 65535."""

RESTARTED_BY = 100
"""A frame number that falls by more than this has restarted. Aravis drops frames that fall by less, as late
(ARV_GV_STREAM_DISCARD_LATE_FRAME_THRESHOLD)."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A buffer that came out of the stream.

    image : (H, W) uint8, or None with the `problem`. frame_id : continues over restarts and over the wrap of
    16-bit counters. arrived_ns : host time (`clock.host_ns`) of the first packet.
    count : of the encoder at the exposure, if it is sent with the image.
    """

    frame_id: int
    device_ns: int
    arrived_ns: int
    image: Image | None
    problem: str = ""
    count: int | None = None


class FrameCounter:
    """Derives rising frame ids from a camera's counter, which wraps and restarts.

    A counter that stays or falls a little gives the same or a smaller id: a repeated frame.
    """

    def __init__(self, first: int) -> None:
        self._base = self._highest = first
        self._last_raw: int | None = None

    def restart(self) -> None:
        """Continue from here with the next frame, whether or not the camera counts from 1 again."""
        self._last_raw = None
        self._base = self._highest

    def count(self, raw: int) -> int:
        """Frame id for the camera's own number."""
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
    """Copy images out of the stream until stopped; each buffer is returned at once.

    Aravis' packet socket receives from the whole network interface until its filter is set
    (`_ring_buffer_loop`, Aravis 0.8.26): a foreign packet yields a buffer that was never filled, which is
    ignored.
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
    """Turns buffers into arrivals.

    placement : place of a region in the full image. chunks : reader of chunk data; None: not expected.
    """

    def __init__(
        self, aravis: Any, counter: FrameCounter, placement: Placement | None, chunks: ChunkReader | None
    ) -> None:
        self._aravis, self._counter, self._placement, self._chunks = aravis, counter, placement, chunks
        self._extended = aravis.BufferPayloadType.EXTENDED_CHUNK_DATA

    def was_filled(self, buffer: Any) -> bool:
        """Whether a buffer received any packet of an image."""
        return bool(buffer.get_status() != self._aravis.BufferStatus.CLEARED)

    def arrival(self, buffer: Any) -> Arrival:
        """The image in a buffer, or the reason why there is none."""
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
            data = data[: pixels.size(width * height)]  # chunk data follow the image
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
    """Reads chunk data: the exposure time, which is compared with the setting, and the count of an encoder.

    Pictures do not show when firmware silently shortens exposures, or an automatic exposure was left on.
    parser : Aravis' parser of chunk data; error : the exception that it raises. wanted_us : None accepts any
    exposure; may change at any time. exposure : the exposure time is sent. count : name of the chunk with a
    count, or "".
    """

    def __init__(
        self, parser: Any, error: type[Exception], wanted_us: float | None, *, exposure: bool, count: str
    ) -> None:
        self._parser, self._error, self.wanted_us = parser, error, wanted_us
        self._exposure, self._count = exposure, count

    def read(self, buffer: Any) -> int | None:
        """Return the count, if there is one. Raises ValueError for missing data or a wrong exposure time."""
        if not buffer.has_chunks():
            # in the extended chunk payload of GigE Vision 1.x, Aravis 0.8 reads only the image
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
    """Put a region into its place in the full image, black around it."""
    height, width = region.shape
    image = np.zeros((placement.height, placement.width), np.uint8)
    image[placement.y : placement.y + height, placement.x : placement.x + width] = region
    return image
