"""The adapter's sockets: sessions over TCP, discovery over UDP, inputs and outputs over UDP 2222.

Nothing received raises: an invalid message is answered with a status, or dropped. A scanner's outputs are
accepted only from its own address, under a connection id that only it knows.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
import struct
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from edged.adapters.enip import messages as msg
from edged.adapters.enip.connections import (
    CLOSE,
    RUN_IDLE,
    SEQUENCE,
    CipConnection,
    Connections,
    OpenRefused,
    Purpose,
    wanted_of,
)
from edged.adapters.enip.objects import (
    CONNECTION_MANAGER,
    INACTIVITY_S,
    OPERATIONAL,
    Objects,
    device_status,
    serial_number,
)
from edged.connections import Network, Rate, TcpClient, TcpListener, contains
from edged.errors import ListenError
from edged.logs import LogLimit
from edged.plc import ethernetip as device
from edged.plc.processimage import NO_IMAGE, TO_CELL_BYTES

FORWARD_OPEN, LARGE_FORWARD_OPEN, FORWARD_CLOSE = 0x54, 0x5B, 0x4E
MOST_BYTES = 1024
"""Longest message; longer ones are not supported here."""
MOST_SESSIONS, MOST_OF_ONE = 32, 8
BYTES_PER_S, BURST_BYTES = 64 * 1024, 64 * 1024
"""Limit on the data that a session may send; a scanner needs only a few messages to connect."""
ANSWERS_PER_S = 50.0
"""Limit on answers to discovery over UDP."""
SERVICES = struct.pack("<HH16s", 1, 0x0120, b"Communications")
"""Data of ListServices: version, capability flags (explicit messages over TCP, I/O over UDP), name."""


@dataclass(frozen=True, slots=True)
class EnipSettings:
    """Settings. host : IPv4 address. scanners : networks that may connect. cell : for the serial number."""

    host: str
    scanners: tuple[Network, ...]
    cell: str = ""


class EnipServer:
    """The EtherNet/IP adapter. take : receives the outputs of the owning scanner.

    lost : called with the reason when that scanner is gone, or its controller is idle.
    """

    def __init__(
        self, settings: EnipSettings, take: Callable[[bytes], None], lost: Callable[[str], None]
    ) -> None:
        self.settings = settings
        self.log = LogLimit(__name__)
        self.image, self.outputs = NO_IMAGE, bytes(TO_CELL_BYTES)
        self.connections = Connections()
        self._objects = Objects(serial_number(settings.cell), self._status, self._assembly)
        self._take, self._lost = take, lost
        self._sessions = itertools.count(1)
        self._listener: TcpListener | None = None
        self._questions: asyncio.DatagramTransport | None = None
        self._data: asyncio.DatagramTransport | None = None
        self._timers: dict[int, asyncio.TimerHandle] = {}  # by the connection's id
        self._answers = Rate(ANSWERS_PER_S)

    async def start(self) -> None:
        """Listen on all three sockets. Raises `ListenError`; then none stays open."""
        settings = self.settings
        listener = TcpListener(
            "ethernetip",
            lambda client: EnipSession(self, client, next(self._sessions)),
            self._admit,
            idle_s=INACTIVITY_S,
        )
        await listener.open(settings.host, device.TCP_PORT)
        self._listener = listener
        try:
            self._questions = await self._datagrams(device.TCP_PORT, self._question)
            self._data = await self._datagrams(device.IO_PORT, self._datagram)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Send an empty image to every scanner, and release all resources."""
        self.image = NO_IMAGE
        for connection in self.connections.of_data:
            self._send(connection)
        for connection in list(self.connections.by_id.values()):
            self._forget(connection)
        for transport in (self._questions, self._data):
            if transport is not None:
                transport.close()
        listener, self._listener = self._listener, None
        if listener is not None:
            await listener.close()
        await asyncio.sleep(0)  # connection_lost is called in the next turn of the loop

    async def _datagrams(
        self, port: int, take: Callable[[bytes, tuple[str, int]], None]
    ) -> asyncio.DatagramTransport:
        loop, host = asyncio.get_running_loop(), self.settings.host
        try:
            transport, _ = await loop.create_datagram_endpoint(
                lambda: Datagrams(take), (host, port), family=socket.AF_INET
            )
        except OSError as error:
            raise ListenError(
                f"ethernetip: cannot listen on {host}:{port} over UDP: {error.strerror}"
            ) from error
        return transport

    def _admit(self, client: TcpClient) -> bool:
        """Whether a client may connect; at an address with many sessions the longest idle one is closed."""
        clients = () if self._listener is None else self._listener.clients
        if not contains(self.settings.scanners, client.peer):
            self.log.warning("ethernetip: %s is not in ethernetip.scanners, closed", client.peer)
            return False
        count = Counter(other.peer for other in clients)
        if count[client.peer] >= MOST_OF_ONE:
            own = (other for other in clients if other.peer == client.peer)
            min(own, key=lambda other: other.active_s).abort()
        elif len(clients) >= MOST_SESSIONS:
            self.log.warning("ethernetip: %s closed, %d sessions are open", client.peer, len(clients))
            return False
        client.limit(BYTES_PER_S, BURST_BYTES)
        return True

    # --- objects -------------------------------------------------------------------------------

    def _status(self) -> int:
        found = self.connections.of_data
        return device_status(
            is_owned=self.connections.owner is not None,
            connections=len(found),
            is_running=any(connection.is_running for connection in found),
        )

    def _assembly(self, instance: int) -> bytes:
        images = {device.FROM_CELL_ASSEMBLY: self.image, device.TO_CELL_ASSEMBLY: self.outputs}
        return images.get(instance, b"")

    # --- explicit messages ---------------------------------------------------------------------

    def unconnected(self, message: msg.Encapsulated, own: str) -> bytes | None:
        """Reply data for a command that needs no session; None for other commands. own : our address."""
        if message.command == msg.LIST_SERVICES:
            return msg.packed_items((msg.SERVICES_ITEM, SERVICES))
        if message.command == msg.LIST_INTERFACES:
            return msg.packed_items()
        if message.command == msg.LIST_IDENTITY:
            place = struct.pack(">HH4s8x", socket.AF_INET, device.TCP_PORT, socket.inet_aton(own))
            whole = b"".join(self._objects.identity().values())
            identity = struct.pack("<H", 1) + place + whole + bytes((OPERATIONAL,))
            return msg.packed_items((msg.IDENTITY_ITEM, identity))
        return None

    def asked(self, data: bytes, session: EnipSession, port: int) -> bytes:
        """Reply to a request. port : UDP port on which its originator takes inputs. Raises `BadMessage`."""
        request = msg.request_of(data)
        numbers = request.path.number(msg.CLASS), request.path.number(msg.INSTANCE)
        if numbers == (CONNECTION_MANAGER, 1):
            if request.service in (FORWARD_OPEN, LARGE_FORWARD_OPEN):
                return self._open(request, session, port)
            if request.service == FORWARD_CLOSE:
                return self._close(request, session)
        return self._objects.answer(request, session.own)

    def _open(self, request: msg.CipRequest, session: EnipSession, port: int) -> bytes:
        wanted = wanted_of(request.data, large=request.service == LARGE_FORWARD_OPEN)
        named = struct.pack("<HHI", *wanted.connection_key)
        try:
            made = self.connections.open(wanted, session.peer, port, session.number, time.monotonic())
        except OpenRefused as error:
            return msg.reply_to(request.service, named + bytes(2), msg.CONNECTION_FAILURE, extended=error.why)
        if made.purpose is not Purpose.EXPLICIT:
            self._send(made)
        self._watch(made)
        ids = struct.pack("<II", made.id, wanted.to_id)
        return msg.reply_to(request.service, ids + named + struct.pack("<II", *wanted.rpi_us) + bytes(2))

    def _close(self, request: msg.CipRequest, session: EnipSession) -> bytes:
        if len(request.data) < CLOSE.size:
            raise msg.BadMessage("a Forward_Close is cut off")
        _, _, *connection_key, _ = CLOSE.unpack_from(request.data)
        named = struct.pack("<HHI", *connection_key)
        try:
            closed = self.connections.close(
                (connection_key[0], connection_key[1], connection_key[2]), session.peer
            )
        except OpenRefused as error:
            return msg.reply_to(request.service, named + bytes(2), msg.CONNECTION_FAILURE, extended=error.why)
        self._forget(closed)
        self._gone(closed, "closed its connection")
        return msg.reply_to(request.service, named + bytes(2))

    def over_connection(self, data: bytes, session: EnipSession) -> bytes:
        """Items of the reply to a message over a class 3 connection. Raises `BadMessage`."""
        match msg.items_of(data):
            case [(msg.CONNECTED_ADDRESS, number), (msg.CONNECTED_DATA, body)] if len(number) == 4:
                pass
            case _:
                raise msg.BadMessage("other items than those of a connection")
        connection = self.connections.by_id.get(int.from_bytes(number, "little"))
        if (
            connection is None
            or connection.session != session.number
            or connection.purpose is not Purpose.EXPLICIT
        ):
            raise msg.BadMessage("no such connection")
        connection.due_s = time.monotonic() + connection.timeout_s
        answer = body[:SEQUENCE] + self.asked(body[SEQUENCE:], session, device.IO_PORT)
        address = connection.wanted.to_id.to_bytes(4, "little")
        return msg.packed_items((msg.CONNECTED_ADDRESS, address), (msg.CONNECTED_DATA, answer))

    def ended(self, session: int) -> None:
        """End a session and its explicit connections; inputs and outputs continue (volume 2)."""
        for connection in list(self.connections.by_id.values()):
            if connection.purpose is Purpose.EXPLICIT and connection.session == session:
                self._forget(connection)

    # --- inputs and outputs --------------------------------------------------------------------

    def _watch(self, connection: CipConnection) -> None:
        """Send inputs each period, and detect missing outputs."""
        loop, due_s = asyncio.get_running_loop(), time.monotonic()

        def turn() -> None:
            nonlocal due_s
            now_s = time.monotonic()
            if now_s >= connection.due_s:
                for lost in self.connections.lost(now_s):
                    self._forget(lost)
                    self._gone(lost, f"sent nothing for {lost.timeout_s * 1000:.0f} ms")
                return
            wait_s = connection.due_s - now_s
            if connection.purpose is not Purpose.EXPLICIT:
                if now_s >= due_s:
                    self._send(connection)
                    due_s = max(due_s + connection.period_s, now_s)  # a late period is not made up for
                wait_s = min(wait_s, max(0.0, due_s - now_s))
            self._timers[connection.id] = loop.call_later(min(wait_s + 1e-4, 1.0), turn)

        self._timers[connection.id] = loop.call_later(min(connection.period_s, 1.0), turn)

    def _send(self, connection: CipConnection) -> None:
        if self._data is not None and not self._data.is_closing():
            self._data.sendto(connection.inputs(self.image), (connection.peer, connection.port))

    def _forget(self, connection: CipConnection) -> None:
        self.connections.by_id.pop(connection.id, None)
        if (timer := self._timers.pop(connection.id, None)) is not None:
            timer.cancel()

    def _gone(self, connection: CipConnection, why: str) -> None:
        if connection.purpose is Purpose.OWNER:
            self.outputs = bytes(TO_CELL_BYTES)
            self._lost(f"{connection.peer} {why}")

    def _datagram(self, data: bytes, place: tuple[str, int]) -> None:
        """Take outputs, or the heartbeat of a scanner that only reads."""
        try:
            match msg.items_of(data):
                case [(msg.SEQUENCED_ADDRESS, address), (msg.CONNECTED_DATA, body)] if len(address) == 8:
                    pass
                case _:
                    return
        except msg.BadMessage:
            return
        number, sequence = struct.unpack("<II", address)
        connection = self.connections.by_id.get(number)
        if connection is None or connection.purpose is Purpose.EXPLICIT or connection.peer != place[0]:
            return
        is_owner, now_s = connection.purpose is Purpose.OWNER, time.monotonic()
        if is_owner and len(body) != SEQUENCE + RUN_IDLE + TO_CELL_BYTES:
            return
        if connection.took(sequence, now_s) and is_owner:
            self._outputs(connection, body[SEQUENCE + RUN_IDLE :], is_running=bool(body[SEQUENCE] & 1))

    def _outputs(self, owner: CipConnection, outputs: bytes, *, is_running: bool) -> None:
        was_running, owner.is_running = owner.is_running, is_running
        if is_running and (outputs != self.outputs or not was_running):
            self.outputs = outputs
            self._take(outputs)
        elif was_running and not is_running:
            self.outputs = bytes(TO_CELL_BYTES)
            self._lost(f"the controller at {owner.peer} does not run")

    def _question(self, data: bytes, place: tuple[str, int]) -> None:
        """Answer discovery over UDP, also for programs that may not connect."""
        with contextlib.suppress(msg.BadMessage):
            message = msg.unpacked(data)
            answer = self.unconnected(message, self._own_address(place[0]))
            if answer is not None and self._questions is not None and self._answers.take():
                self._questions.sendto(message.answered(answer).packed(), place)

    def _own_address(self, peer: str) -> str:
        """Our address as seen by this peer."""
        if self.settings.host != "0.0.0.0":
            return self.settings.host
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
            try:
                way.connect((peer, device.TCP_PORT))
            except OSError:
                return self.settings.host
            return str(way.getsockname()[0])


class Datagrams(asyncio.DatagramProtocol):
    """Passes each datagram on."""

    def __init__(self, take: Callable[[bytes, tuple[str, int]], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Pass the datagram on."""
        self._take(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Ignore ICMP errors: the connection of a scanner that is gone times out."""


class EnipSession(asyncio.Protocol):
    """One TCP connection. number : handle of the session that it may register."""

    def __init__(self, server: EnipServer, client: TcpClient, number: int) -> None:
        self.number, self.peer, self.own = number, client.peer, "0.0.0.0"
        self._server, self._client = server, client
        self._is_registered = False
        self._buffer = bytearray()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the session."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport was expected")
        self._transport = transport
        self.own = str(transport.get_extra_info("sockname")[0])
        self._client.touch()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002  (asyncio's signature)
        """End the session."""
        self._transport = None
        self._server.ended(self.number)

    def pause_writing(self) -> None:
        """Close a client that does not read its replies."""
        self._client.abort()

    def data_received(self, data: bytes) -> None:
        """Buffer data, and answer the messages that are complete."""
        self._buffer += data
        while len(self._buffer) >= msg.HEADER.size and self._is_open():
            end = msg.HEADER.size + int.from_bytes(self._buffer[2:4], "little")
            if end > MOST_BYTES:
                self._server.log.warning("ethernetip: %s sent something else, closed", self.peer)
                self._client.abort()
                return
            if len(self._buffer) < end:
                return
            message = msg.unpacked(bytes(self._buffer[:end]))
            del self._buffer[:end]
            self._client.touch()
            answer = self._answer(message)
            if answer is not None and self._transport is not None:
                self._transport.write(answer.packed())

    def _is_open(self) -> bool:
        return self._transport is not None and not self._transport.is_closing()

    def _answer(self, message: msg.Encapsulated) -> msg.Encapsulated | None:
        if message.command == msg.NOP or message.options:
            return None
        if message.command == msg.UNREGISTER_SESSION:
            self._client.abort()
            return None
        if (data := self._server.unconnected(message, self.own)) is not None:
            return message.answered(data)
        if message.command == msg.REGISTER_SESSION:
            return self._register(message)
        if message.command not in (msg.SEND_RR_DATA, msg.SEND_UNIT_DATA):
            return message.answered(status=msg.INVALID_COMMAND)
        if not self._is_registered or message.session != self.number:
            return message.answered(status=msg.INVALID_SESSION)
        head = message.data[:6]  # interface and time-out, which CIP does not use
        try:
            if message.command == msg.SEND_UNIT_DATA:
                return message.answered(head + self._server.over_connection(message.data[6:], self))
            return message.answered(head + self._alone(message.data[6:]))
        except msg.BadMessage:
            return message.answered(status=msg.INCORRECT_DATA)

    def _register(self, message: msg.Encapsulated) -> msg.Encapsulated:
        if len(message.data) != 4:
            return message.answered(status=msg.INVALID_LENGTH)
        if self._is_registered:
            return message.answered(status=msg.INVALID_COMMAND)
        if message.data != bytes((1, 0, 0, 0)):
            return message.answered(bytes((1, 0, 0, 0)), msg.UNSUPPORTED_VERSION)
        self._is_registered = True
        return message.answered(message.data, session=self.number)

    def _alone(self, data: bytes) -> bytes:
        """Items of the reply to an unconnected message. Raises `BadMessage`."""
        items, port = msg.items_of(data), device.IO_PORT
        if len(items) < 2 or items[0] != (msg.NULL_ADDRESS, b"") or items[1][0] != msg.UNCONNECTED_DATA:
            raise msg.BadMessage("other items than those of a message")
        for kind, place in items[2:]:
            if kind == msg.SOCKET_TO_ORIGINATOR and len(place) == 16:
                # the port for its inputs; its address is always the client's own
                port = int.from_bytes(place[2:4], "big") or device.IO_PORT
        answer = self._server.asked(items[1][1], self, port)
        return msg.packed_items((msg.NULL_ADDRESS, b""), (msg.UNCONNECTED_DATA, answer))
