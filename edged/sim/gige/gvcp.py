"""Control channel of a virtual camera (GVCP; GigE Vision 2.0, chapters 14 to 18).

Discovery, control privilege with heartbeat, registers and memory, packet resend requests, action commands.
Not responsible for: the content of registers (`CameraRegisters`) and the effect of an action
(`ControlledDevice`).
"""

from __future__ import annotations

import logging
import random
import select
import socket
import struct
import threading
import time
from collections.abc import Iterable
from typing import Protocol

from edged.errors import ListenError
from edged.sim.gige import genicam as g
from edged.sim.gige.faults import Faults
from edged.sim.gige.registers import (
    ACCESS_DENIED,
    INVALID_PARAMETER,
    NOT_IMPLEMENTED,
    SUCCESS,
    CameraRegisters,
)

log = logging.getLogger(__name__)

GVCP_PORT = 3956
ACK_REQUIRED, EXTENDED_IDS, SCHEDULED = 0x01, 0x10, 0x80
DISCOVERY, FORCE_IP, PACKET_RESEND, ACTION = 0x0002, 0x0004, 0x0040, 0x0100
READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY = 0x0080, 0x0082, 0x0084, 0x0086
KNOWN = (READ_REGISTER, WRITE_REGISTER, READ_MEMORY, WRITE_MEMORY, PACKET_RESEND, ACTION)
BROADCAST = (DISCOVERY, FORCE_IP, ACTION)
EXCLUSIVE_ACCESS, CONTROL_ACCESS = 0x01, 0x02
POLL_S = 0.05
Endpoint = tuple[str, int]
SOMEBODY_ELSE: Endpoint = ("0.0.0.0", 0)
"""Endpoint that no datagram comes from."""


class ControlledDevice(Protocol):
    """Interface of the device behind the control channel."""

    def resend(self, block_id: int, first: int, last: int) -> None:
        """Handle a request to resend packets of a block."""

    def act(self, keys: tuple[int, int, int], at_ticks: int | None) -> int | None:
        """Handle an action command; returns its status, or None if it is for other devices."""

    def force_address(self, address: str) -> None:
        """Handle a FORCEIP command to another address; returns at once."""

    def session_ended(self) -> None:
        """Handle the end of a control session."""


class ControlChannel:
    """Answers commands on port 3956 of one address, and broadcast commands, in its own thread."""

    def __init__(
        self,
        address: str,
        registers: CameraRegisters,
        device: ControlledDevice,
        faults: Faults,
        chance: random.Random,
    ) -> None:
        self._address, self._registers, self._device = address, registers, device
        self._faults, self._chance = faults, chance
        self._controller: Endpoint | None = None
        self._heard_s = 0.0
        self._last_answer: tuple[Endpoint, int, bytes] | None = None
        self._silent_until_s = 0.0
        self._moves = False
        self._running = threading.Event()
        self._thread: threading.Thread | None = None
        self._socket: socket.socket | None = None
        self._broadcasts: list[socket.socket] = []

    def open(self) -> None:
        """Start listening. Raises `ListenError` if the port is taken."""
        try:
            self._socket = _bound(self._address)
        except OSError as error:
            raise ListenError(
                f"virtual camera {self._address}:{GVCP_PORT}: {error.strerror or error}"
            ) from error
        # all cameras of this machine receive broadcasts; if the machine forbids that, the camera is found by
        # its address only
        for address in ("255.255.255.255", _broadcast_of(self._address, self._registers.word(g.SUBNET_MASK))):
            try:
                self._broadcasts.append(_bound(address, shared=True))
            except OSError as error:
                log.info("virtual camera %s: does not hear %s: %s", self._address, address, error)
        self._running.set()
        self._thread = threading.Thread(target=self._serve, name=f"gvcp-{self._address}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening; safe to call twice."""
        self._running.clear()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        for opened in (self._socket, *self._broadcasts):
            if opened is not None:
                opened.close()
        self._socket = None
        self._broadcasts.clear()

    @property
    def controller(self) -> Endpoint | None:
        """The controlling client; None if there is none."""
        return self._controller

    def be_silent(self, seconds: float) -> None:
        """Ignore all commands for a while."""
        self._silent_until_s = time.monotonic() + seconds

    def end_session(self) -> None:
        """End the control session of the client."""
        self._controller = None
        self._last_answer = None
        self._registers.put(g.CONTROL_PRIVILEGE, 0)
        self._registers.put(g.STREAM_PORT, 0)
        self._device.session_ended()

    def seize(self) -> None:
        """Give control to another, fictitious host until `end_session`."""
        self.end_session()
        self._registers.put(g.CONTROL_PRIVILEGE, CONTROL_ACCESS)
        self._controller = SOMEBODY_ELSE

    # --- handling of datagrams -------------------------------------------------------------------

    def _serve(self) -> None:
        while self._running.is_set():
            self._watch_heartbeat()
            opened = [port for port in (*self._broadcasts, self._socket) if port is not None]
            ready, _, _ = select.select(opened, (), (), POLL_S)
            for heard in ready:
                try:
                    data, sender = heard.recvfrom(2048)
                except (TimeoutError, BlockingIOError):
                    continue
                except OSError:  # an ICMP "port unreachable" from a client that is gone
                    continue
                if not self._faults.unplugged and time.monotonic() >= self._silent_until_s:
                    self._hear(data, sender, broadcast=heard is not self._socket)

    def _watch_heartbeat(self) -> None:
        if self._controller in (None, SOMEBODY_ELSE):
            return
        silent_s = time.monotonic() - self._heard_s
        if silent_s * 1000 > self._registers.word(g.HEARTBEAT_MS):
            log.info(
                "virtual camera %s: controller silent for %.1f s, control released", self._address, silent_s
            )
            self.end_session()

    def _hear(self, data: bytes, sender: Endpoint, *, broadcast: bool) -> None:
        if len(data) < 8 or data[0] != 0x42:
            return
        _, flags, command, length, request = struct.unpack(">BBHHH", data[:8])
        body = data[8:]
        if len(body) != length or request == 0 or (broadcast and command not in BROADCAST):
            return
        if sender == self._controller:
            self._heard_s = time.monotonic()
        if self._last_answer is not None and self._last_answer[:2] == (sender, request):
            # the answer was lost: repeat the answer, but not the command
            self._say(self._last_answer[2], sender)
            return
        result = self._execute(command, flags, body, sender)
        if flags & ACK_REQUIRED and command != PACKET_RESEND and result is not None:
            status, answer = result
            message = struct.pack(">HHHH", status, command + 1, len(answer), request) + answer
            self._last_answer = (sender, request, message)
            self._say(message, sender)

    def _say(self, message: bytes, to: Endpoint) -> None:
        if self._faults.answer_delay_s > 0:
            time.sleep(self._faults.answer_delay_s)
        if self._socket is None:
            return
        if self._faults.answer_loss > 0 and self._chance.random() < self._faults.answer_loss:
            return
        try:
            self._socket.sendto(message, to)
        except OSError as error:
            log.debug("virtual camera %s: answer not sent: %s", self._address, error)

    def _execute(self, command: int, flags: int, body: bytes, sender: Endpoint) -> tuple[int, bytes] | None:
        """(status, body) of the answer, or None for no answer."""
        registers = self._registers
        if command == DISCOVERY:
            words = (registers.word(address) for address in range(0, g.DISCOVERY_BYTES, 4))
            return SUCCESS, b"".join(word.to_bytes(4, "big") for word in words)
        if command == FORCE_IP and len(body) == 56:
            return self._force_ip(body)
        if command == READ_REGISTER and body and len(body) % 4 == 0:
            return self._read_registers(body)
        if command == WRITE_REGISTER and body and len(body) % 8 == 0:
            return self._write_all(struct.iter_unpack(">II", body), sender, unit=1)
        if command == READ_MEMORY and len(body) == 8:
            address, _, count = struct.unpack(">IHH", body)
            content = registers.read(address, count)
            return (content, b"") if isinstance(content, int) else (SUCCESS, body[:4] + content)
        if command == WRITE_MEMORY and len(body) >= 8 and len(body) % 4 == 0:
            start, *content_words = struct.unpack(f">{len(body) // 4}I", body)
            listed = [(start + 4 * index, word) for index, word in enumerate(content_words)]
            return self._write_all(listed, sender, unit=4)
        if command == PACKET_RESEND and len(body) >= 12:
            _, block_id, first, last = struct.unpack(">HHII", body[:12])
            if flags & EXTENDED_IDS and len(body) >= 20:
                (block_id,) = struct.unpack(">Q", body[12:20])
            mask = 0xFFFF_FFFF if flags & EXTENDED_IDS else 0xFF_FFFF
            self._device.resend(block_id, first & mask, last & mask)
            return SUCCESS, b""
        if command == ACTION and len(body) == (20 if flags & SCHEDULED else 12):
            device_key, group_key, mask = struct.unpack(">III", body[:12])
            at_ticks = int.from_bytes(body[12:], "big") if flags & SCHEDULED else None
            status = self._device.act((device_key, group_key, mask), at_ticks)
            return None if status is None else (status, b"")
        return (INVALID_PARAMETER if command in KNOWN else NOT_IMPLEMENTED), b""

    def _force_ip(self, body: bytes) -> tuple[int, bytes] | None:
        """Handle FORCEIP: only for this camera's MAC address, and refused while it is controlled."""
        high, low = struct.unpack(">HI", body[2:8])
        if (high, low) != (self._registers.word(g.MAC_HIGH), self._registers.word(g.MAC_LOW)):
            return None
        if self._controller is not None:
            return ACCESS_DENIED, b""
        if not self._moves:  # the command arrives on two broadcast addresses
            self._moves = True
            self._device.force_address(socket.inet_ntoa(body[20:24]))
        return SUCCESS, b""

    def _read_registers(self, body: bytes) -> tuple[int, bytes]:
        content = b""
        for (address,) in struct.iter_unpack(">I", body):
            value = self._registers.read(address, 4)
            if isinstance(value, int):
                return value, b""
            content += value
        return SUCCESS, content

    def _write_all(self, pairs: Iterable[tuple[int, ...]], sender: Endpoint, unit: int) -> tuple[int, bytes]:
        """Write (address, word) pairs until one fails; the answer states the number done times `unit`."""
        done = 0
        for address, word in pairs:
            status = self._write(address, word, sender)
            if status != SUCCESS:
                return status, struct.pack(">HH", 0, done)
            done += unit
        return SUCCESS, struct.pack(">HH", 0, done)

    def _write(self, address: int, word: int, sender: Endpoint) -> int:
        if address == g.CONTROL_PRIVILEGE:
            return self._take_control(word, sender)
        if self._controller != sender:
            return ACCESS_DENIED
        return self._registers.write(address, word)

    def _take_control(self, word: int, sender: Endpoint) -> int:
        if self._controller not in (None, sender):
            return ACCESS_DENIED
        if not word & (CONTROL_ACCESS | EXCLUSIVE_ACCESS):
            self.end_session()
            return SUCCESS
        self._registers.put(g.CONTROL_PRIVILEGE, word)
        self._controller = sender
        self._heard_s = time.monotonic()
        return SUCCESS


def _bound(address: str, *, shared: bool = False) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if shared:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((address, GVCP_PORT))
        opened.settimeout(0.0 if shared else POLL_S)
    except OSError:
        opened.close()
        raise
    return opened


def _broadcast_of(address: str, mask: int) -> str:
    number = int.from_bytes(socket.inet_aton(address), "big") | ~mask & 0xFFFF_FFFF
    return socket.inet_ntoa(number.to_bytes(4, "big"))
