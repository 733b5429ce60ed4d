"""The WebSocket of a tab: the cell's state, drafts and tasks as they change, and live pictures.

Every tab has its own task and gets only the newest of everything: a slow one gets fewer pictures, but never
late ones, since the next is sent after the last was shown. A pair is encoded once for all, in an executor.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any, Literal

from aiohttp import WSCloseCode, WSMsgType, web
from pydantic import Field, ValidationError

from edged.adapters.web.login import visitor_of
from edged.adapters.web.overview import OverviewRoutes
from edged.adapters.web.places import CLIENT
from edged.adapters.web.routes import WEBSOCKET, Body, Call, Problem, Token, route
from edged.cell.lease.live import LivePictures
from edged.cell.lease.notices import Notices
from edged.cell.tasks import cancel_and_await
from edged.connections import Rate
from edged.domain.frames import FramePair
from edged.errors import SetupRefused
from edged.identity.access import Access
from edged.identity.visitors import Role, Visitor
from edged.logs import LogLimit
from edged.payload import Json
from edged.pictures.encoding import jpeg

MAX_SOCKETS, OF_SESSION = 32, 4
"""Most sockets in total, and of one session."""
KEPT = 16
"""Sockets reserved for users: visitors with only the page's password share the rest."""
MESSAGE_BYTES = 1024
"""Largest message of a tab."""
MESSAGES_PER_S, MESSAGES_AT_ONCE = 60.0, 120.0
"""Limits of a tab's messages, pings included; it sends one per live pair, 20 a second.

The period of live pairs is `edged.cell.lease.live.PERIOD_S`.
"""
PERIOD_S = 0.2
"""Shortest time between two states of the cell that are sent."""
PING_S = 15.0
WRITE_S = 10.0
"""A tab that has read nothing for this long counts as gone."""
CLOSE_S = 0.3
"""Time for a tab to answer the close frame."""
WIDTH_PX = 960
"""Width of the pictures sent."""
QUALITY = 75
LOGGED_OUT = 4401
"""Close code for an ended session: the page then asks for the password."""


class FromTab(Body):
    """Message from a tab."""

    live: bool | None = Field(None, description="whether pictures are wanted, by the holder of the cell")
    token: Token | None = None
    active: Literal[True] | None = Field(None, description="somebody touched the screen, or a key")
    seen: int | None = Field(None, ge=0, description="the picture that was shown last: the next may come")


@dataclass(frozen=True, slots=True)
class _Encoded:
    """A live pair ready to send. about : JSON that describes it. pictures : left and right, with headers."""

    number: int
    about: str
    pictures: tuple[bytes, bytes]


@dataclass(eq=False, slots=True)
class _Tab:
    """One socket. user : "" with only the page's password. last : number of the last pair given to it.

    notes : notices not yet sent, the newest of each kind and id.
    """

    request: web.Request
    socket: web.WebSocketResponse
    session: str
    user: str
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    ended: asyncio.Event = field(default_factory=asyncio.Event)
    notes: dict[tuple[str, object], str] = field(default_factory=dict)
    cell: Json | None = None
    is_cell_due: bool = True
    has_seen: bool = True
    last: int = 0
    frame: _Encoded | None = None


class Sockets:
    """The sockets of all tabs.

    encoder : executor that encodes pictures. overview : gives the cell as a session sees it. holds : whether
    a session has taken the cell. flooded : called for a client that sent too much.
    """

    def __init__(
        self,
        live: LivePictures,
        notices: Notices,
        encoder: Executor,
        access: Access,
        overview: OverviewRoutes,
        holds: Callable[[str], bool],
        flooded: Callable[[web.Request], None],
    ) -> None:
        self._access = access
        self._holds = holds
        self._flooded = flooded
        self._log = LogLimit(__name__)
        self._live = live
        self._encoder = encoder
        self._overview = overview
        self._tabs: dict[_Tab, None] = {}
        self._newest: tuple[int, FramePair] | None = None
        self._encoding: asyncio.Task[None] | None = None
        self._telling: asyncio.TimerHandle | None = None
        self._closing = False
        self._stops = (live.listen(self._take), notices.listen(self._note))

    def cell_changed(self, *, at_once: bool) -> None:
        """Send every tab the cell's state within `PERIOD_S`.

        at_once : also right now; else of a cell whose faults come and go in step with the period, only the
        faults might be seen.
        """
        if at_once:
            self._tell_cell()
        if self._tabs and self._telling is None:
            self._telling = asyncio.get_running_loop().call_later(PERIOD_S, self._tell_later)

    async def close(self) -> None:
        """Close every socket, and take no further events."""
        self._closing = True
        for stop in self._stops:
            stop()
        if self._telling is not None:
            self._telling.cancel()
        tabs = tuple(self._tabs)
        for tab in tabs:
            tab.wake.set()
        if self._encoding is not None:
            await cancel_and_await(self._encoding)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2 * CLOSE_S):
                for tab in tabs:
                    await tab.ended.wait()

    # --- what is sent ------------------------------------------------------------------------

    def _tell_later(self) -> None:
        self._telling = None
        self._tell_cell()

    def _tell_cell(self) -> None:
        for tab in self._tabs:
            tab.is_cell_due = True
            tab.wake.set()

    def _note(self, kind: str, document: Mapping[str, Any]) -> None:
        if not self._tabs:
            return
        text = json.dumps({"type": kind, **document}, separators=(",", ":"))
        for tab in self._tabs:
            tab.notes.pop((kind, document.get("id")), None)
            tab.notes[kind, document.get("id")] = text
            tab.wake.set()

    def _take(self, number: int, pair: FramePair) -> None:
        self._newest = (number, pair)
        self._feed()

    def _feed(self) -> None:
        """Encode the newest pair for tabs that have seen the last one, unless one is being encoded."""
        if self._encoding is None and self._newest is not None and self._hungry(self._newest[0]):
            self._encoding = asyncio.create_task(self._encode(), name="live pictures")

    def _hungry(self, number: int) -> list[_Tab]:
        return [tab for tab in self._tabs if tab.has_seen and tab.last < number]

    async def _encode(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            while self._newest is not None and self._hungry(self._newest[0]):
                encoded = await loop.run_in_executor(self._encoder, _encoded, *self._newest)
                for tab in self._hungry(encoded.number):
                    tab.frame, tab.has_seen, tab.last = encoded, False, encoded.number
                    tab.wake.set()
        finally:
            self._encoding = None

    # --- a tab -------------------------------------------------------------------------------

    @route(
        "GET",
        "/ws",
        "State, drafts, tasks and live pictures as they change",
        role=Role.VIEWER,
        answer=WEBSOCKET,
    )
    async def _serve(self, call: Call[None]) -> web.WebSocketResponse:
        self._check_limits(call.visitor)
        socket = web.WebSocketResponse(
            timeout=CLOSE_S, heartbeat=PING_S, max_msg_size=MESSAGE_BYTES, compress=False, autoping=False
        )
        if not socket.can_prepare(call.request).ok:
            raise Problem(426, "websocket", "expected a WebSocket handshake")
        tab = _Tab(call.request, socket, call.visitor.session, call.visitor.name)
        self._tabs[tab] = None
        telling: asyncio.Task[None] | None = None
        try:
            await socket.prepare(call.request)
            client = call.request.get(CLIENT)
            if client is not None:  # counts frames of unfinished messages, too
                client.limit(MESSAGES_PER_S * MESSAGE_BYTES, MESSAGES_AT_ONCE * MESSAGE_BYTES)
            tab.wake.set()
            telling = asyncio.create_task(self._tell(tab), name="tab")
            await self._hear(tab)
            if client is not None and client.has_flooded:
                self._flooded(tab.request)
        finally:
            self._live.unwant(tab)
            self._tabs.pop(tab, None)
            if telling is not None:
                if self._closing:  # it sends the close frame
                    await asyncio.wait({telling}, timeout=CLOSE_S)
                await cancel_and_await(telling)
            tab.ended.set()
        return socket

    def _check_limits(self, visitor: Visitor) -> None:
        """Check that one more tab may be open. Raises `Problem`."""
        limits = [
            (sum(tab.session == visitor.session for tab in self._tabs), OF_SESSION),
            (len(self._tabs), MAX_SOCKETS),
        ]
        if not visitor.name:
            limits.append((sum(not tab.user for tab in self._tabs), MAX_SOCKETS - KEPT))
        for count, most in limits:
            if count >= most:
                raise Problem(503, "sockets", f"{most} pages are open already: close some")

    async def _hear(self, tab: _Tab) -> None:
        """Read a tab's messages until it closes, floods, or sends an invalid one."""
        rate = Rate(MESSAGES_PER_S, burst=MESSAGES_AT_ONCE)
        async for message in tab.socket:
            await asyncio.sleep(0)  # buffered messages are read without waiting: give others their turn
            if not rate.take():
                self._log.warning(
                    "status page: %s sends too much over its socket, closed", tab.request.remote
                )
                self._flooded(tab.request)
                await _cut(tab.socket)
                return
            if message.type is WSMsgType.PING:
                await tab.socket.pong(message.data)
            if message.type in (WSMsgType.PING, WSMsgType.PONG):
                continue
            visitor = visitor_of(self._access, tab.request)
            if visitor is None:
                await tab.socket.close(code=LOGGED_OUT)
                return
            try:
                if message.type is not WSMsgType.TEXT:
                    raise ValueError("expected text")
                await self._obey(tab, visitor, FromTab.model_validate_json(message.data))
            except (ValidationError, ValueError):
                await tab.socket.close(code=WSCloseCode.POLICY_VIOLATION)
                return

    async def _obey(self, tab: _Tab, visitor: Visitor, wish: FromTab) -> None:
        if wish.seen is not None:
            tab.has_seen = True
            self._live.seen(tab)
            self._feed()
        if wish.active:
            self._access.note_activity(tab.session)
        if wish.live is False:
            self._live.unwant(tab)
        if wish.live:
            if visitor.role < Role.ENGINEER:
                code, why = ("idle", "say your password again") if visitor.is_idle else ("role", "")
                self._refuse(tab, code, why or "only an engineer may")
                return
            try:
                if not self._holds(tab.session):
                    raise SetupRefused("the cell was not taken in this session, or not any more")
                await self._live.want(tab, wish.token or "")
            except SetupRefused as error:
                self._refuse(tab, "setup_refused", str(error))

    def _refuse(self, tab: _Tab, code: str, detail: str) -> None:
        refused = {"type": "live", "on": self._live.is_on, "code": code, "detail": detail}
        tab.notes["live", None] = json.dumps(refused)
        tab.wake.set()

    async def _tell(self, tab: _Tab) -> None:
        """Send what is new, as fast as the tab reads it."""
        try:
            while not self._closing:
                await tab.wake.wait()
                tab.wake.clear()
                if visitor_of(self._access, tab.request) is None:
                    await tab.socket.close(code=LOGGED_OUT)
                    return
                async with asyncio.timeout(WRITE_S):
                    await self._send(tab)
            await tab.socket.close(code=WSCloseCode.GOING_AWAY)
        except (ConnectionError, TimeoutError):  # the tab is gone, or does not read
            if tab.request.transport is not None:
                tab.request.transport.abort()

    async def _send(self, tab: _Tab) -> None:
        if tab.is_cell_due:
            tab.is_cell_due = False
            cell = self._overview.now(tab.session).model_dump()
            if cell != tab.cell:
                tab.cell = cell
                await tab.socket.send_json({"type": "cell", **cell})
        notes, tab.notes = tab.notes, {}
        for note in notes.values():
            await tab.socket.send_str(note)
        frame, tab.frame = tab.frame, None
        if frame is not None:
            await tab.socket.send_str(frame.about)
            for picture in frame.pictures:
                await tab.socket.send_bytes(picture)


async def _cut(socket: web.WebSocketResponse) -> None:
    """Close without waiting for the answer: until it came, the flood would have to be read."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(0):
            await socket.close(code=WSCloseCode.POLICY_VIOLATION)


def _encoded(number: int, pair: FramePair) -> _Encoded:
    height, width = pair.left.image.shape
    about = {
        "type": "live",
        "on": True,
        "code": None,
        "detail": None,
        "number": number,
        "width": width,
        "height": height,
        "exposed_ns": pair.exposed_ns,
        "skew_ms": abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-6,
    }
    head = number.to_bytes(8, "big")
    return _Encoded(
        number,
        json.dumps(about, separators=(",", ":")),
        (
            b"\0" + head + jpeg(pair.left.image, QUALITY, WIDTH_PX),
            b"\1" + head + jpeg(pair.right.image, QUALITY, WIDTH_PX),
        ),
    )
