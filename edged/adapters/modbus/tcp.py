"""Modbus/TCP: connections, framing, limits.

Each complete frame is answered in order, so that pipelined requests all get their answer. A frame
whose header cannot be right (protocol id, length) means that the framing is lost: the connection is
closed, because everything after it would be guesswork.

A connection that does not read its answers is not read from either, and one that completes no request
for `idle_s` is closed, whatever bytes it dribbles.
"""

from __future__ import annotations

import asyncio
import itertools
import ssl
from collections import Counter

from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU

from edged.adapters.modbus.cell import CellRegisters, ClientView
from edged.adapters.modbus.pdu import WRITES, respond
from edged.adapters.modbus.refusals import Refusals
from edged.adapters.modbus.security import certificate_role, server_context
from edged.adapters.modbus.settings import Address, ModbusSettings, address_of, contains
from edged.errors import ListenError
from edged.logs import LogLimit

HEADER_BYTES = 7
MAX_LENGTH = 254  # of unit id and PDU ("MODBUS Messaging on TCP/IP", 3.1.3: 260 bytes with the header)
GATEWAY_NO_RESPONSE = 0x0B
TURN = 16  # requests answered before other connections and tasks get their turn
WRITE_BUFFER_BYTES = 16 * 1024
HANDSHAKE_S = 5.0
SILENT_S = 3.0  # no PLC polls as slowly as that


class TcpServer:
    """Accepts connections and keeps them within the limits."""

    def __init__(
        self,
        settings: ModbusSettings,
        cell: CellRegisters,
        clients: itertools.count[int],
        refusals: Refusals,
        context: ssl.SSLContext | None = None,
    ) -> None:
        self.settings = settings
        self.cell = cell
        self.log = LogLimit(__name__)
        self.refusals = refusals
        self._numbers = clients
        self._context = context
        self._connections: set[Connection] = set()
        self._server: asyncio.Server | None = None
        self._sweep: asyncio.TimerHandle | None = None

    @property
    def port(self) -> int:
        """Port that is listened on (useful when 0 was asked for); 0 when closed."""
        return int(self._server.sockets[0].getsockname()[1]) if self._server is not None else 0

    async def start(self) -> None:
        """Listen. Raises `ListenError` that says what to do."""
        settings = self.settings
        loop = asyncio.get_running_loop()
        context = self._context
        if context is None and settings.tls is not None:
            context = server_context(settings.tls)
        try:
            self._server = await loop.create_server(
                lambda: Connection(self, next(self._numbers)),
                settings.host,
                settings.port,
                ssl=context,
                ssl_handshake_timeout=HANDSHAKE_S if context is not None else None,
                backlog=32,
            )
        except (OSError, OverflowError) as error:
            raise ListenError(_listen_problem(settings, error)) from error
        self._sweep_idle()

    async def close(self) -> None:
        """Stop listening and drop every connection."""
        if self._sweep is not None:
            self._sweep.cancel()
        for connection in tuple(self._connections):
            connection.abort()
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()
            self._server = None
        await asyncio.sleep(0)  # lets every connection_lost run: no transport is left behind

    def admit(self, connection: Connection) -> bool:
        """Whether a new connection may stay."""
        if self.settings.readers and not contains(
            (*self.settings.readers, *self.settings.writers), connection.peer
        ):
            self.log.warning("modbus: %s is not in the list of networks, closed", connection.peer)
            return False
        if not self._has_room(connection) and not self._make_room(connection):
            self.log.warning(
                "modbus: %s closed, %d clients are connected", connection.peer, len(self._connections)
            )
            return False
        self._connections.add(connection)
        self.cell.clients += 1
        return True

    def _has_room(self, newcomer: Connection) -> bool:
        """Whether a place is free that is not kept for somebody else."""
        here = Counter(other.address for other in self._connections)
        kept = sum(
            max(0, slots - here[address])
            for address, slots in self.settings.reserved.items()
            if address != newcomer.address
        )
        return len(self._connections) + kept < self.settings.max_clients

    def _make_room(self, newcomer: Connection) -> bool:
        """A known PLC displaces the stranger that is idle longest, or else a silent connection of its own.

        A PLC that loses power leaves connections behind that look alive; it must get in again.
        """
        if not newcomer.is_known:
            return False
        strangers = [other for other in self._connections if not other.is_known]
        silent_s = newcomer.active_s - SILENT_S
        own = [
            other
            for other in self._connections
            if other.address == newcomer.address and other.active_s <= silent_s
        ]
        displaced = min(strangers or own, key=lambda other: other.active_s, default=None)
        if displaced is None:
            return False
        displaced.abort()
        return self._has_room(newcomer)

    def forget(self, connection: Connection) -> None:
        """A connection has ended."""
        if connection in self._connections:
            self._connections.discard(connection)
            self.cell.clients -= 1
            self.cell.gone(connection.number)

    def _sweep_idle(self) -> None:
        loop = asyncio.get_running_loop()
        for connection in tuple(self._connections):
            if loop.time() - connection.active_s > self.settings.idle_s:
                self.log.warning("modbus: %s is idle, closed", connection.peer)
                connection.abort()
        self._sweep = loop.call_later(min(1.0, self.settings.idle_s / 4), self._sweep_idle)


def _listen_problem(settings: ModbusSettings, error: Exception) -> str:
    place = f"modbus: cannot listen on {settings.host}:{settings.port}"
    number = getattr(error, "errno", None)
    if isinstance(error, PermissionError):
        return (
            f"{place}: ports below 1024 need CAP_NET_BIND_SERVICE (the systemd unit grants it); "
            "or choose a port above, such as 1502"
        )
    if number == 98:  # EADDRINUSE
        return f"{place}: the port is in use; `ss -ltnp sport = :{settings.port}` shows by whom"
    if number == 99:  # EADDRNOTAVAIL
        return f"{place}: no interface of this machine has that address; `ip -br address` shows them"
    return f"{place}: {getattr(error, 'strerror', None) or error}"


class Connection(asyncio.Protocol):
    """One client."""

    def __init__(self, server: TcpServer, number: int) -> None:
        self.number = number
        self.peer = ""
        self.address: Address | None = None
        self.is_known = False
        self.active_s = 0.0
        self._server = server
        self._loop = asyncio.get_running_loop()
        self._framer = FramerSocket(DecodePDU(is_server=True))
        self._view = ClientView(server.cell, number)
        self._may_write = False
        self._transport: asyncio.Transport | None = None
        self._buffer = bytearray()
        self._turn: asyncio.Handle | None = None
        self._is_choked = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Look at who it is."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport was expected")
        self._transport = transport
        settings = self._server.settings
        name = transport.get_extra_info("peername")
        self.peer = str(name[0]) if name else "?"
        self.active_s = self._loop.time()
        self.address = address_of(self.peer)
        self.is_known = contains(settings.writers, self.peer)
        self._may_write = self.is_known
        tls = transport.get_extra_info("ssl_object")
        if settings.tls is not None and isinstance(tls, ssl.SSLObject | ssl.SSLSocket):
            role = certificate_role(tls.getpeercert(binary_form=True) or b"")
            self._may_write = self.is_known and role in settings.tls.writer_roles
        transport.set_write_buffer_limits(WRITE_BUFFER_BYTES)
        if not self._server.admit(self):
            self.abort()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002  (asyncio's signature)
        """Free the place, and the right to write."""
        if self._turn is not None:
            self._turn.cancel()
        self._transport = None
        self._server.forget(self)

    def abort(self) -> None:
        """End the connection now; what is not sent is dropped."""
        if self._transport is not None:
            self._transport.abort()
            # the right to write is free at once; connection_lost comes with the next turn of the loop
            self._server.forget(self)

    def data_received(self, data: bytes) -> None:
        """Collect, and answer what is complete."""
        self._buffer += data
        if self._turn is None and not self._is_choked:
            self._serve()

    def pause_writing(self) -> None:
        """The client does not read: leave its requests where they are."""
        self._is_choked = True
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        """It reads again."""
        self._is_choked = False
        if self._transport is not None:
            self._transport.resume_reading()
            if self._turn is None:
                self._serve()

    def _serve(self) -> None:
        self._turn = None
        for _ in range(TURN):
            if self._is_choked or self._transport is None or self._transport.is_closing():
                return
            frame = self._next_frame()
            if frame is None:
                self._transport.resume_reading()
                return
            self._answer(frame)
        # more may wait in the buffer: take another turn, and let no more come in before that
        if self._transport is not None and not self._is_choked:
            self._transport.pause_reading()
            self._turn = self._loop.call_soon(self._serve)

    def _next_frame(self) -> bytes | None:
        """Take one frame out of the buffer; None when it is not complete or the connection is lost."""
        if len(self._buffer) < HEADER_BYTES:
            return None
        length = int.from_bytes(self._buffer[4:6], "big")
        if self._buffer[2:4] != b"\0\0" or not 2 <= length <= MAX_LENGTH:
            self._server.log.warning("modbus: %s sent what is no Modbus/TCP, closed", self.peer)
            self.abort()
            return None
        end = 6 + length
        if len(self._buffer) < end:
            return None
        frame = bytes(self._buffer[:end])
        del self._buffer[:end]
        return frame

    def _answer(self, frame: bytes) -> None:
        _, unit, transaction, request = self._framer.decode(frame)
        settings = self._server.settings
        # 0 and 255 mean "the device at this address" ("MODBUS Messaging on TCP/IP", 4.4.1.2)
        if unit in (settings.unit_id, 0, 255):
            response = respond(request, self._view, may_write=self._may_write)
            if request[0] in WRITES and not self._may_write:
                role = "the role in its certificate is not in modbus.tls.writer_roles"
                why = role if self.is_known else "it is not in modbus.writers"
                self._server.refusals.note(self.address, why)
        else:
            response = bytes((request[0] | 0x80, GATEWAY_NO_RESPONSE))
        self.active_s = self._loop.time()
        if self._transport is not None:
            self._transport.write(self._framer.encode(response, unit, transaction))
