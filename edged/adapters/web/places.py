"""Limits on connections to the page: strangers get few, and people who are let in keep theirs.

A connection counts as a stranger's until a request on it comes from a person who may see the cell.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import contextmanager

from aiohttp import web

from edged.connections import TcpClient, network_of

MAX_CONNECTIONS = 96
"""Most connections at a time; a browser has six, a scraper one. Viewers and sockets leave a third free."""
KEPT = 32
"""Connections reserved for people who are let in."""
OF_ADDRESS = 8
"""Most strangers' connections from one address: as many as a browser opens to the log-in."""
CLIENT = web.RequestKey("client", TcpClient)
"""Key of a request's connection."""


def displaced_by(newcomer: TcpClient, clients: Sequence[TcpClient]) -> tuple[bool, TcpClient | None]:
    """Whether a new connection may stay, and the idle one to close for it, if any.

    clients : all others. Strangers' connections are closed first: at the newcomer's own address if that has
    its share, else at the address with the most; so opening many takes no place from others.
    """
    strangers = [client for client in clients if not client.is_authenticated]
    place = network_of(newcomer.peer)
    own = [client for client in strangers if network_of(client.peer) == place]
    if len(own) >= OF_ADDRESS:
        candidates = [own]
    elif len(strangers) >= MAX_CONNECTIONS - KEPT:
        candidates = [strangers]
    elif len(clients) >= MAX_CONNECTIONS:
        candidates = [strangers, [client for client in clients if client.is_authenticated]]
    else:
        return True, None
    for several in candidates:
        found = least_active([client for client in several if not client.busy], several)
        if found is not None:
            return True, found
    return False, None


def least_active(clients: Sequence[TcpClient], everybody: Sequence[TcpClient]) -> TcpClient | None:
    """The least recently active of those clients whose address has the most connections in `everybody`."""
    count = Counter(network_of(client.peer) for client in everybody)
    return min(clients, key=lambda client: (-count[network_of(client.peer)], client.active_s), default=None)


@contextmanager
def waiting(request: web.Request) -> Iterator[None]:
    """Mark the client as idle while the server waits for its data: it may then be closed to make room."""
    client = request.get(CLIENT)
    if client is None:
        yield
        return
    client.touch()
    try:
        yield
    finally:
        client.touch(busy=True)


async def body_of(request: web.Request) -> AsyncIterator[bytes]:
    """Yield a request's body piece by piece, as it arrives. Raises `web.RequestPayloadError`."""
    while True:
        with waiting(request):
            chunk = await request.content.readany()
        if not chunk:
            return
        yield chunk
