"""TCP listener that counts its clients from the moment they connect, with TLS and limits.

It does the listening, TLS and connection accounting, and leaves nothing open after `close`; who may connect
is decided by `admits`, and the protocol by `make`.

`loop.create_server` is not used: it does not count clients before the TLS handshake is over, abandons those
in the handshake when it closes, and without free descriptors tries to accept again and again, with a log
line each.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import ssl
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address
from pathlib import Path
from typing import Any

from edged.errors import ListenError
from edged.logs import LogLimit

BACKLOG = 128  # connections that the kernel queues while the loop is busy
TURN = 16  # clients accepted before other tasks get their turn
HANDSHAKE_S = 5.0
REST_S = 0.2  # pause before the next try, when file descriptors have run out
SWEEP_S = 1.0
CLOSE_S = 1.0
EXHAUSTED = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
Network = IPv4Network | IPv6Network
Address = IPv4Address | IPv6Address


class TcpClient:
    """Connection, from its acceptance to its end.

    name : its address as the operating system gives it. peer : the host in it.
    active_s : time of the last `touch`. busy : one of its requests is being answered.
    has_flooded : it has sent more than it may, and was closed. is_authenticated : the protocol has
    authenticated and admitted it.
    """

    def __init__(self, listener: TcpListener, connection: socket.socket, name: tuple[Any, ...]) -> None:
        self.name = name
        self.peer = str(name[0]) if name else "?"
        self.active_s = time.monotonic()
        self.busy = False
        self.has_flooded = False
        self.is_authenticated = False
        self._inflow: Rate | None = None
        self._listener = listener
        self._connection = connection
        self._transport: asyncio.Transport | None = None

    @property
    def is_in(self) -> bool:
        """Whether the TLS handshake is over, if there is one."""
        return self._transport is not None

    def is_silent(self, since_s: float) -> bool:
        """Whether it has been inactive since then, and none of its requests is being answered."""
        return not self.busy and self.active_s <= since_s

    def touch(self, *, busy: bool = False) -> None:
        """Note activity."""
        self.active_s = time.monotonic()
        self.busy = busy

    def limit(self, bytes_per_s: float, burst_bytes: float) -> None:
        """Limit the rate at which it may send; a client that exceeds it is closed."""
        self._inflow = Rate(bytes_per_s, burst=burst_bytes)

    def may_send(self, size: int) -> bool:
        """Whether the bytes received from it are within its limit."""
        if self._inflow is not None and not self._inflow.take(size):
            self.has_flooded = True
        return not self.has_flooded

    def entered(self, transport: asyncio.Transport) -> None:
        """Note that the handshake is over."""
        self._transport = transport

    def abort(self) -> None:
        """End it now, even during its handshake; unsent data is dropped. It is no longer counted."""
        if self._transport is not None:
            self._transport.abort()
        else:
            # its socket belongs to a transport that is not known here yet: this ends the handshake
            with contextlib.suppress(OSError):
                self._connection.shutdown(socket.SHUT_RDWR)
        self._listener.forget(self)


def tls_with(name: str, certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS context of a server from PEM files. name : for messages. Raises `ListenError` for bad files."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        raise ListenError(f"{name}: {certificate}, {key}: {error}") from error
    return context


async def listening_on(name: str, host: str, port: int) -> list[socket.socket]:
    """Open sockets that listen on a port, one for each address of the host.

    name : for messages. Raises `ListenError` that says what to do; then none stays open.
    """
    opened: list[socket.socket] = []
    try:
        found = await asyncio.get_running_loop().getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        for family, kind, protocol, _, address in dict.fromkeys(found):
            listening = socket.socket(family, kind, protocol)
            opened.append(listening)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            listening.setblocking(False)
            listening.bind(address)
            listening.listen(BACKLOG)
    except BaseException as error:
        for listening in opened:
            listening.close()
        if isinstance(error, OSError | OverflowError):
            raise ListenError(f"{name}: cannot listen on {host}:{port}: {_why(error, port)}") from error
        raise
    return opened


class TcpListener:
    """Listens on one port.

    name : for the log. make : creates the protocol of a client. admits : whether a new client may stay; may
    abort others for it. left : called once for each admitted client, when it is no longer counted.
    idle_s : a client that is not busy and sends nothing for this long is closed; tells : log this.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[TcpClient], asyncio.Protocol],
        admits: Callable[[TcpClient], bool],
        left: Callable[[TcpClient], None] = lambda _client: None,
        *,
        idle_s: float,
        context: ssl.SSLContext | None = None,
        tells: bool = False,
    ) -> None:
        self._name = name
        self._make = make
        self._admits = admits
        self._left = left
        self._idle_s = idle_s
        self._context = context
        self._tells = tells
        self._log = LogLimit(__name__)
        self._listening: list[socket.socket] = []
        self._clients: dict[tuple[Any, ...], TcpClient] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._open: set[TcpClient] = set()  # those that still have a socket
        self._is_empty = asyncio.Event()
        self._timers: dict[object, asyncio.TimerHandle] = {}

    @property
    def port(self) -> int:
        """Port of the listener; 0 when closed."""
        return int(self._listening[0].getsockname()[1]) if self._listening else 0

    @property
    def clients(self) -> tuple[TcpClient, ...]:
        """All clients, including those in their handshake."""
        return tuple(self._clients.values())

    def client(self, name: tuple[Any, ...] | None) -> TcpClient | None:
        """Client with this address; None when it has left."""
        return self._clients.get(name) if name is not None else None

    async def open(self, host: str, port: int) -> None:
        """Listen. Raises `ListenError` that says what to do; then nothing stays open."""
        self.take(await listening_on(self._name, host, port))

    def take(self, listening: Sequence[socket.socket]) -> None:
        """Listen on sockets of `listening_on`, which are owned from now on."""
        self._listening += listening
        loop = asyncio.get_running_loop()
        for opened in self._listening:
            loop.add_reader(opened, self._accept, opened)
        self._sweep()

    def shut(self) -> None:
        """Stop listening; clients stay connected."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        loop = asyncio.get_running_loop()
        for listening in self._listening:
            loop.remove_reader(listening)
            listening.close()
        self._listening.clear()

    async def close(self) -> None:
        """Stop listening, end all clients, and leave no socket open."""
        self.shut()
        for client in self.clients:
            client.abort()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=CLOSE_S)
        for task in self._tasks:
            task.cancel()
        if self._open:  # connection_lost is called in the next iteration of the loop
            self._is_empty.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._is_empty.wait(), CLOSE_S)
        await asyncio.sleep(0)  # the transport below TLS needs another iteration

    def forget(self, client: TcpClient) -> None:
        """Stop counting a client."""
        if self._clients.get(client.name) is client:
            del self._clients[client.name]
            self._left(client)

    def ended(self, client: TcpClient) -> None:
        """Note that a client's connection has ended."""
        self.forget(client)
        self._open.discard(client)
        if not self._open:
            self._is_empty.set()

    def _accept(self, listening: socket.socket) -> None:
        for _ in range(TURN):
            try:
                connection, name = listening.accept()
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                # errors of a single connection before it was accepted are raised here, too (accept(2))
                if error.errno in EXHAUSTED:
                    self._rest(listening, error)
                    return
                continue
            client = TcpClient(self, connection, name)
            if not self._admits(client):
                connection.close()
                continue
            connection.setblocking(False)
            self._clients[name] = client
            self._open.add(client)
            task = asyncio.get_running_loop().create_task(self._receive(client, connection), name=self._name)
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _receive(self, client: TcpClient, connection: socket.socket) -> None:
        """Connect a client, including the handshake."""
        loop = asyncio.get_running_loop()
        try:
            await loop.connect_accepted_socket(
                lambda: _Counted(self, client, self._make(client)),
                connection,
                ssl=self._context,
                ssl_handshake_timeout=None if self._context is None else HANDSHAKE_S,
            )
        except OSError as error:  # the handshake failed: `ssl.SSLError` is an `OSError`, too
            # its frames and a future reference each other, and keep the handshake's buffers of 256 KiB alive
            error.__traceback__ = None
        finally:
            if not client.is_in:
                self.ended(client)

    def _rest(self, listening: socket.socket, error: OSError) -> None:
        """Pause accepting: waiting clients remain in the kernel's backlog."""
        self._log.warning("%s: nobody can connect: %s", self._name, error.strerror)
        loop = asyncio.get_running_loop()
        loop.remove_reader(listening)
        self._timers[listening] = loop.call_later(REST_S, loop.add_reader, listening, self._accept, listening)

    def flooded(self, client: TcpClient) -> None:
        """Close a client that has sent more than it may."""
        self._log.warning("%s: %s sends too much, closed", self._name, client.peer)
        client.abort()

    def _sweep(self) -> None:
        now_s = time.monotonic()
        for client in self.clients:
            if not client.busy and now_s - client.active_s > self._idle_s:
                if self._tells:
                    self._log.warning("%s: %s is idle, closed", self._name, client.peer)
                client.abort()
        loop = asyncio.get_running_loop()
        self._timers[self] = loop.call_later(min(SWEEP_S, self._idle_s / 4), self._sweep)


class _Counted(asyncio.Protocol):
    """Wrapper of a client's protocol; notifies the listener when it is connected and when it has gone."""

    def __init__(self, listener: TcpListener, client: TcpClient, inner: asyncio.Protocol) -> None:
        self._listener = listener
        self._client = client
        self._inner = inner
        self._is_in = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport was expected")
        if self._listener.client(self._client.name) is not self._client:  # aborted during the handshake
            transport.abort()
            return
        self._is_in = True
        self._client.entered(transport)
        self._inner.connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._listener.ended(self._client)
        if self._is_in:
            self._inner.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if not self._is_in:
            return
        if self._client.may_send(len(data)):
            self._inner.data_received(data)
        else:
            self._listener.flooded(self._client)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received() if self._is_in else None

    def pause_writing(self) -> None:
        if self._is_in:
            self._inner.pause_writing()

    def resume_writing(self) -> None:
        if self._is_in:
            self._inner.resume_writing()


class Rate:
    """Token bucket: per_s tokens a second, and at most as many, or `burst`, at once."""

    def __init__(
        self, per_s: float, clock_s: Callable[[], float] = time.monotonic, *, burst: float | None = None
    ) -> None:
        self._per_s = per_s
        self._most = per_s if burst is None else burst
        self._clock_s = clock_s
        self._left, self._seen_s = self._most, clock_s()

    def take(self, count: float = 1) -> bool:
        """Take this many if they are within the rate; False, and nothing is taken, if not."""
        now_s = self._clock_s()
        self._left = min(self._most, self._left + (now_s - self._seen_s) * self._per_s)
        self._seen_s = now_s
        if self._left < count:
            return False
        self._left -= count
        return True

    def owe(self, count: float) -> None:
        """Take this many, even if there are fewer: the next caller waits longer."""
        self.take(0)
        self._left -= count

    def forfeit(self, seconds: float) -> None:
        """Allow none for this long."""
        self.take(0)
        self._left = min(self._left, 0.0) - seconds * self._per_s


class Rates:
    """A rate for each name; beyond `most` names the least recently used is forgotten."""

    def __init__(self, per_s: float, burst: float, most: int = 1024) -> None:
        self._per_s = per_s
        self._burst = burst
        self._most = most
        self._rates: OrderedDict[str, Rate] = OrderedDict()

    def of(self, name: str) -> Rate:
        """Rate of a name."""
        rate = self._rates.setdefault(name, Rate(self._per_s, burst=self._burst))
        self._rates.move_to_end(name)
        while len(self._rates) > self._most:
            self._rates.popitem(last=False)
        return rate


def _why(error: Exception, port: int) -> str:
    """Reason why a port cannot be listened on, and what to do about it."""
    number = getattr(error, "errno", None)
    if isinstance(error, PermissionError):
        return (
            "ports below 1024 need CAP_NET_BIND_SERVICE (the systemd unit grants it); or choose a port above"
        )
    if number == errno.EADDRINUSE:
        return f"the port is in use; `ss -ltnp sport = :{port}` shows by whom"
    if number == errno.EADDRNOTAVAIL:
        return "no interface of this machine has that address; `ip -br address` shows them"
    return getattr(error, "strerror", None) or str(error)


@lru_cache(1024)
def address_of(host: str) -> Address | None:
    """Parse a peer's address; IPv4 mapped into IPv6 counts as IPv4. None if it is not an address."""
    try:
        address = ip_address(host.partition("%")[0])
    except ValueError:
        return None
    if isinstance(address, IPv6Address) and address.ipv4_mapped is not None:
        return address.ipv4_mapped
    return address


@lru_cache(1024)
def network_of(host: str) -> str:
    """Unit by which limits count peers: an IPv4 address, or a /64 network of IPv6 (RFC 6177)."""
    address = address_of(host)
    if isinstance(address, IPv6Address) and not address.is_link_local:
        return str(IPv6Network((address, 64), strict=False))
    return host if address is None or "%" in host else str(address)


@lru_cache(1024)
def contains(networks: tuple[Network, ...], host: str) -> bool:
    """Whether a peer's address is in one of the networks."""
    address = address_of(host)
    return address is not None and any(address in network for network in networks)
