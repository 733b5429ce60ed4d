"""One connection to one camera: set up, armed, triggered, taken down.

Everything here runs on the camera's control thread, except the pump, which is a thread of its own and
only takes buffers out of the stream (the one Aravis object that may be used from two threads).
"""

from __future__ import annotations

import contextlib
import gc
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from edged.adapters.aravis.clock import ClockMap, Latch, Reading, find_latch, host_ns, ptp_locked
from edged.adapters.aravis.features import Features, Value
from edged.adapters.aravis.library import (
    CONTROL_PRIVILEGE_REGISTER,
    CONTROLLED,
    connect,
    library,
    translated,
)
from edged.domain import Image
from edged.errors import CameraBusy, CameraSetupError, CameraUnreachable, FrameTimeout
from edged.vision.pixelformats import BY_CODE, FORMATS, grey8

log = logging.getLogger(__name__)

BUFFERS = 4
"""One that is filled, one that is late, one that is copied, one spare."""

PUMP_POLL_US = 20_000
"""How long a stopping pump may still wait; nothing else depends on it."""

HEARTBEAT_REGISTER = 0x0938
"""GigE Vision bootstrap register "heartbeat timeout", in ms."""

CLOCK_READINGS = 5
"""At the start; one more comes with every trigger. The quietest of them counts."""

REPEAT_S = 0.5
"""Aravis sends a command again when it has had no answer for so long (ARV_GV_DEVICE_GVCP_TIMEOUT_MS)."""

BLOCK_IDS = 65_535
"""GigE Vision 1.x counts frames from 1 to 65535 and then from 1 again."""


@dataclass(frozen=True, slots=True)
class AravisSettings:
    """How a camera is found and set.

    device : serial number or IP address.
    exposure_us, gain_db : None leaves what the camera has; a value switches the automatic off.
    packet_size : GVSP packet in bytes, IP and UDP headers included; None negotiates the largest that passes.
    features : GenICam nodes by name, written after the size and format of the image and before exposure and
        trigger. "TriggerSource" other than "Software" makes `trigger` wait for that source.
    user_socket : receive through an ordinary socket even where a packet socket is allowed.
    """

    device: str
    exposure_us: float | None = None
    gain_db: float | None = None
    packet_size: int | None = None
    features: Mapping[str, Value] = field(default_factory=dict)
    user_socket: bool = False

    @property
    def trigger_source(self) -> str:
        """The GenICam trigger source."""
        return str(self.features.get("TriggerSource", "Software"))


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


class Session:
    """An open, armed camera. Constructing it connects; `close` must be called even after a fault."""

    def __init__(
        self,
        name: str,
        settings: AravisSettings,
        deliver: Callable[[Arrival], None],
        lost: Callable[[], None],
        first_frame_id: int,
    ) -> None:
        """Connect, set up, start the stream. Raises `CaptureError`, and then nothing is left open.

        deliver, lost : called in other threads, for each buffer and when the camera drops the connection.
        first_frame_id : frames are counted from here + 1.
        """
        self.name = name
        self.settings = settings
        self.lost = threading.Event()
        self.clock = ClockMap()
        self.ptp = False
        self._latch: Latch | None = None
        self._features: Features | None = None
        self._library = library(name)
        self._on_lost = lost
        self._deliver = deliver
        self._handler = 0
        self._heartbeat_ms = 0
        self._stream: Any = None
        self._pump: threading.Thread | None = None
        self._stop_pump = threading.Event()
        self._counter = FrameCounter(first_frame_id)
        self._camera: Any = connect(name, settings.device)
        try:
            with self._talking("setting up"):
                self._set_up()
        except BaseException:
            self.close()
            raise

    # --- used on the control thread ----------------------------------------------------------

    @property
    def by_software(self) -> bool:
        """Whether `trigger` makes the exposure, or something else does."""
        return self.settings.trigger_source == "Software"

    def trigger(self) -> int:
        """Start an exposure; host time at which the command left.

        Aravis repeats a command that is not answered; when the exposure began is then anybody's guess, and
        that is a `FrameTimeout`. For a trigger source other than software there is no command to send.
        """
        sent_ns = host_ns()
        if self.by_software:
            with self._talking("software trigger"):
                self._camera.software_trigger()
            took_s = (host_ns() - sent_ns) * 1e-9
            if took_s >= REPEAT_S:
                raise FrameTimeout(self.name, f"the trigger command was answered only after {took_s:.2f} s")
        self._read_clock()
        return sent_ns

    def _read_clock(self) -> None:
        if self._latch is None:
            return
        jumps = self.clock.jumps
        with self._talking("reading its clock"):
            self.clock.add(self._latch.read(self._camera.get_device()))
        if self.clock.jumps > jumps:
            log.warning("camera %s: its clock has jumped", self.name)

    def note_exposure(self, sent_ns: int, arrival: Arrival) -> None:
        """Without a clock that can be read: the exposure lay between its command and its arrival."""
        if self._latch is None and arrival.device_ns > 0:
            self.clock.add(Reading(sent_ns, arrival.arrived_ns, arrival.device_ns))

    def restart(self) -> None:
        """Stop and start acquisition: an exposure that is still under way is given up."""
        with self._talking("restarting acquisition"):
            self._camera.stop_acquisition()
            self._counter.restart()
            self._camera.start_acquisition()

    def probe(self) -> None:
        """Ask whether the camera is there and still ours. Raises `CameraUnreachable` or `CameraBusy`.

        A write tells whether another host has taken control (it is denied then); but a camera that was
        restarted belongs to nobody, and may take writes from anybody: hence the read.
        """
        if not self._camera.is_gv_device():
            self._look_at_clock()
            return  # USB tells by itself when it is unplugged
        device = self._camera.get_device()
        with self._talking("looking whether it is alive"):
            device.write_register(HEARTBEAT_REGISTER, self._heartbeat_ms)
            privilege = device.read_register(CONTROL_PRIVILEGE_REGISTER)
            if privilege & CONTROLLED == 0:
                raise CameraUnreachable(self.name, "it has been restarted, or gave up the connection")
        self._look_at_clock()

    def _look_at_clock(self) -> None:
        self._read_clock()
        if self._features is not None:
            with self._talking("reading its PTP state"):
                self.ptp = ptp_locked(self._camera.get_device(), self._features)

    def close(self) -> None:
        """Take everything down, politely if the camera still answers; never raises."""
        self._stop_pump.set()
        if self._pump is not None:
            self._pump.join()
            self._pump = None
        camera, self._camera = self._camera, None
        if camera is None:
            return
        if self._handler:
            camera.get_device().disconnect(self._handler)
        if self._stream is not None and not self.lost.is_set():
            with contextlib.suppress(self._library.glib.Error):  # it may be gone, that is why we close
                camera.stop_acquisition()
        self._stream = None
        # the last reference gives up control and ends Aravis' own threads; cycles would keep them
        del camera
        gc.collect()

    @contextlib.contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        """Translate errors; after one that means "gone" the camera is not talked to again."""
        try:
            with translated(self.name, doing):
                yield
        except CameraUnreachable:
            self.lost.set()
            raise

    # --- setting up --------------------------------------------------------------------------

    def _set_up(self) -> None:
        camera, settings = self._camera, self.settings
        device = camera.get_device()
        if camera.is_gv_device() and not device.is_controller():
            raise CameraBusy(self.name, f"{settings.device} is controlled by another host or program")
        if camera.is_gv_device():
            self._heartbeat_ms = device.read_register(HEARTBEAT_REGISTER)
        self._handler = device.connect("control-lost", self._control_lost)
        with contextlib.suppress(self._library.glib.Error):
            camera.stop_acquisition()  # a host that crashed may have left it running
        features = Features(self.name, device)
        features.require(self._ordinary_features(features))
        features.require(self._exposure_features(features))
        self._arm(features)
        self._features = features
        self._latch = find_latch(device, features, gige=camera.is_gv_device())
        for _ in range(CLOCK_READINGS):
            self._look_at_clock()
        self._start_stream()

    def _ordinary_features(self, features: Features) -> dict[str, Value]:
        """The image format and what the user wants; the trigger is ours."""
        ours = ("TriggerMode", "TriggerSource", "TriggerSelector", "AcquisitionMode")
        values: dict[str, Value] = {"PixelFormat": "Mono8"}
        values.update({name: value for name, value in self.settings.features.items() if name not in ours})
        if values["PixelFormat"] not in FORMATS:
            raise CameraSetupError(
                self.name,
                f"PixelFormat: {values['PixelFormat']!r} is not understood, only {', '.join(FORMATS)}",
            )
        if self.settings.packet_size is not None:
            if not self._camera.is_gv_device():
                raise CameraSetupError(self.name, "packet_size: only GigE Vision has packets")
            # Aravis adds the second name, on the standard's register, for cameras without the first
            name = features.first("GevSCPSPacketSize", "ArvGevSCPSPacketSize")
            values[name] = self.settings.packet_size
        return values

    def _exposure_features(self, features: Features) -> dict[str, Value]:
        """Exposure and gain under the names that this camera has for them."""
        values: dict[str, Value] = {}
        if self.settings.exposure_us is not None:
            name = features.first("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
            if not name:
                raise CameraSetupError(self.name, "exposure_us: the camera has no ExposureTime")
            if features.exists("ExposureAuto"):
                values["ExposureAuto"] = "Off"
            raw = name == "ExposureTimeRaw"
            values[name] = round(self.settings.exposure_us) if raw else self.settings.exposure_us
        if self.settings.gain_db is not None:
            name = features.first("Gain", "GainAbs")
            if not name:
                raise CameraSetupError(
                    self.name, "gain_db: the camera has no Gain in dB; set its own GainRaw under features"
                )
            if features.exists("GainAuto"):
                values["GainAuto"] = "Off"
            values[name] = self.settings.gain_db
        return values

    def _arm(self, features: Features) -> None:
        """Every trigger but the start of a frame off, that one on and then given its source.

        Mode before source: some firmware forgets a source that is set while the mode is off.
        """
        device, source = self._camera.get_device(), self.settings.trigger_source
        features.require({"AcquisitionMode": "Continuous"})
        if features.exists("TriggerSelector"):
            selectors = device.dup_available_enumeration_feature_values_as_strings("TriggerSelector")
            for selector in selectors:
                features.require({"TriggerSelector": selector})
                if features.exists("TriggerMode"):
                    features.require({"TriggerMode": "Off"})
            if "FrameStart" not in selectors:
                raise CameraSetupError(self.name, f"no FrameStart trigger, only {', '.join(selectors)}")
            features.require({"TriggerSelector": "FrameStart"})
        features.require({"TriggerMode": "On"})
        features.require({"TriggerSource": source})
        features.require({"TriggerMode": "On"})  # and some switch the mode off when the source changes

    def _start_stream(self) -> None:
        """Packet size first: a stream made before it scrambles its buffers."""
        aravis, camera, settings = self._library.aravis, self._camera, self.settings
        if camera.is_gv_device():
            if settings.packet_size is None:
                camera.gv_auto_packet_size()
            camera.gv_set_packet_size_adjustment(aravis.GvPacketSizeAdjustment.NEVER)
            if settings.user_socket:
                camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        payload = camera.get_payload()
        self._stream = camera.create_stream(None, None)
        if camera.is_gv_device():
            # as large as the kernel allows, up to one frame: the default loses most of a burst
            self._stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.AUTO)
        for _ in range(BUFFERS):
            self._stream.push_buffer(aravis.Buffer.new_allocate(payload))
        self._pump = threading.Thread(
            target=_pump,
            args=(self._library, self._stream, self._stop_pump, self._counter, self._deliver),
            name=f"pump {self.name}",
            daemon=True,
        )
        self._pump.start()
        camera.start_acquisition()

    def _control_lost(self, _device: Any) -> None:
        """Called in Aravis' heartbeat thread."""
        self.lost.set()
        self._on_lost()


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


def _pump(
    libraries: Any,
    stream: Any,
    stop: threading.Event,
    counter: FrameCounter,
    deliver: Callable[[Arrival], None],
) -> None:
    """Take buffers out of the stream until told to stop; each goes back at once, copied."""
    while not stop.is_set():
        buffer = stream.timeout_pop_buffer(PUMP_POLL_US)
        if buffer is None:
            continue
        try:
            arrival = _arrival(libraries.aravis, buffer, counter)
        finally:
            stream.push_buffer(buffer)
        deliver(arrival)


def _arrival(aravis: Any, buffer: Any, counter: FrameCounter) -> Arrival:
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
    return Arrival(frame_id, device_ns, arrived_ns, image)
