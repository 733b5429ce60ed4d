"""A GigE Vision camera in pure Python, over real UDP.

Implements the control protocol (GVCP, port 3956) and the stream protocol (GVSP) of the GigE Vision 2.0
specification as far as clients need them: discovery, control privilege with heartbeat, register and
memory access, GenICam XML in memory; triggers by software, by lines with debouncer, delay and outputs, by
action commands, immediate or scheduled by PTP; free run; time stamps with offset and drift, or synchronised
by PTP; eight pixel formats, chunk data, packet resend. Each camera answers on its own address, so that two
can run on 127.0.0.1 and 127.0.0.2 without root. `edged sim` runs cameras as a process.

Not responsible for: the content of the picture (`exposure` renders it).
"""

from __future__ import annotations

import logging
import random
import socket
import struct
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType

import numpy as np

from edged.domain.arrays import Image
from edged.errors import ListenError
from edged.sim.exposure import ExposureRequest
from edged.sim.gige import genicam as g
from edged.sim.gige.clock import DeviceClock, utc_minus_monotonic_ns
from edged.sim.gige.faults import BLOCKS_TO_RESTART, Faults, Quirk
from edged.sim.gige.gvcp import POLL_S, ControlChannel
from edged.sim.gige.gvsp import (
    EXTENDED_BYTES,
    EXTENDED_CHUNK,
    IMAGE,
    IMAGE_WITH_CHUNKS,
    JPEG,
    ImageBlock,
    with_chunks,
)
from edged.sim.gige.pixels import encode
from edged.sim.gige.registers import INVALID_PARAMETER, SUCCESS, CameraIdentity, CameraRegisters
from edged.sim.gige.stream import StreamChannel
from edged.sim.gige.triggers import CameraTriggers
from edged.sim.gige.wiring import Wire
from edged.vision.kernels.pixelformats import BY_CODE

__all__ = ["Faults", "GigeCamera", "Make", "Quirk", "moving_ramp"]

log = logging.getLogger(__name__)

SHORTEST_HEARTBEAT_MS = 500
HEADERS_BYTES = 36  # IP 20, UDP 8, GVSP 8
FASTEST_HZ = 100.0
ENCODER_NS = 1_000_000
"""Period of the encoder's counts, by the camera's own clock; the simulated belt never stops."""
RESET, LATCH = 0x01, 0x02  # bits of the time stamp control register


@dataclass(frozen=True, slots=True)
class Make:
    """Vendor, model and features of an imitated camera; registers with a function are those of `genicam`."""

    vendor: str
    model: str
    features: tuple[g.GenicamNode, ...]


class GigeCamera:
    """One virtual camera; a context manager with two threads (control, exposure).

    exposure : called in the exposure thread; returns the (height, width) uint8 image.
    faults : active faults; the fields may be changed at any time.
    quirks : peculiarities of its firmware. make : name and features of another maker's camera to imitate.
    size : width and height of a picture.
    clock : its clock; drift and PTP may be changed at any time, and it can be stepped.
    registers : its memory. exposures : number of exposures since it was created.
    """

    def __init__(
        self,
        address: str,
        serial: str,
        exposure: Callable[[ExposureRequest], Image],
        *,
        size: tuple[int, int] = (1280, 960),
        faults: Faults | None = None,
        clock: DeviceClock | None = None,
        quirks: Collection[Quirk] = (),
        make: Make | None = None,
    ) -> None:
        if len(serial.encode()) > 15:
            raise ValueError(f"serial {serial!r}: at most 15 bytes")
        self.address, self.serial = address, serial
        self.exposure, self.exposures = exposure, 0
        self.faults = faults or Faults()
        self.clock = clock or DeviceClock()
        self._quirks = frozenset(quirks)
        # two threads draw random numbers: with one generator each, runs are reproducible
        self._chance, self._answer_chance = random.Random(0), random.Random(0)
        identity = CameraIdentity(address, serial, mac=int.from_bytes(socket.inet_aton(address), "big"))
        if make is not None:
            identity = replace(identity, model=make.model, vendor=make.vendor)
        table = make.features if make is not None else g.features(*size, self._quirks)
        self.registers = CameraRegisters(identity, table, self._quirks)
        self._triggers = CameraTriggers(self.registers, self.clock, self._quirks)
        self._held: tuple[float, float] | None = None
        self._starts = 0
        self._set_hooks(self.registers.hooks)
        self._temperature_c = 41.5
        self._frame_id, self._next_ns = 0, 0
        self._last_image: Image | None = None
        self._running = threading.Event()
        self._thread: threading.Thread | None = None
        self._connect()

    def _connect(self) -> None:
        """Create the channels for the present address, and reset the memory to power-on values."""
        self._control = ControlChannel(self.address, self.registers, self, self.faults, self._answer_chance)
        self._stream = StreamChannel(self.address, self.faults, self._chance)
        self._power_on()

    def _set_hooks(self, hooks: dict[int, Callable[[int], int]]) -> None:
        hooks[g.PACKET_SIZE] = self._set_packet_size
        hooks[g.TIMESTAMP_CONTROL] = self._control_clock
        hooks[g.HEARTBEAT_MS] = lambda word: self._keep(g.HEARTBEAT_MS, max(word, SHORTEST_HEARTBEAT_MS))
        kept = (g.IP_CONFIGURATION, g.PERSISTENT_IP, g.PERSISTENT_MASK, g.PERSISTENT_GATEWAY)
        for address in (g.STREAM_PORT, g.STREAM_DESTINATION, g.PACKET_DELAY, *kept):
            hooks[address] = partial(self._keep, address)
        hooks[g.ACQUISITION_START] = lambda _: self._start_acquisition()
        hooks[g.ACQUISITION_STOP] = lambda _: self._stop_acquisition()
        hooks[g.DEVICE_RESET] = self._reset_device
        hooks[g.LATCH] = lambda _: self._latch(g.LATCH_VALUE, self.clock.at(time.monotonic_ns()))
        hooks[g.PTP_LATCH] = lambda _: self._latch(g.PTP_OFFSET, self.clock.offset_from_master_ns)
        hooks[g.CLOCK_RESET] = lambda _: self._control_clock(RESET)
        hooks[g.PTP_ENABLE] = self._enable_ptp
        self.registers.live[g.PTP_STATUS] = lambda: self.clock.ptp_state

    def _power_on(self) -> None:
        self.registers.power_on()
        self.registers.put(g.TICKS_HIGH, self.clock.tick_hz, 8)
        if g.TEMPERATURE in self.registers:
            self.registers.put(g.TEMPERATURE, self._temperature_c)

    # --- control by tests and people ---------------------------------------------------------------

    def start(self) -> None:
        """Open the sockets and start answering. Raises `ListenError` if the port is taken."""
        try:
            self.registers.put(g.STREAM_SOURCE_PORT, self._stream.open())
            self._running.set()
            self._control.open()
        except OSError as error:
            self.stop()
            raise ListenError(f"virtual camera {self.address}: {error.strerror or error}") from error
        except ListenError:
            self.stop()
            raise
        self._thread = threading.Thread(
            target=self._serve_exposures, name=f"gige-exposure-{self.serial}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Stop answering and release everything; safe to call twice."""
        self._running.clear()
        self._control.close()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._stream.close()

    def __enter__(self) -> GigeCamera:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def line(self, name: str) -> Wire:
        """Wire at Line1 (input), Line2 (output) or Line3 (either), to be pulsed or connected to another."""
        return self._triggers.lines[name]

    @property
    def controlled(self) -> bool:
        """Whether a client has control."""
        return self._control.controller is not None

    @property
    def temperature_c(self) -> float:
        """The value of DeviceTemperature."""
        return self._temperature_c

    @temperature_c.setter
    def temperature_c(self, value: float) -> None:
        self._temperature_c = value
        if g.TEMPERATURE in self.registers:
            self.registers.put(g.TEMPERATURE, value)

    def reboot(self, silent_s: float = 0.5) -> None:
        """Power-cycle: control is lost, all registers and the clock are reset; silent for a while."""
        self._control.be_silent(silent_s)
        self._control.end_session()
        source_port = self.registers.word(g.STREAM_SOURCE_PORT)
        self.clock.power_on()
        self._power_on()
        self.registers.put(g.STREAM_SOURCE_PORT, source_port)
        self._stream.forget()
        self._frame_id, self._last_image = 0, None

    def steal_control(self) -> None:
        """Let another host take control and keep it until `release_control`."""
        self._control.seize()

    def release_control(self) -> None:
        """End the control session of the client."""
        self._control.end_session()

    def move_to(self, address: str) -> None:
        """Change to another IP address, as after a new DHCP lease.

        Raises `ListenError` if it is taken or not this machine's; the camera then keeps its address.
        """
        before = self.address
        self.stop()
        self._control.end_session()
        try:
            self._start_at(address)
        except ListenError:
            self._start_at(before)
            raise

    def force_address(self, address: str) -> None:
        """Run `move_to` in its own thread, as it cannot run in the thread that received the command."""
        threading.Thread(target=self.move_to, args=(address,), name=f"move-{self.serial}").start()

    def _start_at(self, address: str) -> None:
        self.address = address
        self.registers.identity = replace(self.registers.identity, address=address)
        self._connect()
        self.start()

    # --- registers with side effects -----------------------------------------------------------------

    def _keep(self, address: int, word: int) -> int:
        self.registers.put(address, word)
        return SUCCESS

    def _set_packet_size(self, word: int) -> int:
        size = word & g.PACKET_SIZE_MASK
        if not 46 <= size <= 65_000:
            return INVALID_PARAMETER
        self.registers.put(g.PACKET_SIZE, word & (g.PACKET_SIZE_MASK | g.DO_NOT_FRAGMENT))
        if word & g.FIRE_TEST_PACKET:
            self._stream.send_test(size - 28, self._destination())
        return SUCCESS

    def _control_clock(self, word: int) -> int:
        if word & RESET:
            self.clock.reset()
        if word & LATCH:
            self._latch(g.TIMESTAMP_HIGH, self.clock.ticks(self.clock.at(time.monotonic_ns())))
        return SUCCESS

    def _latch(self, address: int, value: int) -> int:
        self.registers.put(address, value, 8)
        return SUCCESS

    def _enable_ptp(self, word: int) -> int:
        self.clock.ptp = bool(word)
        return SUCCESS

    def _reset_device(self, _word: int) -> int:
        self.reboot()
        return SUCCESS

    def _destination(self) -> tuple[str, int]:
        host = socket.inet_ntoa(self.registers.word(g.STREAM_DESTINATION).to_bytes(4, "big"))
        return host, self.registers.word(g.STREAM_PORT) & 0xFFFF

    def _start_acquisition(self) -> int:
        self._triggers.queue.clear()
        self._triggers.exposing = False
        self._held = None
        self._starts += 1
        self._frame_id = 0
        self._next_ns = time.monotonic_ns()
        self.registers.acquiring = True
        return SUCCESS

    def _stop_acquisition(self) -> int:
        self.registers.acquiring = False
        return SUCCESS

    def session_ended(self) -> None:
        """Stop streaming, as control was lost."""
        self._stop_acquisition()

    def resend(self, block_id: int, first: int, last: int) -> None:
        """Resend packets of a block."""
        self._stream.resend(block_id, first, last)

    def act(self, keys: tuple[int, int, int], at_ticks: int | None) -> int | None:
        """Execute an action command if it is for this camera."""
        return self._triggers.act(keys, at_ticks)

    # --- images --------------------------------------------------------------------------------------

    def _serve_exposures(self) -> None:
        while self._running.is_set():
            free_run = self.registers.acquiring and self.registers.word(g.TRIGGER_MODE) == 0
            wait_s = max(self._next_ns - time.monotonic_ns(), 0) * 1e-9 if free_run else POLL_S
            at_ns = self._triggers.queue.get(min(wait_s, POLL_S))
            if at_ns is not None:
                self._expose(at_ns)
            elif free_run and (now_ns := time.monotonic_ns()) >= self._next_ns:
                period_ns = round(1e9 / self._rate_hz())
                at_ns = self._next_ns if now_ns - self._next_ns < period_ns else now_ns  # no catching up
                self._next_ns = at_ns + period_ns
                self._expose(at_ns)

    def _rate_hz(self) -> float:
        limited = self.registers.word(g.FRAME_RATE_ENABLE) or g.FRAME_RATE_ENABLE not in self.registers
        return self.registers.number(g.FRAME_RATE, 10.0) if limited else FASTEST_HZ

    def _expose(self, at_ns: int) -> None:
        """Expose at this monotonic time and send the image."""
        self.exposures += 1
        if not self.faults.repeat_id or self._frame_id == 0:
            self._frame_id += 1
        registers, (width, height) = self.registers, self.registers.size
        exposure_us, gain_db = self._effective()
        start = self._starts
        request = ExposureRequest(
            frame_id=self._frame_id,
            exposed_ns=at_ns + utc_minus_monotonic_ns(),
            device_ns=self.clock.at(at_ns),
            exposure_us=exposure_us,
            gain_db=gain_db,
            width=width,
            height=height,
        )
        self._triggers.drive_outputs(at_ns, request.exposure_us)
        image = self._picture(request)
        if self.faults.delay_s > 0:
            time.sleep(self.faults.delay_s)
        if self.faults.drop_next > 0:
            self.faults.drop_next -= 1
            self._triggers.exposing = False
            return
        # an exposure begun before acquisition was stopped is not sent after a restart
        sends = self.registers.acquiring and start == self._starts
        if sends and not (self.faults.stalled or self.faults.unplugged):
            self._stream.send(
                self._block(request, image), self._destination(), registers.word(g.PACKET_DELAY) * 1e-9
            )
        if start == self._starts:
            self._triggers.exposing = False

    def _effective(self) -> tuple[float, float]:
        """Exposure time and gain in effect for this exposure."""
        written = self.registers.number(g.EXPOSURE_TIME), self.registers.number(g.GAIN)
        held, self._held = self._held, written
        return held if held is not None and Quirk.LATE_EXPOSURE in self._quirks else written

    def _picture(self, request: ExposureRequest) -> Image:
        if self.faults.frozen and self._last_image is not None:
            return self._last_image
        image = self.exposure(request)
        if image.shape != (request.height, request.width) or image.dtype != np.uint8:
            raise ValueError(
                f"exposure gave {image.dtype} {image.shape}, expected uint8 {(request.height, request.width)}"
            )
        gamma = self.registers.number(g.GAMMA, 1.0)
        if gamma != 1.0 and (self.registers.word(g.GAMMA_ENABLE) or g.GAMMA_ENABLE not in self.registers):
            levels = np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)
            image = levels[image]
        self._last_image = image
        return image

    def _block(self, request: ExposureRequest, image: Image) -> ImageBlock:
        registers = self.registers
        ticks = self.clock.ticks(request.device_ns)
        pixel_format = registers.word(g.PIXEL_FORMAT)
        data, payload_type = encode(image, BY_CODE[pixel_format]), IMAGE
        if registers.word(g.CHUNK_MODE):
            payload_type = EXTENDED_CHUNK if Quirk.OLD_CHUNKS in self._quirks else IMAGE_WITH_CHUNKS
            content = {
                "FrameID": request.frame_id.to_bytes(8, "big"),
                "Timestamp": ticks.to_bytes(8, "big"),
                "ExposureTime": struct.pack(">f", request.exposure_us),
                "EncoderValue": (request.device_ns // ENCODER_NS).to_bytes(8, "big"),
            }
            chunks = [(chunk.id, content[chunk.name]) for chunk in registers.chunks]
            data = with_chunks(data, g.IMAGE_CHUNK_ID, chunks)
        if Quirk.JPEG_PAYLOAD in self._quirks:
            payload_type = JPEG
        extended = Quirk.EXTENDED_IDS in self._quirks
        return ImageBlock(
            block_id=self._block_id(request.frame_id),
            ticks=ticks,
            pixel_format=pixel_format,
            width=request.width,
            height=request.height,
            offset=(registers.word(g.OFFSET_X), registers.word(g.OFFSET_Y)),
            data=data,
            packet_bytes=(registers.word(g.PACKET_SIZE) & g.PACKET_SIZE_MASK)
            - (HEADERS_BYTES + (EXTENDED_BYTES if extended else 0)),
            payload_type=payload_type,
            extended=extended,
        )

    def _block_id(self, frame_id: int) -> int:
        """Block id of a frame: the standard's 16 bits without 0, or as a quirk demands."""
        if Quirk.EXTENDED_IDS in self._quirks:
            return 2**32 + frame_id
        if Quirk.BLOCK_ID_ZERO in self._quirks:
            return (frame_id - 1) % 0x1_0000
        wraps = BLOCKS_TO_RESTART if Quirk.COUNTER_RESTARTS in self._quirks else 0xFFFF
        return (frame_id - 1) % wraps + 1


def moving_ramp(request: ExposureRequest) -> Image:
    """A diagonal ramp that moves by one grey value from frame to frame."""
    y, x = np.mgrid[: request.height, : request.width]
    return np.asarray((x + y + request.frame_id) % 256, dtype=np.uint8)


def _main() -> None:
    import argparse

    parser = argparse.ArgumentParser(
        description="A virtual GigE Vision camera with a test pattern, until killed."
    )
    parser.add_argument("address")
    parser.add_argument("serial")
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=960)
    options = parser.parse_args()
    with GigeCamera(options.address, options.serial, moving_ramp, size=(options.width, options.height)):
        print(f"virtual camera {options.serial} on {options.address}", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    _main()
