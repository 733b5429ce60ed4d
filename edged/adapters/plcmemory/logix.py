"""A structured tag of a Rockwell Logix controller, read and written by unconnected messages of EtherNet/IP.

pycomm3 and pylogix are not used: both read forever, at full load, from a controller that closes the
connection within an answer, and neither writes a structure whose definition it has not read before.

Sources: ODVA, "EtherNet/IP Adaptation of CIP" (volume 2), 2-3 to 2-4: encapsulation, RegisterSession 0x65,
SendRRData 0x6F, items 0x0000 and 0x00B2, all of them little-endian; "Common Industrial Protocol" (volume 1),
3-5.5.4, Unconnected Send, and appendix B-1, general status; Rockwell 1756-PM020, "Logix 5000 Controllers Data
Access", Read Tag 0x4C, Write Tag 0x4D, symbolic segments, structures of type 0x02A0 with their handle.
"""

from __future__ import annotations

import socket
import struct
import time

from edged.config.plc import LogixSection
from edged.errors import PlcFault
from edged.plc.processimage import FROM_CELL_BYTES, TO_CELL_BYTES

REGISTER_SESSION, SEND_RR_DATA = 0x65, 0x6F
HEADER = struct.Struct("<HHII8sI")
"""Encapsulation header: command, length of the data, session, status, context, options."""
MAX_FRAME = 1024
"""Longest data accepted in an answer; valid ones are shorter."""
READ_TAG, WRITE_TAG, UNCONNECTED_SEND, REPLY = 0x4C, 0x4D, 0x52, 0x80
SEND_WITHIN = b"\x07\x08"
"""Time-out of an Unconnected Send over the backplane: 8 ticks of 2^7 ms."""
STRUCTURE = 0x02A0
ELEMENTS = {0xC2: 1, 0xC3: 2, 0xC4: 4}
"""Bytes per element of SINT, INT and DINT, for an array in place of the structure."""
STATUS = {
    0x01: "no way to the controller: its slot",
    0x02: "it has no resources left",
    0x04: "no tag of that name that others may reach (External Access)",
    0x05: "no tag of that name that others may reach (External Access)",
    0x06: "the tag is too long",
    0x08: "it knows no tags",
    0x0F: "it may not be written (External Access)",
    0x13: "the tag is shorter",
    0xFF: "another type, or fewer elements",
}
"""Messages by CIP general status."""


class LogixMemory:
    """See `exchange.PlcMemory`."""

    is_little = True

    def __init__(self, host: str, section: LogixSection, answer_s: float) -> None:
        self._host, self._section, self._answer_s = host, section, answer_s
        self.line: socket.socket | None = None
        self._session = self._asked = 0
        self._types = {"ToCell": (b"", 0), "FromCell": (b"", 0)}  # type as encoded, number of elements

    def open(self) -> None:
        """Connect, and determine the types of both members."""
        place = f"{self._host}:{self._section.port}"
        try:
            self.line = socket.create_connection((self._host, self._section.port), self._answer_s)
        except OSError as error:
            raise PlcFault(f"{place}: {error}", "connect") from error
        self.line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._ask(REGISTER_SESSION, struct.pack("<HH", 1, 0))
        for member, size in (("ToCell", TO_CELL_BYTES), ("FromCell", FROM_CELL_BYTES)):
            answer = self._tag(READ_TAG, member, struct.pack("<H", 1))
            (kind,) = struct.unpack_from("<H", answer)
            if kind == STRUCTURE:
                self._types[member] = answer[:4], 1
            elif kind in ELEMENTS:
                self._types[member] = answer[:2], size // ELEMENTS[kind]
            else:
                raise PlcFault(
                    f"{self._named(member)} is of type 0x{kind:04X}; expected the structure of "
                    "`edged registers --format l5x`, or an array of SINT, INT or DINT",
                    "type",
                )
            self._read(member, size)

    def read(self) -> bytes:
        """Read the image to the cell in one message."""
        return self._read("ToCell", TO_CELL_BYTES)

    def write(self, image: bytes) -> None:
        """Write the image from the cell in one message."""
        kind, elements = self._types["FromCell"]
        self._tag(WRITE_TAG, "FromCell", kind + struct.pack("<H", elements) + image)

    def close(self) -> None:
        """Disconnect, which also ends the session."""
        if self.line is not None:
            self.line.close()

    def _named(self, member: str) -> str:
        return f"{self._host}, tag {self._section.tag}.{member}"

    def _read(self, member: str, size: int) -> bytes:
        kind, elements = self._types[member]
        answer = self._tag(READ_TAG, member, struct.pack("<H", elements))
        data = answer[len(kind) :]
        if answer[: len(kind)] != kind or len(data) != size:
            raise PlcFault(f"{self._named(member)} has {len(data)} bytes; expected {size}", "read")
        return data

    def _tag(self, service: int, member: str, data: bytes) -> bytes:
        """Send a request to a member of the tag, over the backplane if there is a slot; return the data."""
        path = b""
        for name in (*self._section.tag.split("."), member):
            symbol = name.encode("ascii")
            path += bytes((0x91, len(symbol))) + symbol + bytes(len(symbol) % 2)
        request = bytes((service, len(path) // 2)) + path + data
        slot = self._section.slot
        if slot is not None:
            message = SEND_WITHIN + struct.pack("<H", len(request)) + request + bytes(len(request) % 2)
            request = bytes((UNCONNECTED_SEND, 2, 0x20, 0x06, 0x24, 0x01)) + message + bytes((1, 0, 1, slot))
        items = struct.pack("<IHHHHHH", 0, 0, 2, 0, 0, 0xB2, len(request)) + request
        answer = self._ask(SEND_RR_DATA, items)
        if len(answer) < 20 or struct.unpack_from("<HHHH", answer, 6) != (2, 0, 0, 0xB2):
            raise PlcFault(f"{self._named(member)}: an answer that is none", "garbage")
        replied, _, status, words = struct.unpack_from("<BBBB", answer, 16)
        if status:
            why = STATUS.get(status, "see CIP, general status")
            more = answer[20 : 20 + 2 * words].hex()
            raise PlcFault(f"{self._named(member)}: status 0x{status:02X} {more}: {why}", "refused")
        if replied != service | REPLY:
            raise PlcFault(f"{self._named(member)}: an answer to something else", "garbage")
        return answer[20 + 2 * words :]

    def _ask(self, command: int, data: bytes) -> bytes:
        """Send a command, and return the data of its answer, which must be complete within `answer_s`."""
        end_s = time.monotonic() + self._answer_s
        self._asked += 1
        context = self._asked.to_bytes(8, "little")  # repeated in the answer, to detect a late one
        request = HEADER.pack(command, len(data), self._session, 0, context, 0) + data
        try:
            if self.line is None:
                raise OSError("closed")
            self.line.settimeout(self._answer_s)
            self.line.sendall(request)
            header = self._received(HEADER.size, end_s)
            replied, length, session, status, returned, _ = HEADER.unpack(header)
            if (replied, status, returned) != (command, 0, context) or length > MAX_FRAME:
                raise PlcFault(
                    f"{self._host}: no answer of EtherNet/IP to what was asked: command 0x{replied:04X}, "
                    f"status {status}, {length} bytes",
                    "garbage",
                )
            self._session = session
            return self._received(length, end_s)
        except OSError as error:
            raise PlcFault(f"{self._host}: {error}", "line") from error

    def _received(self, size: int, end_s: float) -> bytes:
        data = b""
        while len(data) < size:
            left_s = end_s - time.monotonic()
            if self.line is None or left_s <= 0:
                raise TimeoutError("no whole answer in time")
            self.line.settimeout(left_s)
            part = self.line.recv(size - len(data))
            if not part:
                raise ConnectionError("it hung up within an answer")
            data += part
        return data
