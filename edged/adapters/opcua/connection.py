"""One TCP connection of a client: framing, limits, and yielding to others.

asyncua buffers any announced size and logs a trace for any malformed frame; here the size is checked before
buffering, and a client that does not send OPC UA is disconnected (OPC 10000-6, 7.1: Connection Protocol).
"""

from __future__ import annotations

import asyncio
import struct
from collections import deque
from typing import Any

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import header_from_binary, struct_from_binary

from edged.adapters.opcua.security import TrustList
from edged.adapters.opcua.session import Processor, Server
from edged.connections import Rate, TcpClient
from edged.logs import LogLimit

FRAME = struct.Struct("<3scI")
MAX_FRAME_BYTES, MIN_BUFFER_BYTES = 65535, 8192  # OPC 10000-6, 7.1.2.3: buffers have at least 8192 bytes
MAX_MESSAGE_BYTES, MAX_CHUNKS = 256 * 1024, 8
KINDS = frozenset({b"HEL", b"OPN", b"MSG", b"CLO"})
CHUNKS = frozenset(b"FCA")
ACTIVATE_S = 10.0
"""Limit from connecting to a logged-in user; discovery of endpoints takes far less."""
SEND_S = 10.0
MAX_UNSENT_BYTES = 2 * 1024 * 1024
WAITING = 16
"""Most queued frames of one client; with more, reading pauses."""
REQUESTS_PER_S = 200.0
CHANNELS_PER_S = 20.0
"""Limit of secure channels opened by all clients together: each costs a private-key operation."""
NONE_URI = "http://opcfoundation.org/UA/SecurityPolicy#None"


class ConnectionRefused(Exception):
    """The connection must be closed. status : code sent to the client."""

    def __init__(self, status: int, why: str) -> None:
        self.status = status
        super().__init__(why)


class OpcUaConnection(asyncio.Protocol):
    """The protocol of one connection."""

    def __init__(
        self,
        server: Server,
        policies: list[Any],
        trust: TrustList,
        channels: Rate,
        client: TcpClient,
        log: LogLimit,
    ) -> None:
        self._server = server
        self._policies = policies
        self._trust = trust
        self._channels = channels
        self._client = client
        self._log = log
        self._rate = Rate(REQUESTS_PER_S)
        self._received = bytearray()
        self._frames: deque[bytes] = deque()
        self._arrived = asyncio.Event()
        self._is_greeted = False
        self._transport: asyncio.Transport | None = None
        self._processor: Processor | None = None
        self._task: asyncio.Task[None] | None = None
        self._timers: dict[str, asyncio.TimerHandle] = {}

    @property
    def is_active(self) -> bool:
        """Whether a user is logged in."""
        return self._processor is not None and self._processor.is_active

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start serving the connection."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport was expected")
        self._transport = transport
        limits = TransportLimits(MAX_FRAME_BYTES, MAX_FRAME_BYTES, MAX_CHUNKS, MAX_MESSAGE_BYTES)
        self._processor = Processor(self._server, transport, limits)
        self._processor.set_policies(self._policies)
        loop = asyncio.get_running_loop()
        self._timers["activate"] = loop.call_later(ACTIVATE_S, self._must_be_active)
        self._task = loop.create_task(self._work(self._processor), name="opcua-connection")

    def connection_lost(self, _exc: Exception | None) -> None:
        """Stop all timers and the task, and drop buffered data."""
        for timer in self._timers.values():
            timer.cancel()
        if self._task is not None:
            self._task.cancel()
        self._frames.clear()
        self._received.clear()

    async def ended(self) -> None:
        """Wait until its task has ended."""
        if self._task is not None:
            await asyncio.wait({self._task})

    def data_received(self, data: bytes) -> None:
        """Split received data into frames."""
        self._received += data
        try:
            while len(self._received) >= FRAME.size:
                kind, chunk, size = FRAME.unpack_from(self._received)
                if kind not in KINDS or chunk[0] not in CHUNKS or not FRAME.size < size <= MAX_FRAME_BYTES:
                    raise ConnectionRefused(ua.StatusCodes.BadTcpMessageTypeInvalid, "this is not OPC UA")
                if len(self._received) < size:
                    break
                self._frames.append(bytes(self._received[:size]))
                del self._received[:size]
        except ConnectionRefused as refused:
            self._refuse(refused)
            return
        if self._frames:
            self._arrived.set()
        if len(self._frames) > WAITING and self._transport is not None:
            self._transport.pause_reading()

    def pause_writing(self) -> None:
        """Start the time limit for a client that does not read its responses."""
        loop = asyncio.get_running_loop()
        self._timers["send"] = loop.call_later(SEND_S, self._client.abort)

    def resume_writing(self) -> None:
        """Cancel the time limit: the client reads its responses again."""
        self._timers.pop("send").cancel()

    def _must_be_active(self) -> None:
        if not self.is_active:
            self._client.abort()

    async def _work(self, processor: Processor) -> None:
        """Answer one frame after another."""
        try:
            while True:
                while not self._frames:
                    self._arrived.clear()
                    await self._arrived.wait()
                if not await self._answer(processor, self._frames.popleft()):
                    break
                if not self._frames and self._transport is not None and not self._transport.is_closing():
                    self._transport.resume_reading()
                # yield to others, and slow down beyond the rate
                await asyncio.sleep(0 if self._rate.take() else 1 / REQUESTS_PER_S)
        except ConnectionRefused as refused:
            self._refuse(refused)
        except Exception as error:  # noqa: BLE001  # anything that asyncua raises was caused by the client
            self._log.warning("opcua: %s was disconnected: %s", self._client.peer, type(error).__name__)
        finally:
            if self._transport is not None:
                self._transport.close()
            await processor.close()

    async def _answer(self, processor: Processor, frame: bytes) -> bool:
        """Carry out a frame; False after the client's last one."""
        self._check(frame)
        buffer = Buffer(frame)
        header = header_from_binary(buffer)
        goes_on = bool(await processor.process(header, buffer))
        if processor.is_active:
            self._client.touch()
        transport = self._transport
        if transport is not None and transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            raise ConnectionRefused(ua.StatusCodes.BadTcpNotEnoughResources, "it does not read")
        return goes_on

    def _check(self, frame: bytes) -> None:
        """Make the checks that asyncua makes too late, or not at all. Raises `ConnectionRefused`."""
        if frame.startswith(b"HEL") == self._is_greeted:
            raise ConnectionRefused(
                ua.StatusCodes.BadTcpMessageTypeInvalid, "expected HEL once, at the beginning"
            )
        if not self._is_greeted:
            self._is_greeted = True
            hello = struct_from_binary(ua.Hello, Buffer(frame[FRAME.size :]))
            if min(hello.ReceiveBufferSize, hello.SendBufferSize) < MIN_BUFFER_BYTES:
                raise ConnectionRefused(ua.StatusCodes.BadTcpNotEnoughResources, "its buffers are too small")
        elif frame.startswith(b"OPN"):
            self._check_channel(
                struct_from_binary(ua.AsymmetricAlgorithmHeader, Buffer(frame[FRAME.size + 4 :]))
            )

    def _check_channel(self, header: ua.AsymmetricAlgorithmHeader) -> None:
        if header.SecurityPolicyURI == NONE_URI:
            return
        if not self._channels.take():
            raise ConnectionRefused(ua.StatusCodes.BadTcpServerTooBusy, "too many channels are opened")
        why = self._trust.why_not(header.SenderCertificate or b"")
        if why:
            raise ConnectionRefused(ua.StatusCodes.BadSecurityChecksFailed, why)

    def _refuse(self, refused: ConnectionRefused) -> None:
        self._log.warning("opcua: %s was disconnected: %s", self._client.peer, refused)
        transport = self._transport
        if transport is not None and not transport.is_closing():
            # no reason in the message: it would help an attacker (OPC 10000-6, 7.1.5)
            transport.write(FRAME.pack(b"ERR", b"F", 16) + struct.pack("<Ii", refused.status, -1))
            transport.close()
        if self._task is not None and self._task is not asyncio.current_task():
            self._task.cancel()
