"""The socket for robots that use lines or frames: connections and their limits, and splitting into messages.

Messages are carried out by `lines`, where the connection is one more client of the registers.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import re

from edged.adapters.modbus.cell import CellRegisters, ClientView
from edged.adapters.modbus.lines import Robot
from edged.adapters.modbus.refusals import Refusals
from edged.adapters.modbus.settings import LineSettings, ModbusSettings
from edged.adapters.modbus.tcp import SILENT_S
from edged.connections import TcpClient, TcpListener, address_of, contains
from edged.logs import LogLimit
from edged.plc.frames import MAGIC, REQUEST, answer_frame
from edged.plc.lines import MAX_LINE_BYTES, LineStatus

MAX_CLIENTS = 8
END_OF_LINE = re.compile(rb"[\r\n]")
LINE_FEED_S = 0.05
"""The answer to the first carriage return of a connection waits this long for a line feed, to use the same
end of line: a robot that sends the two separately may hold the second back until the first is acknowledged,
which Linux does within 40 ms (TCP_DELACK_MIN in include/net/tcp.h)."""
SEND_S = 5.0
"""A robot that does not read its answer within this time is disconnected."""


class Messages:
    """Splits a robot's bytes into frames, and into lines that end with CR, LF, or both.

    The second of the two bytes may come in a packet of its own, and does not end another line; nor does the
    end of line that a controller adds to a program's line feed.
    """

    def __init__(self, reader: asyncio.StreamReader) -> None:
        self._reader = reader
        self._buffer = bytearray()
        self._before = b""  # the last byte of the line before the buffer
        self._is_open = False  # the last line ended with CR, and LF may follow
        self._end = b""  # the robot's end of line, once known
        self._heard_s = 0.0

    async def next(self) -> bytes:
        """Next line with the first byte of its end, or whole frame; b"" at the end of the connection.

        An incomplete message at the end is dropped. Raises ConnectionError for a line that is too long.
        """
        while True:
            message = self._taken()
            if message:
                self._heard_s = asyncio.get_running_loop().time()
                return message
            if not await self._hear():
                return b""

    async def end(self) -> bytes:
        """The whole end of the last line, which its answer must have, too."""
        if self._before == b"\n":
            return b"\n"
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(self._heard_s + LINE_FEED_S):
                while not self._buffer and not self._end and await self._hear():
                    pass
        if self._buffer.startswith(b"\n"):
            self._end = b"\r\n"
        self._end = self._end or b"\r"
        return self._end

    def _taken(self) -> bytes:
        """Take a complete message out of the buffer; b"" without one."""
        while self._buffer:
            if self._buffer.startswith(MAGIC[:1]):
                self._before = b""
                return self._cut(REQUEST.size) if len(self._buffer) >= REQUEST.size else b""
            found = END_OF_LINE.search(self._buffer)
            if found is None:
                if len(self._buffer) > MAX_LINE_BYTES:
                    raise ConnectionError(f"a line is longer than {MAX_LINE_BYTES} bytes")
                return b""
            line = self._cut(found.end())
            before, self._before = self._before, line[-1:]
            is_open, self._is_open = self._is_open, line[-1:] == b"\r" and line != b"\r"
            if line == b"\n" and before == b"\r":
                self._end = b"\r\n" if is_open else self._end
            elif line != b"\r":
                return line
        return b""

    def _cut(self, size: int) -> bytes:
        message = bytes(self._buffer[:size])
        del self._buffer[:size]
        return message

    async def _hear(self) -> bool:
        """Wait for more bytes; False if the connection has ended."""
        more = await self._reader.read(MAX_LINE_BYTES)
        self._buffer += more
        return bool(more)


class LineServer:
    """Accepts connections of robots and enforces their limits."""

    def __init__(
        self,
        settings: ModbusSettings,
        line: LineSettings,
        cell: CellRegisters,
        clients: itertools.count[int],
        refusals: Refusals,
    ) -> None:
        self._settings = settings
        self._line = line
        self._cell = cell
        self._numbers = clients
        self._refusals = refusals
        self._log = LogLimit(__name__)
        self._tasks: set[asyncio.Task[None]] = set()
        # idle connections are closed where lines are read, in `_serve`
        self._listener = TcpListener("modbus.socket", self._protocol, self._admits, idle_s=math.inf)

    @property
    def port(self) -> int:
        """Listening port; 0 when closed."""
        return self._listener.port

    async def start(self) -> None:
        """Listen. Raises `ListenError`."""
        await self._listener.open(self._settings.host, self._line.port)

    async def close(self) -> None:
        """Stop listening and close every connection."""
        self._listener.shut()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._listener.close()

    def _protocol(self, client: TcpClient) -> asyncio.Protocol:
        def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.create_task(self._converse(client, reader, writer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        return asyncio.StreamReaderProtocol(asyncio.StreamReader(limit=MAX_LINE_BYTES), accept)

    async def _converse(
        self, client: TcpClient, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        number = next(self._numbers)
        try:
            await self._serve(client, reader, writer, number)
        except (TimeoutError, OSError) as error:
            self._log.warning(
                "modbus.socket: %s was disconnected: %s", client.peer, str(error) or "it is silent"
            )
        finally:
            self._cell.client_disconnected(number)
            writer.close()
            try:
                async with asyncio.timeout(SEND_S):
                    await writer.wait_closed()
            except (TimeoutError, OSError):
                writer.transport.abort()

    def _admits(self, newcomer: TcpClient) -> bool:
        """Whether a new connection may stay.

        When all places are taken, a robot that may write displaces a stranger, else the longest silent of its
        own connections (left over when it lost power), else that of robots whose right to write has lapsed. A
        stranger displaces only silent strangers: it may not write anyway.
        """
        settings, peer = self._settings, newcomer.peer
        if settings.readers and not contains((*settings.readers, *settings.writers), peer):
            self._log.warning("modbus.socket: %s is not in the list of networks, closed", peer)
            return False
        clients = self._listener.clients
        if len(clients) < MAX_CLIENTS:
            return True
        strangers = [client for client in clients if not contains(settings.writers, client.peer)]
        silent = [client for client in clients if client.is_silent(newcomer.active_s - SILENT_S)]
        lapsed_s = newcomer.active_s - max(SILENT_S, settings.owner_s)
        if contains(settings.writers, peer):
            own = [client for client in silent if client.peer == peer]
            rest = strangers or own or [client for client in silent if client.is_silent(lapsed_s)]
        else:
            rest = [client for client in silent if client in strangers]
        displaced = min(rest, key=lambda client: client.active_s, default=None)
        if displaced is None:
            self._log.warning("modbus.socket: %s closed, %d robots are connected", peer, MAX_CLIENTS)
            return False
        displaced.abort()
        return True

    async def _serve(
        self, client: TcpClient, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, number: int
    ) -> None:
        may_write = contains(self._settings.writers, client.peer)
        robot = Robot(ClientView(self._cell, number), self._settings, self._line, may_write=may_write)
        messages = Messages(reader)
        while True:
            async with asyncio.timeout(self._settings.idle_s):
                message = await messages.next()
            if not message:
                return
            is_frame = message.startswith(MAGIC[:1])
            if not may_write:
                self._refusals.note(address_of(client.peer), "it is not in modbus.writers")
            client.touch(busy=True)
            answer, brand = await robot.answer(message)
            writer.write(
                answer_frame(answer, brand) if is_frame else answer.line(brand, await messages.end())
            )
            async with asyncio.timeout(SEND_S):
                await writer.drain()
            client.touch()
            if is_frame and answer.status == LineStatus.NOT_UNDERSTOOD and answer.sequence == 0:
                return  # the start of the next frame is unknown
