"""Modbus RTU on a serial line, as one slave among others.

A frame ends with a silence. Requests to other slaves, and their answers, are ignored, also when the operating
system delivers several frames at once. A broadcast (unit 0) is carried out and not answered. When the adapter
is unplugged, reopening the line is tried until it is back; the daemon does not stop.
"""

from __future__ import annotations

import asyncio
import logging
import os
import termios

import serial
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU

from edged.adapters.modbus.cell import CellRegisters, ClientView
from edged.adapters.modbus.pdu import respond
from edged.adapters.modbus.settings import SerialSettings
from edged.cell.tasks import bounded
from edged.errors import ListenError
from edged.logs import LogLimit
from edged.plc.registers import CRC_START, crc16

log = logging.getLogger(__name__)

OPEN_ERRORS = (OSError, ValueError, termios.error)
"""Errors of opening a line; a re-enumerating adapter gives `termios.error`, which is not an `OSError`."""

OPEN_S = 5.0
"""Time limit for setting up an adapter; Linux allows 5 s per request (USB_CTRL_SET_TIMEOUT, linux/usb.h)."""
MAX_FRAME_BYTES = 256
MIN_FRAME_BYTES = 4
BROADCAST = 0
PUBLIC_FUNCTIONS = {*range(1, 25), 43}  # "MODBUS Application Protocol V1.1b3", section 5.1
PARITY = {"even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD, "none": serial.PARITY_NONE}


def split_frames(data: bytes) -> list[bytes]:
    """Split the bytes between two silences into frames with a good CRC; the rest is dropped.

    Mostly it is one frame. A busy machine can deliver a request to another slave, the answer and the next
    request in one piece: the CRC over a frame including its checksum is 0, which shows its end.
    """
    if MIN_FRAME_BYTES <= len(data) <= MAX_FRAME_BYTES and crc16(data) == 0:
        return [data]
    frames: list[bytes] = []
    start = 0
    while start + MIN_FRAME_BYTES <= len(data):
        # noise must not cost more than a few ms: most of it is not a function code
        end = _frame_end(data, start) if data[start + 1] & 0x7F in PUBLIC_FUNCTIONS else None
        if end is None:
            start += 1
        else:
            frames.append(data[start:end])
            start = end
    return frames


def _frame_end(data: bytes, start: int) -> int | None:
    """End of the shortest frame that begins at `start`; None if none has a good CRC."""
    crc = CRC_START
    for end in range(start + 1, min(len(data), start + MAX_FRAME_BYTES) + 1):
        crc = crc16(data[end - 1 : end], crc)
        if crc == 0 and end - start >= MIN_FRAME_BYTES:
            return end
    return None


class RtuServer:
    """One serial line."""

    def __init__(self, settings: SerialSettings, unit_id: int, cell: CellRegisters, client: int) -> None:
        self._settings = settings
        self._unit_id = unit_id
        self._cell = cell
        self._client = client
        self._view = ClientView(cell, client)
        self._framer = FramerRTU(DecodePDU(is_server=True))
        self._losses = LogLimit(__name__)
        self._line: serial.Serial | None = None
        self._input = bytearray()
        self._output = bytearray()
        self._timer: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Open the line. Raises `ListenError`; a line that is lost later is reopened automatically."""
        what = f"modbus: opening {self._settings.device}"
        try:
            self._take(await bounded(self._opened, OPEN_S, what, lambda line: line.close()))
        except OPEN_ERRORS as error:
            raise ListenError(
                f"modbus: cannot open {self._settings.device}: {error}; is it plugged in, and is the "
                "daemon's user in the group dialout?"
            ) from error

    def close(self) -> None:
        """Close the line."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._drop_line()

    def _opened(self) -> serial.Serial:
        settings = self._settings
        # exclusive: a second program would steal bytes from the line
        return serial.Serial(
            settings.device,
            settings.baud,
            parity=PARITY[settings.parity],
            # without parity a second stop bit keeps the character at 11 bits
            stopbits=serial.STOPBITS_TWO if settings.parity == "none" else serial.STOPBITS_ONE,
            timeout=0,
            exclusive=True,
        )

    def _take(self, line: serial.Serial) -> None:
        self._line = line
        self._input.clear()
        self._output.clear()
        asyncio.get_running_loop().add_reader(line.fileno(), self._readable)

    def _drop_line(self) -> None:
        if self._line is None:
            return
        line, self._line = self._line, None
        loop = asyncio.get_running_loop()
        loop.remove_reader(line.fileno())
        loop.remove_writer(line.fileno())
        line.close()
        self._cell.client_disconnected(self._client)

    def _lost(self, why: str) -> None:
        self._losses.warning("modbus: %s is lost (%s), trying again", self._settings.device, why)
        if self._timer is not None:
            self._timer.cancel()
        self._drop_line()
        self._timer = asyncio.get_running_loop().call_later(self._settings.retry_s, self._reopen)

    def _reopen(self) -> None:
        try:
            self._take(self._opened())
        except OPEN_ERRORS:
            self._drop_line()
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(self._settings.retry_s, self._reopen)
        else:
            self._timer = None
            log.info("modbus: %s is back", self._settings.device)

    def _readable(self) -> None:
        if self._line is None:
            return
        try:
            data = os.read(self._line.fileno(), 4096)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not data:
            self._lost("end of file")
            return
        self._input += data
        # noise without a pause must not fill the memory; a request for us would be at the end
        del self._input[: -3 * MAX_FRAME_BYTES]
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(self._settings.silence_s, self._silence)

    def _silence(self) -> None:
        self._timer = None
        data = bytes(self._input)
        self._input.clear()
        frames = split_frames(data)
        for position, frame in enumerate(frames):
            is_last = position == len(frames) - 1
            if frame[0] == BROADCAST:
                respond(frame[1:-2], self._view, may_write=True)
            elif frame[0] == self._unit_id and is_last:
                # when the master sends another request, it has given up the earlier ones
                self._send(self._framer.encode(respond(frame[1:-2], self._view, may_write=True), frame[0], 0))

    def _send(self, data: bytes) -> None:
        self._output += data
        self._writable()

    def _writable(self) -> None:
        if self._line is None:
            return
        loop = asyncio.get_running_loop()
        try:
            sent = os.write(self._line.fileno(), self._output)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        del self._output[:sent]
        if self._output:
            loop.add_writer(self._line.fileno(), self._writable)
        else:
            loop.remove_writer(self._line.fileno())
