"""The Modbus/TCP server of the cell.

PDUs and framing are pymodbus's; connections, limits, exceptions and the cell protocol are ours,
because pymodbus's own server drops pipelined requests, answers damaged PDUs with function 0x80
and stays stuck on a wrong protocol id. Each request is answered from one register image that is made
at that moment and changed by nobody.

Not responsible for: what the registers mean (`edged.registers`) and when a result is valid
(`edged.handshake`).
"""

from __future__ import annotations

import asyncio
import errno
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)

from edged.domain import CommandKind, Event, Snapshot
from edged.errors import CommandRefused, ListenError
from edged.handshake import Handshake
from edged.ports import Commander
from edged.registers import (
    COMMAND,
    MAGIC,
    MAP_VERSION,
    POSE_CONVENTION,
    SCHEMA,
    WORDS,
    WRITABLE,
    fingerprint_id,
    text_id,
    write,
)

log = logging.getLogger(__name__)

SOURCE = "modbus"
MAX_PDU = 253
IDLE_S = 120.0
"""A client that says nothing for so long has gone; PLCs poll several times a second."""
FUNCTIONS = (3, 4, 6, 16, 23)


@dataclass(frozen=True, slots=True)
class ModbusSettings:
    """Where to listen and how the map is laid out."""

    host: str = "127.0.0.1"
    port: int = 1502
    unit_id: int = 1
    word_order: Literal["high", "low"] = "high"
    base_address: int = 0
    validity_s: float = 2.0
    max_clients: int = 16


class ModbusPublisher:
    """Serves one cell's registers (`edged.ports.Publisher`) and hands its commands in."""

    def __init__(
        self,
        settings: ModbusSettings,
        commander: Commander,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._settings = settings
        self._commander = commander
        self._now_s = monotonic_s
        self._handshake = Handshake(settings.validity_s)
        self._written = dict.fromkeys(WRITABLE, 0)
        self._identity = ("", "", 0)
        self._server: asyncio.Server | None = None
        self._clients: set[_Connection] = set()
        self._addresses = {r.address + i for r in SCHEMA for i in range(WORDS[r.kind])}

    # --- Publisher ---------------------------------------------------------------------------

    async def start(self) -> None:
        """Listen. Raises `ListenError` with what to do when the port cannot be had."""
        host, port = self._settings.host, self._settings.port
        try:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(lambda: _Connection(self), host, port)
        except OSError as error:
            advice = {
                errno.EADDRINUSE: "another program listens there; choose another modbus.port, or stop it",
                errno.EACCES: "ports below 1024 need CAP_NET_BIND_SERVICE; choose one above, such as 1502",
                errno.EADDRNOTAVAIL: "this machine has no such address; 0.0.0.0 listens on all",
            }.get(error.errno or 0, str(error))
            raise ListenError(
                f"modbus.host, modbus.port: cannot listen on {host}:{port}: {advice}"
            ) from error

    def announce(self, event: Event) -> None:
        """Take note of an event."""
        if isinstance(event, Snapshot):
            self._identity = (event.fingerprint, event.calibration_id, int(event.robot_from_rig is not None))
        self._handshake.tell(event, SOURCE, self._now_s())

    async def close(self) -> None:
        """Stop listening and drop every client."""
        server, self._server = self._server, None
        if server is None:
            return
        server.close()
        for client in tuple(self._clients):
            client.abort()
        await server.wait_closed()
        await asyncio.sleep(0)  # the transports' connection_lost callbacks

    # --- requests ----------------------------------------------------------------------------

    def image(self) -> dict[int, int]:
        """Every register at this moment: {address: word}."""
        low_first = self._settings.word_order == "low"
        image = dict.fromkeys(self._addresses, 0)
        fingerprint, calibration, robot_frame = self._identity
        write(
            image,
            {
                "MAGIC": MAGIC,
                "MAP_VERSION": MAP_VERSION,
                "PROBE_U32": 0x01020304,
                "PROBE_F32": 123.456,
                "POSE_CONVENTION": POSE_CONVENTION,
                "LENGTH_UNIT": 1,
                "ANGLE_UNIT": 1,
                "FRAME": robot_frame,
                "CONFIG_FINGERPRINT": fingerprint_id(fingerprint) if fingerprint else 0,
                "CALIBRATION_ID": text_id(calibration) if calibration else 0,
            },
            low_first=low_first,
        )
        image.update(self._written)
        write(image, self._handshake.values(self._now_s(), len(self._clients)), low_first=low_first)
        return image

    def answer(self, request: ModbusPDU) -> ModbusPDU:
        """Carry out one request; the answer may be an exception."""
        function = request.function_code
        if isinstance(request, ReadWriteMultipleRegistersRequest):
            if (
                request.write_byte_count != 2 * request.write_count
                or len(request.write_registers) != request.write_count
            ):
                return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
            if not (1 <= request.write_count <= 121 and 1 <= request.read_count <= 125):
                return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
            read = self._read(request.read_address, request.read_count)
            if read is None or not self._write(request.write_address, list(request.write_registers)):
                return ExceptionResponse(function, ExcCodes.ILLEGAL_ADDRESS)
            registers = self._read(request.read_address, request.read_count)
            return ReadWriteMultipleRegistersResponse(registers=registers)
        if isinstance(request, ReadHoldingRegistersRequest):
            registers = self._read(request.address, request.count)
            if registers is None:
                return ExceptionResponse(function, ExcCodes.ILLEGAL_ADDRESS)
            kind = ReadHoldingRegistersResponse if function == 3 else ReadInputRegistersResponse
            return kind(registers=registers)
        if isinstance(request, WriteSingleRegisterRequest):
            if not self._write(request.address, list(request.registers)):
                return ExceptionResponse(function, ExcCodes.ILLEGAL_ADDRESS)
            return WriteSingleRegisterResponse(address=request.address, registers=request.registers)
        if isinstance(request, WriteMultipleRegistersRequest):
            if not 1 <= request.count <= 123 or len(request.registers) != request.count:
                return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
            if not self._write(request.address, list(request.registers)):
                return ExceptionResponse(function, ExcCodes.ILLEGAL_ADDRESS)
            return WriteMultipleRegistersResponse(address=request.address, count=request.count)
        return ExceptionResponse(function, ExcCodes.ILLEGAL_FUNCTION)

    def _read(self, address: int, count: int) -> list[int] | None:
        first = address - self._settings.base_address
        if any(first + i not in self._addresses for i in range(count)):
            return None
        image = self.image()
        return [image[first + i] for i in range(count)]

    def _write(self, address: int, registers: list[int]) -> bool:
        first = address - self._settings.base_address
        if any(first + i not in WRITABLE for i in range(len(registers))):
            return False
        before = dict(self._written)
        for offset, word in enumerate(registers):
            self._written[first + offset] = word
        names = {register.name: register.address for register in COMMAND}
        ack, seq = names["ACK_SEQ"], names["CMD_SEQ"]
        if self._written[ack] != before[ack]:
            self._handshake.acknowledge(self._written[ack])
        if self._written[seq] != before[seq]:
            self._execute(self._written[names["COMMAND"]], self._written[names["JOB"]], self._written[seq])
        return True

    def _execute(self, kind: int, job: int, sequence: int) -> None:
        command = self._handshake.command(kind, job, sequence, SOURCE)
        if command is None:
            log.warning("command %d with sequence %d refused: unknown, or one is under way", kind, sequence)
            return
        try:
            self._commander.submit(command)
        except CommandRefused as error:
            log.warning("command %s with sequence %d refused: %s", CommandKind(kind).name, sequence, error)
            self._handshake.withdraw()

    # --- connections -------------------------------------------------------------------------

    def admit(self, connection: _Connection) -> bool:
        """Count a client in, unless there are too many."""
        if len(self._clients) >= self._settings.max_clients:
            return False
        self._clients.add(connection)
        return True

    def dismiss(self, connection: _Connection) -> None:
        """Count a client out."""
        self._clients.discard(connection)

    @property
    def unit_id(self) -> int:
        """The unit that is answered; others are not here."""
        return self._settings.unit_id


class _Connection(asyncio.Protocol):
    """One client. What is not Modbus/TCP ends the connection; what cannot be answered is an exception."""

    def __init__(self, server: ModbusPublisher) -> None:
        self._server = server
        self._framer = FramerSocket(DecodePDU(is_server=True))
        self._buffer = bytearray()
        self._transport: asyncio.Transport | None = None
        self._idle: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101  (the type of a TCP server's transport)
        self._transport = transport
        if not self._server.admit(self):
            transport.abort()
            return
        self._touch()

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.dismiss(self)
        if self._idle is not None:
            self._idle.cancel()

    def pause_writing(self) -> None:
        if self._transport is not None:  # a client that asks and does not read: do not hear its questions
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()
            self._serve()

    def data_received(self, data: bytes) -> None:
        self._touch()
        self._buffer += data
        self._serve()

    def abort(self) -> None:
        """Drop the connection at once."""
        if self._transport is not None:
            self._transport.abort()

    def _touch(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
        self._idle = asyncio.get_running_loop().call_later(IDLE_S, self.abort)

    def _serve(self) -> None:
        """Answer every whole request in the buffer, in order."""
        transport = self._transport
        while transport is not None and not transport.is_closing() and len(self._buffer) >= 8:
            protocol, length = (
                int.from_bytes(self._buffer[2:4], "big"),
                int.from_bytes(self._buffer[4:6], "big"),
            )
            if protocol != 0 or not 2 <= length <= MAX_PDU + 1:
                transport.abort()  # framing is lost: there is no way to find the next request
                return
            if len(self._buffer) < 6 + length:
                return
            frame = bytes(self._buffer[: 6 + length])
            del self._buffer[: 6 + length]
            transport.write(self._reply(frame))

    def _reply(self, frame: bytes) -> bytes:
        transaction, unit, function = int.from_bytes(frame[:2], "big"), frame[6], frame[7]
        response: ModbusPDU
        if unit not in (self._server.unit_id, 0, 255):  # 0 and 255: "the device at this address"
            response = ExceptionResponse(function & 0x7F, ExcCodes.GATEWAY_NO_RESPONSE)
        elif function not in FUNCTIONS:
            response = ExceptionResponse(function & 0x7F, ExcCodes.ILLEGAL_FUNCTION)
        else:
            request = self._framer.decoder.decode(frame[7:]) if _is_whole(frame[7:]) else None
            response = (
                ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
                if request is None
                else self._server.answer(request)
            )
        response.dev_id, response.transaction_id = unit, transaction
        return self._framer.buildFrame(response)


def _is_whole(pdu: bytes) -> bool:
    """Whether a request has the length its function and byte count say; pymodbus's decoder does not look."""
    function = pdu[0]
    if function in (3, 4, 6):
        return len(pdu) == 5
    if function == 16:
        return len(pdu) >= 6 and len(pdu) == 6 + pdu[5]
    return len(pdu) >= 10 and len(pdu) == 10 + pdu[9]
