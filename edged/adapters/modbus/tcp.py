"""Modbus/TCP: connections, framing, limits.

Complete frames are answered in order, so that pipelined requests all get their response. A frame with an
invalid header (protocol id, length) means that the framing is lost: the connection is closed, because
anything after it would be guesswork.

A connection that does not read its responses is not read from either, and one that completes no request for
`idle_s` is closed, even if it sends some bytes.
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
from edged.adapters.modbus.settings import ModbusSettings
from edged.connections import Rate, TcpClient, TcpListener, address_of, contains
from edged.logs import LogLimit

HEADER_BYTES = 7
MAX_LENGTH = 254  # of unit id and PDU ("MODBUS Messaging on TCP/IP", 3.1.3: 260 bytes with the header)
GATEWAY_NO_RESPONSE = 0x0B
TURN = 16  # requests answered before other connections and tasks get their turn
WRITE_BUFFER_BYTES = 16 * 1024
STRANGERS_PER_S = (
    20.0  # limit of TLS handshakes, each of which blocks the loop for milliseconds; the PLC's do not count
)
SILENT_S = 3.0  # no PLC polls this slowly; a connection that looks alive may be of a client without power


class TcpServer:
    """Accepts connections and enforces their limits."""

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
        self._connections: dict[TcpClient, ModbusConnection] = {}
        self._listener: TcpListener | None = None
        self._handshakes = Rate(STRANGERS_PER_S)

    @property
    def port(self) -> int:
        """Listening port (useful when 0 was configured); 0 when closed."""
        return self._listener.port if self._listener is not None else 0

    async def start(self) -> None:
        """Listen. Raises `ListenError`."""
        settings = self.settings
        if self._context is None and settings.tls is not None:
            self._context = server_context(settings.tls)
        listener = TcpListener(
            "modbus",
            lambda client: ModbusConnection(self, client, next(self._numbers)),
            self._admit,
            self._left,
            idle_s=settings.idle_s,
            context=self._context,
            tells=True,
        )
        await listener.open(settings.host, settings.port)
        self._listener = listener

    async def close(self) -> None:
        """Stop listening and close every connection, also those in their handshake."""
        listener, self._listener = self._listener, None
        if listener is not None:
            await listener.close()

    def entered(self, connection: ModbusConnection) -> None:
        """Add a connection that has completed its handshake."""
        self._connections[connection.client] = connection
        self.cell.addresses[connection.number] = connection.client.peer

    def _left(self, client: TcpClient) -> None:
        """Free the place of a closed connection and its right to write at once."""
        connection = self._connections.pop(client, None)
        if connection is not None:
            del self.cell.addresses[connection.number]
            self.cell.client_disconnected(connection.number)

    def _admit(self, newcomer: TcpClient) -> bool:
        """Whether a new connection may stay; checked before its handshake, which takes memory and time."""
        settings, peer = self.settings, newcomer.peer
        if settings.readers and not contains((*settings.readers, *settings.writers), peer):
            self.log.warning("modbus: %s is not in the list of networks, closed", peer)
            return False
        is_known = contains(settings.writers, peer)
        if self._context is not None and not is_known and not self._handshakes.take():
            self.log.warning("modbus: %s closed, unknown clients begin too many TLS handshakes", peer)
            return False
        if not self._has_room(peer) and not self._make_room(newcomer, is_known=is_known):
            self.log.warning("modbus: %s closed, %d clients are connected", peer, len(self._clients))
            return False
        return True

    @property
    def _clients(self) -> tuple[TcpClient, ...]:
        return self._listener.clients if self._listener is not None else ()

    def _has_room(self, peer: str) -> bool:
        """Whether a place is free that is not reserved for another address."""
        clients, own = self._clients, address_of(peer)
        here = Counter(address_of(client.peer) for client in clients)
        kept = sum(
            max(0, slots - here[address])
            for address, slots in self.settings.reserved.items()
            if address != own
        )
        return len(clients) + kept < self.settings.max_clients

    def _make_room(self, newcomer: TcpClient, *, is_known: bool) -> bool:
        """Close a connection for a newcomer, the longest idle one of those in their handshake first.

        Failing that, a known PLC displaces the stranger that is idle longest, else the longest silent
        connection of its own address (left over when a PLC lost power) or of an address with many, else one
        whose right to write has lapsed. A stranger displaces only silent strangers: a PLC may be silent
        between two commands, and must not lose its connection to a network scan.
        """
        clients, writers = self._clients, self.settings.writers
        strangers = [client for client in clients if not contains(writers, client.peer)]
        own = [client for client in clients if is_known and client.peer == newcomer.peer]
        nameless = [client for client in (*strangers, *own) if not client.is_in]
        count = Counter(client.peer for client in clients)

        def kept(client: TcpClient) -> int:
            address = address_of(client.peer)
            return self.settings.reserved.get(address, 0) if address is not None else 0

        def has_many(client: TcpClient) -> bool:
            most = max(count[newcomer.peer] + 1, kept(client))
            return client.peer == newcomer.peer or count[client.peer] > most

        silent = [client for client in clients if client.is_silent(newcomer.active_s - SILENT_S)]
        lapsed_s = newcomer.active_s - max(SILENT_S, self.settings.owner_s)
        lapsed = [
            client for client in silent if client.is_silent(lapsed_s) and count[client.peer] > kept(client)
        ]
        if is_known:
            rest = strangers or [client for client in silent if has_many(client)] or lapsed
        else:
            rest = [client for client in silent if client in strangers]
        displaced = min(nameless or rest, key=lambda client: client.active_s, default=None)
        if displaced is None:
            return False
        displaced.abort()
        return self._has_room(newcomer.peer)


class ModbusConnection(asyncio.Protocol):
    """Protocol of one client's connection."""

    def __init__(self, server: TcpServer, client: TcpClient, number: int) -> None:
        self.number = number
        self.client = client
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
        """Determine whether the client may write."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport was expected")
        self._transport = transport
        settings = self._server.settings
        self.client.touch()
        self._may_write = contains(settings.writers, self.client.peer)
        tls = transport.get_extra_info("ssl_object")
        if settings.tls is not None and isinstance(tls, ssl.SSLObject | ssl.SSLSocket):
            role = certificate_role(tls.getpeercert(binary_form=True) or b"")
            self._may_write = self._may_write and role in settings.tls.writer_roles
        transport.set_write_buffer_limits(WRITE_BUFFER_BYTES)
        self._server.entered(self)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002  (asyncio's signature)
        """Stop answering."""
        if self._turn is not None:
            self._turn.cancel()
        self._transport = None

    def data_received(self, data: bytes) -> None:
        """Buffer data, and answer the frames that are complete."""
        self._buffer += data
        if self._turn is None and not self._is_choked:
            self._serve()

    def pause_writing(self) -> None:
        """Stop reading while the client does not read its responses."""
        self._is_choked = True
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        """Resume reading."""
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
        # the buffer may hold more: take another turn, and read nothing before that
        if self._transport is not None and not self._is_choked:
            self._transport.pause_reading()
            self._turn = self._loop.call_soon(self._serve)

    def _next_frame(self) -> bytes | None:
        """Take one frame out of the buffer; None when it is not complete or the connection is lost."""
        if len(self._buffer) < HEADER_BYTES:
            return None
        length = int.from_bytes(self._buffer[4:6], "big")
        if self._buffer[2:4] != b"\0\0" or not 2 <= length <= MAX_LENGTH:
            self._server.log.warning(
                "modbus: %s sent something other than Modbus/TCP, closed", self.client.peer
            )
            self.client.abort()
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
                is_known = contains(settings.writers, self.client.peer)
                why = role if is_known else "it is not in modbus.writers"
                self._server.refusals.note(address_of(self.client.peer), why)
        else:
            response = bytes((request[0] | 0x80, GATEWAY_NO_RESPONSE))
        self.client.touch()
        if self._transport is not None:
            self._transport.write(self._framer.encode(response, unit, transaction))
