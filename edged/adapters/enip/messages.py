"""Messages of EtherNet/IP and CIP as bytes: encapsulation, common packets, paths, requests, replies. Pure.

Sources: ODVA, "EtherNet/IP Adaptation of CIP" (volume 2): encapsulation, common packet format; "Common
Industrial Protocol" (volume 1): requests and replies, general status, paths. All numbers are little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

HEADER = struct.Struct("<HHII8sI")
"""Encapsulation header: command, length of the data, session, status, context, options."""
NOP, LIST_SERVICES, LIST_IDENTITY, LIST_INTERFACES = 0x00, 0x04, 0x63, 0x64
REGISTER_SESSION, UNREGISTER_SESSION, SEND_RR_DATA, SEND_UNIT_DATA = 0x65, 0x66, 0x6F, 0x70
OK, INVALID_COMMAND, INCORRECT_DATA, INVALID_SESSION = 0x00, 0x01, 0x03, 0x64
INVALID_LENGTH, UNSUPPORTED_VERSION = 0x65, 0x69
"""Encapsulation status codes."""
NULL_ADDRESS, IDENTITY_ITEM, SERVICES_ITEM, CONNECTED_ADDRESS = 0x0000, 0x000C, 0x0100, 0x00A1
CONNECTED_DATA, UNCONNECTED_DATA, SOCKET_TO_ORIGINATOR, SEQUENCED_ADDRESS = 0x00B1, 0x00B2, 0x8001, 0x8002
MOST_ITEMS = 8
REPLY = 0x80

SUCCESS, CONNECTION_FAILURE, PATH_SEGMENT, PATH_UNKNOWN, NO_SERVICE = 0x00, 0x01, 0x04, 0x05, 0x08
NOT_SETTABLE, NO_ATTRIBUTE = 0x0E, 0x14
"""CIP general status codes."""

CLASS, INSTANCE, POINT, ATTRIBUTE = "class", "instance", "point", "attribute"
LOGICAL = {0: CLASS, 1: INSTANCE, 3: POINT, 4: ATTRIBUTE}
"""Logical segment types, bits 4 to 2; of the others 2 is a member, 5 special, 6 a service."""


class BadMessage(ValueError):
    """Bytes that are not a valid message; anyone on the network may send such."""


@dataclass(frozen=True, slots=True)
class Encapsulated:
    """An encapsulation message. context : repeated in the reply."""

    command: int
    data: bytes = b""
    session: int = 0
    status: int = OK
    context: bytes = bytes(8)
    options: int = 0

    def packed(self) -> bytes:
        """Encode it."""
        head = (self.command, len(self.data), self.session, self.status, self.context, self.options)
        return HEADER.pack(*head) + self.data

    def answered(self, data: bytes = b"", status: int = OK, session: int | None = None) -> Encapsulated:
        """Return the reply to it; it keeps command, context and, by default, session."""
        number = self.session if session is None else session
        return Encapsulated(self.command, data, number, status, self.context)


def unpacked(data: bytes) -> Encapsulated:
    """Decode one whole message. Raises `BadMessage`."""
    if len(data) < HEADER.size:
        raise BadMessage("shorter than its header")
    command, length, session, status, context, options = HEADER.unpack_from(data)
    if length != len(data) - HEADER.size:
        raise BadMessage("another length than its header says")
    return Encapsulated(command, data[HEADER.size :], session, status, context, options)


def packed_items(*items: tuple[int, bytes]) -> bytes:
    """Encode a common packet: number of items, then type, length and data of each."""
    parts = (struct.pack("<HH", kind, len(data)) + data for kind, data in items)
    return struct.pack("<H", len(items)) + b"".join(parts)


def items_of(data: bytes) -> list[tuple[int, bytes]]:
    """Decode a common packet: type and data of each item. Raises `BadMessage`."""
    if len(data) < 2 or (count := int.from_bytes(data[:2], "little")) > MOST_ITEMS:
        raise BadMessage("no items, or too many")
    found, at = list[tuple[int, bytes]](), 2
    for _ in range(count):
        if at + 4 > len(data):
            raise BadMessage("an item is missing")
        kind, length = struct.unpack_from("<HH", data, at)
        at += 4 + length
        if at > len(data):
            raise BadMessage("an item is cut off")
        found.append((kind, data[at - length : at]))
    return found


@dataclass(slots=True)
class CipPath:
    """Segments of a path. numbers : by kind of logical segment, in order. key : electronic key.

    data : of simple data segments.
    """

    numbers: dict[str, list[int]] = field(default_factory=dict)
    key: bytes = b""
    data: bytes = b""

    def number(self, kind: str) -> int | None:
        """Number of the only segment of a kind; None without one. Raises `BadMessage` for several."""
        found = self.numbers.get(kind, [])
        if len(found) > 1:
            raise BadMessage(f"{len(found)} segments for one {kind}")
        return found[0] if found else None


def path_of(data: bytes) -> CipPath:
    """Decode a padded path. Raises `BadMessage` for an unsupported or truncated segment."""
    path, at = CipPath(), 0
    while at < len(data):
        first = data[at]
        if first == 0x34:  # electronic key, format 4: vendor, type, product, revision
            if data[at + 1 : at + 2] != b"\x04":
                raise BadMessage("an electronic key of another format")
            path.key, at = data[at + 2 : at + 10], at + 10
        elif first == 0x80:  # simple data: number of words, then the words
            end = at + 2 + 2 * (data[at + 1] if at + 1 < len(data) else 0)
            path.data, at = path.data + data[at + 2 : end], max(end, at + 2)
        elif first == 0x43:  # network segment: production inhibit time, unused by a cyclic connection
            at += 2
        elif first >> 5 == 1 and (kind := LOGICAL.get(first >> 2 & 7)) is not None and first & 3 < 3:
            size = 1 << (first & 3)
            start = at + 1 if size == 1 else at + 2  # a pad byte before 16 and 32 bits
            at = start + size
            path.numbers.setdefault(kind, []).append(int.from_bytes(data[start:at], "little"))
        else:
            raise BadMessage(f"a segment 0x{first:02X}")
        if at > len(data):
            raise BadMessage("a segment is cut off")
    return path


@dataclass(frozen=True, slots=True)
class CipRequest:
    """A request to an object."""

    service: int
    path: CipPath
    data: bytes


def request_of(data: bytes) -> CipRequest:
    """Decode a request: service, path and data. Raises `BadMessage`."""
    if len(data) < 2 or len(data) < (start := 2 + 2 * data[1]):
        raise BadMessage("a request is cut off")
    return CipRequest(data[0], path_of(data[2:start]), data[start:])


def reply_to(service: int, data: bytes = b"", status: int = SUCCESS, extended: int | None = None) -> bytes:
    """Encode the reply of an object. extended : extended status."""
    more = b"" if extended is None else extended.to_bytes(2, "little")
    return bytes((service | REPLY, 0, status, len(more) // 2)) + more + data
