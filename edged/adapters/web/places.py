"""Who may connect to the page: strangers have few places, and people who are let in keep theirs.

A connection is a stranger's until a request on it came from somebody who may see the cell.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import contextmanager

from aiohttp import web

from edged.connections import TcpClient, network_of

MAX_CONNECTIONS = 96
"""Connections at a time; a browser has six, a scraper one. Viewers and sockets leave a third of them."""
KEPT = 32
"""Connections kept for people who are let in."""
OF_ADDRESS = 8
"""Strangers at one address: a browser's connections to the log-in."""
CLIENT = web.RequestKey("client", TcpClient)
"""The connection of a request."""


def displaced_by(newcomer: TcpClient, clients: Sequence[TcpClient]) -> tuple[bool, TcpClient | None]:
    """Whether a new connection may stay, and the idle one that makes room for it, if that is needed.

    clients : all others. A stranger's makes room first, at the newcomer's own address where that has its
    share; else the one of the address that has most: opening many takes no place from others.
    """
    strangers = [client for client in clients if not client.is_let_in]
    place = network_of(newcomer.peer)
    own = [client for client in strangers if network_of(client.peer) == place]
    if len(own) >= OF_ADDRESS:
        candidates = [own]
    elif len(strangers) >= MAX_CONNECTIONS - KEPT:
        candidates = [strangers]
    elif len(clients) >= MAX_CONNECTIONS:
        candidates = [strangers, [client for client in clients if client.is_let_in]]
    else:
        return True, None
    for several in candidates:
        found = least_active([client for client in several if not client.busy], several)
        if found is not None:
            return True, found
    return False, None


def least_active(clients: Sequence[TcpClient], everybody: Sequence[TcpClient]) -> TcpClient | None:
    """The least recently active of those clients whose address has the most connections of all."""
    count = Counter(network_of(client.peer) for client in everybody)
    return min(clients, key=lambda client: (-count[network_of(client.peer)], client.active_s), default=None)


@contextmanager
def waiting(request: web.Request) -> Iterator[None]:
    """Meanwhile its client has to send something: nothing is done for it, and it may have to make room."""
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
    """A request's body piece by piece, as it comes. Raises `web.RequestPayloadError`."""
    while True:
        with waiting(request):
            chunk = await request.content.readany()
        if not chunk:
            return
        yield chunk
