"""One connection to one camera: set-up, arming, triggering, closing.

Everything here runs on the camera's control thread, except the pump, which has a thread of its own and only
takes buffers out of the stream (the one Aravis object that may be used from two threads).
"""

from __future__ import annotations

import contextlib
import gc
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from edged.adapters.aravis import exposure
from edged.adapters.aravis.clock import (
    CLOCK_DRIFT,
    ClockMap,
    ClockReading,
    Latch,
    find_latch,
    host_ns,
    ptp_locked,
)
from edged.adapters.aravis.features import Features, Value
from edged.adapters.aravis.lacks import MissingFeature, missing_features
from edged.adapters.aravis.library import (
    CONTROL_PRIVILEGE_REGISTER,
    CONTROLLED,
    DEVICE_ERROR_DOMAIN,
    PARSING,
    connect,
    library,
    translated,
)
from edged.adapters.aravis.names import TEMPERATURE
from edged.adapters.aravis.pacing import pace, share_usb
from edged.adapters.aravis.processing import gamma_in_effect, gamma_switch
from edged.adapters.aravis.settings import AravisSettings
from edged.adapters.aravis.setup import Placement, set_up
from edged.adapters.aravis.stream import Arrival, ChunkReader, Decoder, FrameCounter, pump
from edged.adapters.aravis.trigger import Action, Software, send_action, triggers_itself
from edged.domain.exposure import CameraLimits, CameraValues
from edged.errors import CameraBusy, CameraRestarted, CameraSetupError, CameraUnreachable, FrameTimeout
from edged.logs import LogLimit

log = logging.getLogger(__name__)

BUFFERS = 4
"""Buffers of a stream: one being filled, one late, one being copied, and a spare."""

HEARTBEAT_REGISTER = 0x0938
"""GigE Vision bootstrap register "heartbeat timeout", in ms."""

HEARTBEAT_MS = 3000
"""Least heartbeat timeout. Aravis sends a heartbeat each second (ARV_GV_DEVICE_HEARTBEAT_PERIOD_US); cameras
default to 0.5 to 3 s, and a shorter interruption should not lose the connection."""

CLOCK_READINGS = 5
"""Clock readings at the start, of which the narrowest counts; each trigger adds one."""

REPEAT_S = 0.5
"""Time after which Aravis repeats an unanswered command (ARV_GV_DEVICE_GVCP_TIMEOUT_MS)."""

LOOK_S = 5.0
"""Period at which temperature and PTP state are read while images are taken."""


COUNTS = ("n_completed_buffers", "n_failures", "n_resent_packets", "n_missing_packets")
"""Aravis' names of a stream's counters, in the order of `CameraHealth`."""


JUMPS_S = 3600.0  # between log lines about clock jumps; a clock that runs too fast "jumps" every second
RESTARTED = "it was restarted, or dropped the connection"


@dataclass(frozen=True, slots=True)
class CameraHealth:
    """Health of an open camera.

    temperature_c : None if unknown. clock_bound_ns : error bound of its clock's map, None without a clock.
    ptp : its clock is locked to the PTP network. complete, failed : images since it was opened.
    resent, lost : packets resent on request, and lost. None: not counted by the driver.
    gamma : exponent between light and grey value, as the camera states it; 1: linear. linear : the setting
    that makes it linear.
    lacks : features that it does not have. packet_delay_us : pause after each packet. packet_bytes : size of
    a packet. Both None where there are none. firmware : version, "" if unknown.
    """

    temperature_c: float | None = None
    clock_bound_ns: int | None = None
    ptp: bool = False
    complete: int | None = None
    failed: int | None = None
    resent: int | None = None
    lost: int | None = None
    gamma: float = 1.0
    linear: tuple[str, Value] = ("Gamma", 1.0)
    lacks: tuple[MissingFeature, ...] = ()
    packet_delay_us: float | None = None
    firmware: str = ""
    packet_bytes: int | None = None


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """Maker, model and firmware of a camera, and its features as its maker describes them."""

    vendor: str
    model: str
    firmware: str
    features: tuple[Mapping[str, Any], ...]


def firmware_of(features: Features) -> str:
    """Version of a camera's firmware; "" if unknown."""
    node = features.first("DeviceFirmwareVersion", "DeviceVersion")
    return str((features.value(node) if node else None) or "")


class CameraSession:
    """An open, armed camera. Constructing it connects; `close` must be called even after a fault."""

    def __init__(
        self,
        name: str,
        settings: AravisSettings,
        deliver: Callable[[Arrival], None],
        lost: Callable[[], None],
        first_frame_id: int,
    ) -> None:
        """Connect, set up, start the stream. Raises `CaptureError`; then nothing is left open.

        deliver, lost : called on other threads, for each buffer, and when control of the camera is lost.
        first_frame_id : frames are counted from first_frame_id + 1.
        """
        self.name = name
        self.settings = settings
        self.lost = threading.Event()
        self.clock = ClockMap()
        self.ptp = False
        self._jumps = LogLimit(__name__, JUMPS_S)
        self._latch: Latch | None = None
        self._features: Features | None = None
        self._actions = 0
        self._temperature_c: float | None = None
        self._gamma = 1.0
        self._linear: tuple[str, Value] = ("Gamma", 1.0)
        self._lacks: tuple[MissingFeature, ...] = ()
        self._packet_delay_us: float | None = None
        self.exposure_ns = 0
        self._packet_bytes: int | None = None
        self._firmware = ""
        self._looked_s = 0.0
        self._library = library(name)
        self._on_lost = lost
        self._deliver = deliver
        self._handler = 0
        self._heartbeat_ms = 0
        self._stream: Any = None
        self._chunks: ChunkReader | None = None
        self._placement: Placement | None = None
        self._pump: threading.Thread | None = None
        self._stop_pump = threading.Event()
        self._counter = FrameCounter(first_frame_id)
        self._camera: Any = connect(name, settings.device, settings.serial)
        try:
            with self._talking("setting up"):
                self._set_up()
        except BaseException:
            self.close()
            raise

    # --- used on the control thread ----------------------------------------------------------

    @property
    def triggers_itself(self) -> bool:
        """Whether `trigger` causes the exposure; else an external trigger does."""
        return triggers_itself(self.settings.trigger)

    def trigger(self) -> int:
        """Start an exposure; return the host time at which the command left.

        Aravis repeats a command that is not answered. The start of the exposure is then unknown, which raises
        `FrameTimeout`. An external trigger needs no command: exposures count from now.
        """
        trigger = self.settings.trigger
        at_ticks = self._ahead(trigger.lead_s) if isinstance(trigger, Action) and trigger.send_to else None
        sent_ns = host_ns()
        if isinstance(trigger, Software):
            with self._talking("software trigger"):
                self._fire()
            took_s = (host_ns() - sent_ns) * 1e-9
            if took_s >= REPEAT_S:
                raise FrameTimeout(self.name, f"the trigger command was answered only after {took_s:.2f} s")
        elif isinstance(trigger, Action) and trigger.send_to:
            self._actions = self._actions % 0xFFFF + 1  # GVCP request ids are 16 bits, never 0
            send_action(self.name, trigger, at_ticks, self._actions)
        self._read_clock()
        if time.monotonic() - self._looked_s > LOOK_S:
            self._look()
        return sent_ns

    def _fire(self) -> None:
        """Send the software trigger. Raises `FrameTimeout` if a camera that is still exposing refuses it."""
        try:
            self._camera.software_trigger()
        except self._library.glib.Error as error:
            busy = int(self._library.aravis.DeviceError.PROTOCOL_ERROR_BUSY)
            if error.domain == DEVICE_ERROR_DOMAIN and error.code == busy:
                raise FrameTimeout(self.name, "it refuses a trigger: still busy with an exposure") from error
            raise

    def _ahead(self, lead_s: float) -> int | None:
        """PTP time of a scheduled action, in ticks; None: at once."""
        if lead_s == 0:
            return None
        self._look()
        if not self.ptp or self._latch is None:
            raise FrameTimeout(self.name, "a scheduled action needs PTP, and its clock is not locked")
        with self._talking("reading its clock"):
            now_ns = self._latch.read(self._camera.get_device()).device_ns
        return (now_ns + round(lead_s * 1e9)) * self._latch.tick_hz // 10**9

    def _read_clock(self) -> None:
        if self._latch is None:
            return
        jumps = self.clock.jumps
        with self._talking("reading its clock"):
            self.clock.add(self._latch.read(self._camera.get_device()))
        if self.clock.jumps > jumps:
            text = (
                "camera %s: its clock has jumped; a clock that does so repeatedly is more than %.0f ppm off"
            )
            self._jumps.warning(text, self.name, CLOCK_DRIFT * 1e6)

    def note_exposure(self, earliest_ns: int, arrival: Arrival) -> None:
        """Map a clock that cannot be read by an exposure, which lay between `earliest_ns` and its arrival."""
        if self._latch is None and arrival.device_ns > 0:
            self.clock.add(ClockReading(earliest_ns, arrival.arrived_ns, arrival.device_ns))

    def restart(self) -> None:
        """Stop and start acquisition, which abandons an exposure that is still under way.

        The stream is recreated, too: if the camera counts from 1 again, Aravis would drop its frames as late.
        """
        with self._talking("restarting acquisition"):
            self._camera.stop_acquisition()
            self._end_stream()
            self._counter.restart()
            self._start_stream()

    # --- exposure and gain while images are taken ----------------------------------------------

    def adjust(self, values: CameraValues) -> CameraValues | exposure.StreamLocks:
        """Set exposure time and gain and read them back, if the firmware accepts them while streaming."""
        with self._talking("adjusting"):
            made = exposure.adjust(self.name, self._nodes(), values)
        if isinstance(made, exposure.StreamLocks):
            return made
        self._note_exposure_time(made)
        if values.exposure_us is not None and self._chunks is not None:
            self._chunks.wanted_us = made.exposure_us
        return made

    def description(self) -> CameraDescription:
        """Read maker, model, firmware and all features."""
        features = self._nodes()
        with self._talking("reading its description"):
            return CameraDescription(*features.maker, firmware_of(features), tuple(features.described()))

    def values(self) -> CameraValues:
        """Current exposure time and gain."""
        with self._talking("reading its settings"):
            return exposure.values_of(self._nodes())

    def limits(self) -> CameraLimits:
        """Current limits of exposure time and gain."""
        with self._talking("asking for its limits"):
            return exposure.limits_of(self._nodes())

    def as_found(self) -> dict[str, Value]:
        """Current values of the nodes that `adjust` may change, for `write_back`."""
        with self._talking("reading its settings"):
            return exposure.as_found(self._nodes())

    def write_back(self, nodes: Mapping[str, Value]) -> None:
        """Write the values of `as_found` back and compare them. Raises `CameraSetupError`."""
        with self._talking("writing its settings back"):
            self._nodes().require(nodes)
            self._note_exposure_time(exposure.values_of(self._nodes()))
        if self._chunks is not None:
            self._chunks.wanted_us = self.settings.exposure_us

    def _note_exposure_time(self, values: CameraValues) -> None:
        """Note the exposure time, by which the delivery of an image is later than its start."""
        self.exposure_ns = round((values.exposure_us or 0.0) * 1e3)

    def _nodes(self) -> Features:
        if self._features is None:
            raise CameraUnreachable(self.name, "not open")
        return self._features

    def probe(self) -> None:
        """Check that the camera answers and is still under our control.

        Raises `CameraUnreachable` or `CameraBusy`. A write is denied if another host has taken control; but a
        camera that was restarted has no controlling host and may accept writes of any: hence the read.
        """
        if not self._camera.is_gv_device():
            self._look()
            return  # USB reports by itself when it is unplugged
        device = self._camera.get_device()
        with self._talking("checking the connection"):
            device.write_register(HEARTBEAT_REGISTER, self._heartbeat_ms)
            privilege = device.read_register(CONTROL_PRIVILEGE_REGISTER)
            if privilege & CONTROLLED == 0:
                raise CameraRestarted(self.name, RESTARTED)
        self._read_clock()
        self._look()

    def _look(self) -> None:
        """Read the values that change slowly: PTP state and temperature."""
        device, features = self._camera.get_device(), self._features
        self._looked_s = time.monotonic()
        if features is not None:
            with self._talking("reading its status"):
                self.ptp = ptp_locked(device, features)
                temperature = features.first(*TEMPERATURE)
                value = features.value(temperature) if temperature else None
                self._temperature_c = float(value) if isinstance(value, int | float) else None

    def health(self) -> CameraHealth:
        """Health of the camera, by the values last read."""
        stream = self._stream
        counts: dict[str, int] = {}
        if stream is not None:
            names = [stream.get_info_name(place) for place in range(stream.get_n_infos())]
            counts = {name: int(stream.get_info_uint64_by_name(name)) for name in names if name in COUNTS}
        latest = self.clock.readings[-1:]
        mapped = self.clock.at(latest[0].device_ns) if latest else None
        bound_ns = mapped.bound_ns if mapped is not None else None
        complete, failed, resent, lost = (counts.get(name) for name in COUNTS)
        return CameraHealth(
            self._temperature_c, bound_ns, self.ptp, complete, failed, resent, lost, self._gamma,
            self._linear,
            self._lacks, self._packet_delay_us, self._firmware, self._packet_bytes,
        )  # fmt: skip

    def close(self) -> None:
        """Close the connection, stopping acquisition if the camera still answers; never raises."""
        self._stop_pumping()
        camera, self._camera = self._camera, None
        if camera is None:
            return
        if self._handler:
            camera.get_device().disconnect(self._handler)
        if self._stream is not None and not self.lost.is_set():
            with contextlib.suppress(self._library.glib.Error):  # it may be gone
                camera.stop_acquisition()
        self._stream = None
        # dropping the last reference gives up control and ends Aravis' threads. Reference cycles would keep
        # one, and so would this session, which lives as long as the traceback of an error that it raised
        self._features = self._latch = None
        del camera
        gc.collect()

    @contextlib.contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        """Translate errors; after one that means that the camera is gone, mark the connection as lost."""
        try:
            with translated(self.name, doing):
                yield
        except CameraUnreachable:
            self.lost.set()
            raise
        except CameraBusy:
            if self._stream is not None and self._belongs_to_nobody():
                raise CameraRestarted(self.name, RESTARTED) from None
            raise

    def _belongs_to_nobody(self) -> bool:
        """Whether the camera that refused a command has no controlling host, since it has restarted."""
        try:
            privilege = self._camera.get_device().read_register(CONTROL_PRIVILEGE_REGISTER)
        except self._library.glib.Error:
            return False
        return bool(privilege & CONTROLLED == 0)

    # --- setting up --------------------------------------------------------------------------

    def _set_up(self) -> None:
        camera, settings = self._camera, self.settings
        device = camera.get_device()
        if camera.is_gv_device() and not device.is_controller():
            raise CameraBusy(self.name, f"{settings.device} is controlled by another host or program")
        if camera.is_gv_device():
            self._heartbeat_ms = max(device.read_register(HEARTBEAT_REGISTER), HEARTBEAT_MS)
            device.write_register(HEARTBEAT_REGISTER, self._heartbeat_ms)
        self._handler = device.connect("control-lost", self._control_lost)
        with contextlib.suppress(self._library.glib.Error):
            camera.stop_acquisition()  # a host that crashed may have left it running
        with self._talking("asking who it is"):
            maker = camera.get_vendor_name() or "", camera.get_model_name() or ""
        self._features = features = Features(self.name, device, maker)
        placement = set_up(self.name, camera, features, settings)
        with self._talking("asking for its response"):
            self._gamma, self._linear = gamma_in_effect(features), gamma_switch(features)
            self._note_exposure_time(exposure.values_of(features))
        self._latch = find_latch(device, features, gige=camera.is_gv_device())
        with self._talking("asking what it has"):
            self._lacks = missing_features(features, clock=self._latch is not None)
            self._firmware = firmware_of(features)
        for _ in range(CLOCK_READINGS):
            self._read_clock()
        self._look()
        self._placement = placement
        self._set_up_stream()
        self._start_stream()

    def _set_up_stream(self) -> None:
        """Set packet size, pacing and chunks; a stream created before that would scramble its buffers."""
        aravis, camera, settings = self._library.aravis, self._camera, self.settings
        if camera.is_gv_device():
            if settings.packet_size is None:
                camera.gv_auto_packet_size()
            self._packet_bytes = int(camera.gv_get_packet_size())
            self._packet_delay_us = pace(self.name, camera, self._nodes(), settings)
            camera.gv_set_packet_size_adjustment(aravis.GvPacketSizeAdjustment.NEVER)
            if settings.user_socket:
                camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        elif camera.is_uv_device():
            share_usb(self.name, self._nodes(), settings)
        self._chunks = self._chunk_reader()

    def _start_stream(self) -> None:
        aravis, camera, settings = self._library.aravis, self._camera, self.settings
        payload = camera.get_payload()
        self._stream = camera.create_stream(None, None)
        if camera.is_gv_device():
            # as large as the kernel allows, up to one frame: the default would lose most of a burst
            self._stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.AUTO)
            if not settings.resend:
                self._stream.set_property("packet-resend", aravis.GvStreamPacketResend.NEVER)
        for _ in range(BUFFERS):
            self._stream.push_buffer(aravis.Buffer.new_allocate(payload))
        self._stop_pump = threading.Event()
        decoder = Decoder(aravis, self._counter, self._placement, self._chunks)
        self._pump = threading.Thread(
            target=pump,
            args=(decoder, self._stream, self._stop_pump, self._deliver),
            name=f"pump {self.name}",
            daemon=True,
        )
        self._pump.start()
        camera.start_acquisition()

    def _stop_pumping(self) -> None:
        self._stop_pump.set()
        if self._pump is not None:
            self._pump.join()
            self._pump = None

    def _end_stream(self) -> None:
        self._stop_pumping()
        self._stream = None
        gc.collect()

    def _chunk_reader(self) -> ChunkReader | None:
        """Switch on the wanted chunk data and return their reader; None where none are wanted."""
        settings = self.settings
        exposure, count = settings.chunks, settings.count
        wanted = ["ExposureTime"] * exposure + [count] * bool(count)
        if not wanted:
            return None
        offered = self._nodes().choices("ChunkSelector") if count else ()
        if count and count not in offered:
            has = f"ChunkSelector offers {', '.join(offered)}" if offered else "it has no ChunkSelector"
            raise CameraSetupError(self.name, f"count: it cannot send {count} with an image: {has}")
        with self._talking(f"asking for {' and '.join(wanted)} with each image"):
            self._camera.set_chunks(",".join(wanted))
            with PARSING:
                parser = self._camera.create_chunk_parser()
        error = self._library.glib.Error
        return ChunkReader(parser, error, settings.exposure_us, exposure=exposure, count=count)

    def _control_lost(self, _device: Any) -> None:
        """Mark the connection as lost; called on Aravis' heartbeat thread."""
        self.lost.set()
        self._on_lost()
