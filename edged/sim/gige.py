"""A GigE Vision camera in pure Python, over real UDP.

The control protocol (GVCP, port 3956) and the stream protocol (GVSP) of the GigE Vision 2.0
specification, as far as a client needs them: discovery, control privilege with heartbeat,
register and memory access, GenICam XML from memory, software trigger, free run, leader / payload /
trailer, packet resend. It answers on an address of its own, so that two of them run on 127.0.0.1
and 127.0.0.2 without root. `python -m edged.sim.gige 127.0.0.1 SERIAL` runs one as a process.

Not responsible for: what the picture shows (`exposure` renders it).
"""

from __future__ import annotations

import logging
import queue
import random
import socket
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from edged.domain import Image
from edged.errors import ListenError
from edged.sim import genicam as g
from edged.sim.exposure import ExposureRequest
from edged.sim.gvsp import Block, Pacing, leader, payload_packet, trailer

log = logging.getLogger(__name__)

GVCP_PORT = 3956
ACK_REQUIRED = 0x01
DISCOVERY, PACKET_RESEND, READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY = (
    0x02,
    0x40,
    0x80,
    0x82,
    0x84,
    0x86,
)
SUCCESS, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0x0000, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED, BUSY = 0x8004, 0x8005, 0x8006, 0x8007
MAX_READ = 536  # bytes of one READMEM, so that the answer fits 576-byte datagrams
KEPT_BLOCKS = 4  # frames whose packets can be asked for again
EXCLUSIVE_ACCESS, CONTROL_ACCESS = 0x01, 0x02
POLL_S = 0.05


@dataclass(slots=True)
class Faults:
    """What goes wrong; may be changed while the camera runs.

    packet_loss : share of stream packets that are not sent (resent ones neither).
    unplugged : the cable is out: nothing is heard or said.
    stalled : triggers are taken, but no image is sent. delay_s : every image comes so much later.
    frozen : the sensor delivers its last image again and again.
    """

    packet_loss: float = 0.0
    unplugged: bool = False
    stalled: bool = False
    delay_s: float = 0.0
    frozen: bool = False


class GigeCamera:
    """One virtual camera; a context manager with two threads (control, exposure).

    exposure : called in the exposure thread; returns the (height, width) uint8 image.
    """

    def __init__(
        self,
        address: str,
        serial: str,
        exposure: Callable[[ExposureRequest], Image],
        *,
        model: str = "Virtual",
        width: int = 1280,
        height: int = 960,
        faults: Faults | None = None,
        pacing: Pacing | None = None,
        seed: int = 0,
    ) -> None:
        if len(serial.encode()) > 15:
            raise ValueError(f"serial {serial!r}: at most 15 bytes")
        self.address, self.serial = address, serial
        self.faults = faults or Faults()
        self._pacing = pacing or Pacing()
        self._exposure = exposure
        self._features = {f.address: f for f in g.features(width, height)}
        self._xml = g.description(tuple(self._features.values()), model)
        self._xml += b"\0" * (-len(self._xml) % 4)
        self._memory = self._bootstrap(model)
        self._random = random.Random(seed)
        self._born_ns = time.monotonic_ns()
        self._controller: tuple[str, int] | None = None
        self._heard_s = 0.0
        self._last_answer: tuple[tuple[str, int], int, bytes] | None = None
        self._acquiring = threading.Event()
        self._triggers: queue.Queue[tuple[int, int]] = queue.Queue()
        self._blocks: OrderedDict[int, Block] = OrderedDict()
        self._frame_id = 0
        self._last_image: Image | None = None
        self._running = threading.Event()
        self._threads: list[threading.Thread] = []
        self._control: socket.socket | None = None
        self._broadcast: socket.socket | None = None
        self._stream: socket.socket | None = None

    # --- life ----------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the sockets and begin to answer. Raises `ListenError` when the port is taken."""
        try:
            self._control = self._open_socket(self.address)
            self._stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._stream.bind((self.address, 0))
            self._stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * 1024 * 1024)
        except OSError as error:
            self._close_sockets()
            raise ListenError(
                f"virtual camera {self.address}:{GVCP_PORT}: {error.strerror or error}"
            ) from error
        try:  # a machine may forbid it: then the camera is found by its address only
            self._broadcast = self._open_socket("255.255.255.255", shared=True)
        except OSError as error:
            log.info("virtual camera %s: no broadcast discovery: %s", self.address, error)
        self._put(g.STREAM_SOURCE_PORT, self._stream.getsockname()[1])
        self._running.set()
        for name, work in (("control", self._serve_control), ("exposure", self._serve_exposures)):
            thread = threading.Thread(target=work, name=f"gige-{name}-{self.serial}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def stop(self) -> None:
        """Stop answering and release everything; safe to call twice."""
        self._running.clear()
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        self._close_sockets()

    def __enter__(self) -> GigeCamera:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _close_sockets(self) -> None:
        for opened in (self._control, self._broadcast, self._stream):
            if opened is not None:
                opened.close()
        self._control = self._broadcast = self._stream = None

    @staticmethod
    def _open_socket(address: str, *, shared: bool = False) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if shared:  # every camera of this machine hears a broadcast
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind((address, GVCP_PORT))
            opened.settimeout(POLL_S)
        except OSError:
            opened.close()
            raise
        return opened

    # --- registers -----------------------------------------------------------------------------

    def _bootstrap(self, model: str) -> dict[int, int]:
        """Registers {address: 32-bit word} after power-on."""
        memory = dict.fromkeys(range(0, 0x1000, 4), 0)

        def text(address: int, value: str, size: int) -> None:
            padded = value.encode()[: size - 1].ljust(size, b"\0")
            for offset in range(0, size, 4):
                memory[address + offset] = int.from_bytes(padded[offset : offset + 4], "big")

        number = int.from_bytes(socket.inet_aton(self.address), "big")
        memory[g.VERSION], memory[g.DEVICE_MODE] = 0x0002_0000, 0x8000_0001  # 2.0; big endian, UTF-8
        memory[g.MAC_HIGH], memory[g.MAC_LOW] = 0x0200, number  # locally administered, unique per address
        memory[g.IP_OPTIONS] = memory[g.IP_CONFIGURATION] = 0x0000_0006
        memory[g.CURRENT_IP], memory[g.SUBNET_MASK] = number, 0xFF00_0000
        text(g.MANUFACTURER, "edged", 32)
        text(g.MODEL, model, 32)
        text(g.DEVICE_VERSION, "1", 32)
        text(g.INFO, "virtual camera", 48)
        text(g.SERIAL, self.serial, 16)
        text(g.FIRST_URL, f"Local:{g.XML_NAME};{g.XML_ADDRESS:x};{len(self._xml):x}", 512)
        memory[g.INTERFACES] = memory[g.STREAM_CHANNELS] = 1
        # concatenation, WRITEMEM, PACKETRESEND; serial number register
        memory[g.CAPABILITY] = 0x0000_0007 | 0x4000_0000
        memory[g.HEARTBEAT_MS] = 3000
        memory[g.TICKS_LOW] = 1_000_000_000
        memory[g.PACKET_SIZE] = 1500
        for feature in self._features.values():
            memory[feature.address] = _encode(feature, feature.start)
        return memory

    def _put(self, address: int, value: int) -> None:
        self._memory[address] = value & 0xFFFF_FFFF

    def _value(self, address: int) -> float:
        word = self._memory[address]
        if self._features[address].kind == "float":
            return float(struct.unpack(">f", word.to_bytes(4, "big"))[0])
        return word

    def _read(self, address: int, count: int) -> bytes | int:
        """`count` bytes from `address`, or the status that says why not."""
        if address % 4 or count % 4 or not 0 < count <= MAX_READ:
            return BAD_ALIGNMENT
        if g.XML_ADDRESS <= address < g.XML_ADDRESS + len(self._xml):
            start = address - g.XML_ADDRESS
            return self._xml[start : start + count].ljust(count, b"\0")
        words = []
        for place in range(address, address + count, 4):
            if place not in self._memory:
                return INVALID_ADDRESS
            words.append(self._memory[place].to_bytes(4, "big"))
        return b"".join(words)

    def _write(self, address: int, word: int, sender: tuple[str, int]) -> int:
        """Write one register; returns the status."""
        if address % 4:
            return BAD_ALIGNMENT
        if address == g.CONTROL_PRIVILEGE:
            return self._take_control(word, sender)
        if self._controller != sender:
            return ACCESS_DENIED
        feature = self._features.get(address)
        if feature is not None:
            return self._write_feature(feature, word)
        if address not in self._memory:
            return INVALID_ADDRESS
        if address == g.PACKET_SIZE:
            size = word & g.PACKET_SIZE_MASK
            if not 46 <= size <= 65_000:
                return INVALID_PARAMETER
            self._put(address, word & (g.PACKET_SIZE_MASK | g.DO_NOT_FRAGMENT))
            if word & g.FIRE_TEST_PACKET:
                self._send(b"\0" * (size - 28))
            return SUCCESS
        if address == g.TIMESTAMP_CONTROL:
            if word & 0x01:
                self._born_ns = time.monotonic_ns()
            if word & 0x02:
                now_ns = self._device_ns()
                self._put(g.TIMESTAMP_HIGH, now_ns >> 32)
                self._put(g.TIMESTAMP_LOW, now_ns)
            return SUCCESS
        if address == g.HEARTBEAT_MS:
            self._put(address, max(word, 500))
            return SUCCESS
        if address in (g.STREAM_PORT, g.STREAM_DESTINATION, g.PACKET_DELAY):
            self._put(address, word)
            return SUCCESS
        return WRITE_PROTECT

    def _write_feature(self, feature: g.Feature, word: int) -> int:
        if feature.read_only:
            return WRITE_PROTECT
        if feature.kind == "command":
            self._command(feature.address)
            return SUCCESS
        if feature.kind == "enumeration":
            if word not in feature.choices.values():
                return INVALID_PARAMETER
        else:
            value = struct.unpack(">f", word.to_bytes(4, "big"))[0] if feature.kind == "float" else word
            if not feature.low <= value <= feature.high:
                return INVALID_PARAMETER
        if (
            feature.address in (g.WIDTH, g.HEIGHT, g.OFFSET_X, g.OFFSET_Y, g.PIXEL_FORMAT)
            and self._acquiring.is_set()
        ):
            return BUSY
        self._put(feature.address, word)
        self._put(g.PAYLOAD_SIZE, self._memory[g.WIDTH] * self._memory[g.HEIGHT])
        return SUCCESS

    def _command(self, address: int) -> None:
        if address == g.ACQUISITION_START:
            self._drop_triggers()
            self._frame_id = 0
            self._acquiring.set()
        elif address == g.ACQUISITION_STOP:
            self._acquiring.clear()
        elif address == g.TRIGGER_SOFTWARE:
            waits = self._memory[g.TRIGGER_MODE] == 1 and self._memory[g.TRIGGER_SOURCE] == 0
            if self._acquiring.is_set() and waits:
                self._triggers.put((time.time_ns(), self._device_ns()))

    def _drop_triggers(self) -> None:
        while not self._triggers.empty():
            try:
                self._triggers.get_nowait()
            except queue.Empty:
                return

    def _device_ns(self) -> int:
        return time.monotonic_ns() - self._born_ns

    # --- control -------------------------------------------------------------------------------

    def _take_control(self, word: int, sender: tuple[str, int]) -> int:
        if self._controller not in (None, sender):
            return ACCESS_DENIED
        wanted = bool(word & (CONTROL_ACCESS | EXCLUSIVE_ACCESS))
        self._put(g.CONTROL_PRIVILEGE, word if wanted else 0)
        self._controller = sender if wanted else None
        self._heard_s = time.monotonic()
        if not wanted:
            self._end_session()
        return SUCCESS

    def _end_session(self) -> None:
        self._controller = None
        self._put(g.CONTROL_PRIVILEGE, 0)
        self._put(g.STREAM_PORT, 0)
        self._acquiring.clear()

    def _serve_control(self) -> None:
        while self._running.is_set():
            self._watch_heartbeat()
            for heard in (self._broadcast, self._control):
                if heard is None:
                    continue
                heard.settimeout(0.0 if heard is self._broadcast else POLL_S)
                try:
                    data, sender = heard.recvfrom(2048)
                except (TimeoutError, BlockingIOError):
                    continue
                except OSError:  # an ICMP "port unreachable" of a client that has gone
                    continue
                if not self.faults.unplugged:
                    self._answer(data, sender, broadcast=heard is self._broadcast)

    def _watch_heartbeat(self) -> None:
        silent_s = time.monotonic() - self._heard_s
        if self._controller is not None and silent_s * 1000 > self._memory[g.HEARTBEAT_MS]:
            log.info(
                "virtual camera %s: controller silent for %.1f s, control released", self.serial, silent_s
            )
            self._end_session()

    def _answer(self, data: bytes, sender: tuple[str, int], *, broadcast: bool) -> None:
        if len(data) < 8 or data[0] != 0x42:
            return
        _, flags, command, length, request = struct.unpack(">BBHHH", data[:8])
        body = data[8:]
        if len(body) != length or request == 0 or (broadcast and command != DISCOVERY):
            return
        if sender == self._controller:
            self._heard_s = time.monotonic()
        if self._last_answer is not None and self._last_answer[:2] == (sender, request):
            # the client did not hear us: say it again, do not do it again
            self._say(self._last_answer[2], sender)
            return
        status, answer = self._execute(command, body, sender)
        if flags & ACK_REQUIRED and command != PACKET_RESEND:
            message = struct.pack(">HHHH", status, command + 1, len(answer), request) + answer
            self._last_answer = (sender, request, message)
            self._say(message, sender)

    def _say(self, message: bytes, to: tuple[str, int]) -> None:
        if self._control is not None:
            try:
                self._control.sendto(message, to)
            except OSError as error:
                log.debug("virtual camera %s: answer not sent: %s", self.serial, error)

    def _execute(self, command: int, body: bytes, sender: tuple[str, int]) -> tuple[int, bytes]:
        if command == DISCOVERY:
            return SUCCESS, b"".join(
                self._memory[a].to_bytes(4, "big") for a in range(0, g.DISCOVERY_BYTES, 4)
            )
        if command == READ_REGISTER and body and len(body) % 4 == 0:
            values = [self._read(address, 4) for (address,) in struct.iter_unpack(">I", body)]
            bad = next((value for value in values if isinstance(value, int)), None)
            return (
                (SUCCESS, b"".join(v for v in values if isinstance(v, bytes))) if bad is None else (bad, b"")
            )
        if command == WRITE_REGISTER and body and len(body) % 8 == 0:
            for index, (address, word) in enumerate(struct.iter_unpack(">II", body)):
                status = self._write(address, word, sender)
                if status != SUCCESS:
                    return status, struct.pack(">HH", 0, index)
            return SUCCESS, struct.pack(">HH", 0, len(body) // 8)
        if command == READ_MEMORY and len(body) == 8:
            address, _, count = struct.unpack(">IHH", body)
            content = self._read(address, count)
            return (content, b"") if isinstance(content, int) else (SUCCESS, body[:4] + content)
        if command == WRITE_MEMORY and len(body) >= 8 and len(body) % 4 == 0:
            (address,) = struct.unpack(">I", body[:4])
            for offset in range(4, len(body), 4):
                status = self._write(
                    address + offset - 4, int.from_bytes(body[offset : offset + 4], "big"), sender
                )
                if status != SUCCESS:
                    return status, struct.pack(">HH", 0, offset - 4)
            return SUCCESS, struct.pack(">HH", 0, len(body) - 4)
        if command == PACKET_RESEND and len(body) >= 12:
            self._resend(body)
            return SUCCESS, b""
        known = command in (READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY, PACKET_RESEND)
        return (INVALID_PARAMETER if known else NOT_IMPLEMENTED), b""

    # --- stream --------------------------------------------------------------------------------

    def _serve_exposures(self) -> None:
        next_s = time.monotonic()
        while self._running.is_set():
            free_run = self._acquiring.is_set() and self._memory[g.TRIGGER_MODE] == 0
            try:
                wait_s = max(next_s - time.monotonic(), 0.0) if free_run else POLL_S
                exposed_ns, device_ns = self._triggers.get(timeout=min(wait_s, POLL_S) or 0.001)
            except queue.Empty:
                if not free_run or time.monotonic() < next_s:
                    continue
                next_s = time.monotonic() + 1.0 / self._value(g.FRAME_RATE)
                exposed_ns, device_ns = time.time_ns(), self._device_ns()
            self._expose(exposed_ns, device_ns)

    def _expose(self, exposed_ns: int, device_ns: int) -> None:
        self._frame_id += 1
        width, height = self._memory[g.WIDTH], self._memory[g.HEIGHT]
        exposure_us = self._value(g.EXPOSURE_TIME)
        request = ExposureRequest(
            self._frame_id, exposed_ns, device_ns, exposure_us, self._value(g.GAIN), width, height
        )
        image = (
            self._last_image
            if self.faults.frozen and self._last_image is not None
            else self._exposure(request)
        )
        if image.shape != (height, width) or image.dtype != np.uint8:
            raise ValueError(f"exposure gave {image.dtype} {image.shape}, expected uint8 {(height, width)}")
        self._last_image = image
        if self.faults.delay_s > 0:
            time.sleep(self.faults.delay_s)
        if self.faults.stalled or self.faults.unplugged or not self._acquiring.is_set():
            return
        size = (self._memory[g.PACKET_SIZE] & g.PACKET_SIZE_MASK) - 36  # IP 20, UDP 8, GVSP 8
        block_id = (self._frame_id - 1) % 0xFFFF + 1  # 16 bits, never 0
        offset = self._memory[g.OFFSET_X], self._memory[g.OFFSET_Y]
        block = Block(block_id, device_ns, width, height, offset, np.ascontiguousarray(image).tobytes(), size)
        self._blocks[block_id] = block
        while len(self._blocks) > KEPT_BLOCKS:
            self._blocks.popitem(last=False)
        self._send(leader(block))
        delay_s = self._memory[g.PACKET_DELAY] * 1e-9
        self._pacing.begin()
        for number in range(1, block.packets + 1):
            self._send(*payload_packet(block, number))
            self._pacing.wait(size, delay_s)
        self._send(trailer(block))

    def _resend(self, body: bytes) -> None:
        _, block_id, first, last = struct.unpack(">HHII", body[:12])
        block = self._blocks.get(block_id)
        if block is None:
            return
        first, last = first & 0xFFFFFF, min(last & 0xFFFFFF, block.packets + 1)
        for number in range(first, last + 1):
            if number == 0:
                self._send(leader(block))
            elif number <= block.packets:
                self._send(*payload_packet(block, number))
            else:
                self._send(trailer(block))

    def _send(self, *parts: bytes | memoryview) -> None:
        """One datagram to the stream's destination, unless the packet is to be lost."""
        port, stream = self._memory[g.STREAM_PORT] & 0xFFFF, self._stream
        if port == 0 or stream is None or self.faults.unplugged:
            return
        if self.faults.packet_loss > 0 and self._random.random() < self.faults.packet_loss:
            return
        host = socket.inet_ntoa(self._memory[g.STREAM_DESTINATION].to_bytes(4, "big"))
        try:
            stream.sendmsg(parts, [], 0, (host, port))
        except OSError as error:  # nobody listens any more, or the datagram is larger than the path allows
            log.debug("virtual camera %s: packet not sent: %s", self.serial, error)


def _encode(feature: g.Feature, value: float) -> int:
    if feature.kind == "float":
        return int.from_bytes(struct.pack(">f", value), "big")
    return int(value)


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
    with GigeCamera(options.address, options.serial, moving_ramp, width=options.width, height=options.height):
        print(f"virtual camera {options.serial} on {options.address}", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    _main()
