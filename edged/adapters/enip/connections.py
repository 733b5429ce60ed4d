"""The Connection Manager: opening and closing connections, and detecting lost ones. Pure: time is passed in.

Sources: ODVA, "Common Industrial Protocol" (volume 1): transports and triggers, Forward_Open and
Forward_Close, extended status, real time formats; "EtherNet/IP Adaptation of CIP" (volume 2): connected data
over UDP and its sequence numbers.
"""

from __future__ import annotations

import enum
import secrets
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from edged.adapters.enip import messages as msg
from edged.plc import ethernetip as device
from edged.plc.processimage import FROM_CELL_BYTES, TO_CELL_BYTES

OPEN, LARGE_OPEN = struct.Struct("<BBIIHHIB3xIHIHBB"), struct.Struct("<BBIIHHIB3xIIIIBB")
"""Forward_Open: two bytes of ticks, ids O->T and T->O, serial number of the connection, vendor and serial
number of the originator, multiplier, interval and parameters O->T and T->O, transport, words of the path that
follows."""
CLOSE = struct.Struct("<BBHHIBx")
POINT_TO_POINT = 2
CYCLIC_CLASS_1, CLASS_3, CLASS_MASK = 0x01, 0x03, 0x0F
"""Direction, trigger and class of a transport; for class 3 the trigger does not matter."""
FIRST_DATA_S = 10.0
"""Least time-out until the first data (volume 1, transports)."""
SEQUENCE, RUN_IDLE = 2, 4
"""Bytes before the data: the sequence count of class 1, and the run/idle header of the controller."""
MOST_EXPLICIT_BYTES = 504
"""Largest message to the cell over a class 3 connection; a Forward_Open that is not large permits 511."""
MESSAGE_ROUTER = 0x02


class Refusal(enum.IntEnum):
    """Extended status of a connection failure."""

    DUPLICATE = 0x0100
    TRANSPORT = 0x0103
    OWNED = 0x0106
    NOT_OPEN = 0x0107
    RPI = 0x0111
    NO_MORE = 0x0113
    WRONG_PRODUCT = 0x0114
    WRONG_TYPE = 0x0115
    WRONG_REVISION = 0x0116
    PATH = 0x0117
    TYPE_TO_CELL = 0x0123
    TYPE_FROM_CELL = 0x0124
    CONFIGURATION_SIZE = 0x0126
    SIZE_TO_CELL = 0x0127
    SIZE_FROM_CELL = 0x0128
    SEGMENT = 0x0315


class Purpose(enum.Enum):
    """Purpose of a connection."""

    OWNER = "writes and reads"
    INPUT = "reads"
    EXPLICIT = "messages"


@dataclass(frozen=True, slots=True)
class WantedConnection:
    """A Forward_Open request. connection_key : its serial number, the originator's vendor and serial number.

    to_id : connection id T->O. rpi_us, size, type : O->T and T->O.
    """

    to_id: int
    connection_key: tuple[int, int, int]
    multiplier: int
    rpi_us: tuple[int, int]  # O->T, T->O
    size: tuple[int, int]
    type: tuple[int, int]
    transport: int
    path: bytes


@dataclass(slots=True, eq=False)
class CipConnection:
    """An open connection. peer : address of its originator. port : UDP port for its inputs.

    is_running : the controller is in run mode, by the last outputs. seen : sequence number of the last
    outputs; None before the first. sent : number of datagrams sent. session : that it was opened in; an
    explicit connection ends with it. due_s : when it is lost without data.
    """

    purpose: Purpose
    wanted: WantedConnection
    id: int
    peer: str
    port: int
    session: int
    due_s: float
    is_running: bool = False
    seen: int | None = None
    sent: int = 0

    @property
    def period_s(self) -> float:
        """Period of sending inputs."""
        return self.wanted.rpi_us[1] / 1e6

    @property
    def timeout_s(self) -> float:
        """Time without outputs after which it is lost."""
        return self.wanted.rpi_us[0] / 1e6 * (4 << self.wanted.multiplier)

    def took(self, sequence: int, now_s: float) -> bool:
        """Whether outputs are newer than the last; if so, restart the time-out."""
        if self.seen is not None and not 0 < (sequence - self.seen) & 0xFFFFFFFF < 1 << 31:
            return False
        self.seen, self.due_s = sequence, now_s + self.timeout_s
        return True

    def inputs(self, image: bytes) -> bytes:
        """Make the next datagram to the originator."""
        self.sent += 1
        address = struct.pack("<II", self.wanted.to_id, self.sent & 0xFFFFFFFF)
        counted = struct.pack("<H", self.sent & 0xFFFF) + image
        return msg.packed_items((msg.SEQUENCED_ADDRESS, address), (msg.CONNECTED_DATA, counted))


class OpenRefused(Exception):
    """A connection cannot be opened or closed. why : extended status sent to the originator."""

    def __init__(self, why: Refusal) -> None:
        self.why = why
        super().__init__(why.name)


class Connections:
    """The open connections, by their id O->T."""

    def __init__(self) -> None:
        self.by_id: dict[int, CipConnection] = {}

    @property
    def owner(self) -> CipConnection | None:
        """The connection that writes outputs; None if there is none."""
        return next((found for found in self.by_id.values() if found.purpose is Purpose.OWNER), None)

    @property
    def of_data(self) -> Sequence[CipConnection]:
        """The connections that exchange inputs and outputs."""
        return [found for found in self.by_id.values() if found.purpose is not Purpose.EXPLICIT]

    def open(
        self, wanted: WantedConnection, peer: str, port: int, session: int, now_s: float
    ) -> CipConnection:
        """Open a connection. Raises `OpenRefused`."""
        if any(found.wanted.connection_key == wanted.connection_key for found in self.by_id.values()):
            raise OpenRefused(Refusal.DUPLICATE)
        kind = _kind(wanted)
        if kind is Purpose.OWNER and self.owner is not None:
            raise OpenRefused(Refusal.OWNED)
        readers = len(self.by_id) - (self.owner is not None)
        if kind is not Purpose.OWNER and readers >= device.MOST_CONNECTIONS - 1:
            raise OpenRefused(Refusal.NO_MORE)
        while (number := secrets.randbits(32)) in self.by_id or not number:
            pass  # random, so that outputs cannot be sent under a forged address
        made = CipConnection(kind, wanted, number, peer, port, session, 0.0)
        made.due_s = now_s + max(FIRST_DATA_S, made.timeout_s)
        self.by_id[number] = made
        return made

    def close(self, connection_key: tuple[int, int, int], peer: str) -> CipConnection:
        """Close a connection of this peer. Raises `OpenRefused`."""
        for found in self.by_id.values():
            if found.wanted.connection_key == connection_key and found.peer == peer:
                return self.by_id.pop(found.id)
        raise OpenRefused(Refusal.NOT_OPEN)

    def lost(self, now_s: float) -> list[CipConnection]:
        """Remove and return the connections that have timed out."""
        found = [connection for connection in self.by_id.values() if now_s >= connection.due_s]
        for connection in found:
            del self.by_id[connection.id]
        return found


def wanted_of(data: bytes, *, large: bool) -> WantedConnection:
    """Decode the data of a Forward_Open. large : of the Large_Forward_Open. Raises `BadMessage`."""
    form, shift = (LARGE_OPEN, 16) if large else (OPEN, 0)
    if len(data) < form.size:
        raise msg.BadMessage("a Forward_Open is cut off")
    _, _, _, to_id, serial, vendor, originator, multiplier, *rest = form.unpack_from(data)
    there_us, there, back_us, back, transport, words = rest
    path = data[form.size :]
    if len(path) != 2 * words:
        raise msg.BadMessage("a path of another length")
    most = 0xFFFF if large else 0x1FF
    return WantedConnection(
        to_id,
        (serial, vendor, originator),
        multiplier,
        (there_us, back_us),
        (there & most, back & most),
        (there >> 13 + shift & 3, back >> 13 + shift & 3),
        transport,
        path,
    )


def _kind(wanted: WantedConnection) -> Purpose:
    """Purpose of a wanted connection, after checking its parameters. Raises `OpenRefused`."""
    try:
        path = msg.path_of(wanted.path)
        numbers = path.numbers.get(msg.CLASS), path.numbers.get(msg.INSTANCE), path.numbers.get(msg.POINT)
    except msg.BadMessage as error:
        raise OpenRefused(Refusal.SEGMENT) from error
    _check_key(path.key)
    if wanted.multiplier > 7:
        raise OpenRefused(Refusal.RPI)
    to_cell, from_cell = wanted.size
    if wanted.transport & CLASS_MASK == CLASS_3:
        if numbers != ([MESSAGE_ROUTER], [1], None):
            raise OpenRefused(Refusal.PATH)
        kind, fits_to_cell, fits_from_cell = Purpose.EXPLICIT, to_cell <= MOST_EXPLICIT_BYTES, True
    elif wanted.transport != CYCLIC_CLASS_1:
        raise OpenRefused(Refusal.TRANSPORT)
    else:
        kind = _kind_of_points(numbers)
        is_owner = kind is Purpose.OWNER
        sizes = {SEQUENCE + RUN_IDLE + TO_CELL_BYTES} if is_owner else {0, SEQUENCE, SEQUENCE + RUN_IDLE}
        fits_to_cell, fits_from_cell = to_cell in sizes, from_cell == SEQUENCE + FROM_CELL_BYTES
        if not all(device.LEAST_RPI_US <= rpi_us <= device.MOST_RPI_US for rpi_us in wanted.rpi_us):
            raise OpenRefused(Refusal.RPI)
    refusals = (
        (Refusal.CONFIGURATION_SIZE, not any(path.data)),
        (Refusal.TYPE_TO_CELL, wanted.type[0] == POINT_TO_POINT),
        (Refusal.TYPE_FROM_CELL, wanted.type[1] == POINT_TO_POINT),
        (Refusal.SIZE_TO_CELL, fits_to_cell),
        (Refusal.SIZE_FROM_CELL, fits_from_cell),
    )
    for refusal, is_right in refusals:
        if not is_right:
            raise OpenRefused(refusal)
    return kind


def _kind_of_points(numbers: tuple[list[int] | None, list[int] | None, list[int] | None]) -> Purpose:
    """Purpose by the path: class Assembly, optional configuration, assemblies of outputs and of inputs.

    Raises `OpenRefused`.
    """
    classes, instances, points = numbers
    named = [*(instances or []), *(points or [])]
    if named[:1] == [device.CONFIGURATION]:
        named = named[1:]
    kinds = {device.TO_CELL_ASSEMBLY: Purpose.OWNER, device.HEARTBEAT: Purpose.INPUT}
    if classes != [0x04] or len(named) != 2 or named[1] != device.FROM_CELL_ASSEMBLY or named[0] not in kinds:
        raise OpenRefused(Refusal.PATH)
    return kinds[named[0]]


def _check_key(key: bytes) -> None:
    """Check the electronic key, by which a scanner may name the device it expects; 0 is any.

    Raises `OpenRefused`.
    """
    if not key:
        return
    vendor, kind, product, major, minor = struct.unpack("<HHHBB", key)
    if vendor not in (0, device.VENDOR) or product not in (0, device.PRODUCT):
        raise OpenRefused(Refusal.WRONG_PRODUCT)
    if kind not in (0, device.DEVICE_TYPE):
        raise OpenRefused(Refusal.WRONG_TYPE)
    is_compatible, major = bool(major & 0x80), major & 0x7F
    ours_major, ours_minor = device.REVISION
    if is_compatible and (major, minor) <= (ours_major, ours_minor) and major in (0, ours_major):
        return
    if major not in (0, ours_major) or minor not in (0, ours_minor):
        raise OpenRefused(Refusal.WRONG_REVISION)
