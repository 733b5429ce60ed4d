"""Viewers of the page: server-sent events with the newest state after each change.

A viewer never delays a cycle: a change only sets a flag for each viewer, which is served in its own task. A
slow one gets the newest state, not every state.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field

from aiohttp import web

from edged.adapters.web.places import least_active
from edged.connections import TcpClient
from edged.payload import Json

PERIOD_S = 0.2
"""Shortest time between two updates of a viewer."""
ALIVE_S = 15.0
"""Without a change, a comment is sent this often: it keeps the connection open and detects dead ones."""
MAX_VIEWERS = 32
WRITE_S = 10.0
"""A viewer that has read nothing for this long counts as gone."""


@dataclass(eq=False, slots=True)
class Viewer:
    """A browser that watches the page. changed : set when there is something new for it."""

    client: TcpClient
    changed: asyncio.Event = field(default_factory=asyncio.Event)


class Viewers:
    """All viewers of the page.

    shown : returns the state of the page. history : returns the points of the trends after a cycle.
    """

    def __init__(self, shown: Callable[[], Awaitable[Json]], history: Callable[[int], list[Json]]) -> None:
        self._shown = shown
        self._history = history
        self._viewers: dict[Viewer, None] = {}  # in order of arrival
        self._closing = False

    def wake(self) -> None:
        """Tell every viewer that there is something new."""
        for viewer in self._viewers:
            viewer.changed.set()

    def close(self) -> None:
        """End every viewer."""
        self._closing = True
        self.wake()

    async def serve(
        self, request: web.Request, client: TcpClient, headers: Mapping[str, str]
    ) -> web.StreamResponse:
        """Send events to one viewer: the whole history once, then the newest state after each change."""
        self._make_room()
        response = web.StreamResponse(headers={**headers, "Content-Type": "text/event-stream"})
        viewer = Viewer(client)
        self._viewers[viewer] = None

        async def write(data: bytes) -> None:
            async with asyncio.timeout(WRITE_S):
                await response.write(data)

        try:
            await response.prepare(request)
            points = self._history(0)
            await write(_event("all", {**await self._shown(), "points": points}))
            while viewer in self._viewers and not self._closing:
                try:
                    await asyncio.wait_for(viewer.changed.wait(), ALIVE_S)
                except TimeoutError:
                    await write(b": alive\n\n")
                    continue
                viewer.changed.clear()
                if viewer in self._viewers and not self._closing:
                    points = self._history(points[-1]["cycle"] if points else 0) or points[-1:]
                    await write(_event("update", {**await self._shown(), "points": points}))
                    await asyncio.sleep(PERIOD_S)
        except (ConnectionResetError, TimeoutError):  # the viewer is gone, or does not read
            client.abort()
        finally:
            self._viewers.pop(viewer, None)
        return response

    def _make_room(self) -> None:
        """When all places are taken, drop the longest idle viewer of the address with most; it reconnects."""
        if len(self._viewers) < MAX_VIEWERS:
            return
        clients = [viewer.client for viewer in self._viewers]
        displaced = least_active(clients, clients)
        for viewer in tuple(self._viewers):
            if viewer.client is displaced:
                del self._viewers[viewer]
                viewer.changed.set()
                viewer.client.abort()


def _event(name: str, data: Json) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n".encode()
