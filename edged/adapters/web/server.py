"""HTTP for the status page, the manual, /metrics, /health and /ready: aiohttp in the daemon's event loop.

Nothing here changes the cell; only the routes of /api/v1 do, and only where commissioning is configured.
"""

from __future__ import annotations

import asyncio
import logging
import math
import socket
import ssl
import time
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from edged.adapters.web.assets import modules, read_assets
from edged.adapters.web.auditing import Auditor, AuditRoutes
from edged.adapters.web.gate import Gate
from edged.adapters.web.login import (
    MAX_FORM_BYTES,
    LoginForms,
    ServedNames,
    cookie_name,
    log_user_status,
    visitor_of,
)
from edged.adapters.web.manualfiles import FOLDER, is_built
from edged.adapters.web.overview import OverviewRoutes
from edged.adapters.web.page import PageSources, StatusPage
from edged.adapters.web.pages import PageFacts, PageHandlers, html
from edged.adapters.web.people import People
from edged.adapters.web.places import CLIENT, displaced_by
from edged.adapters.web.routes import BASE, RouteTable
from edged.adapters.web.settings import WebSettings, page_context
from edged.adapters.web.setup import SetupRoutes
from edged.adapters.web.sockets import Sockets
from edged.adapters.web.viewers import Viewers
from edged.cell.lease.live import LivePictures
from edged.cell.lease.notices import Notices
from edged.config.fields import is_loopback
from edged.connections import Rate, Rates, TcpClient, TcpListener, network_of
from edged.domain.cell import CellState
from edged.domain.events import Event, Idle
from edged.errors import LinkError, ListenError
from edged.identity.access import Access
from edged.identity.attempts import TooManyAttempts
from edged.identity.audit import AuditEntry, AuditFile
from edged.identity.invite import Invite
from edged.identity.users import UserFile
from edged.identity.visitors import Visitor
from edged.logs import LogLimit
from edged.ports import Commissioner
from edged.report.page import render

log = logging.getLogger(__name__)

IDLE_S = 15.0
"""Limit from connecting to the first whole request, between a response and the next request, and for reading
a response."""
HANDSHAKES_PER_S, HANDSHAKES_OF_ADDRESS_PER_S = 50.0, 10.0
"""Limits of TLS handshakes, in total and of one address; each takes a millisecond of the event loop."""
REQUESTS_PER_S, REQUESTS_AT_ONCE = 200.0, 1000.0
"""Limits of one session, or of all clients at one address without a session.

A refused request takes some 0.3 ms of the event loop; a viewer asks for three pictures of five cycles a
second, and a page that is being opened for some eighty files.
"""
FLOODED_S = 5.0
"""How long requests of a client that flooded a socket are refused."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with none, browsers leave out the Origin of a form
    "Cache-Control": "no-store",
}
FREE = {"/health", "/ready", "/login", "/static/login.css", "/static/icon.svg"}
"""Paths served without a password: they reveal nothing about what the cell produces."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


async def _no_metrics() -> bytes:
    return b""


class _ServerLog(logging.LoggerAdapter[logging.Logger]):
    """aiohttp's log of failed requests, rate-limited, since strangers can cause as many as they like.

    Bytes that are not HTTP give one line, without the parser's details; disconnects are not logged.
    """

    def __init__(self) -> None:
        super().__init__(log, None)
        self._limit, self._traces = LogLimit(__name__), LogLimit(__name__)

    def exception(self, msg: object, *args: object, exc_info: Any = True, **_more: Any) -> None:
        """Log the failure of a request."""
        if isinstance(exc_info, HttpProcessingError | web.RequestPayloadError):
            peer = args[0] if args else "somebody"
            self._limit.warning("status page: %s sent what is no HTTP, closed", peer)
        elif not isinstance(exc_info, ConnectionError):
            self._traces.error(str(msg), *args, exc_info=exc_info)


@dataclass(frozen=True, slots=True, eq=False)
class SettingUp:
    """Services for setting the cell up. commissioner : takes requests for SETUP; None: there is no set-up.

    notices, live : sources of notices and live pictures; None: the server makes its own. routes : objects
    with further routes.
    """

    commissioner: Commissioner | None = None
    notices: Notices | None = None
    live: LivePictures | None = None
    routes: Sequence[object] = ()


class WebPublisher:
    """Serves the page and the manual (`edged.ports.Publisher`).

    manual : folder that the manual was built into. context : result of `page_context`; None: read by `start`.
    setup : services for setting the cell up, if the settings allow it. metrics : returns text in Prometheus'
    format.
    """

    def __init__(
        self,
        cell: str,
        settings: WebSettings,
        sources: PageSources,
        metrics: Callable[[], Awaitable[bytes]] | None = None,
        *,
        manual: Path = FOLDER,
        context: ssl.SSLContext | None = None,
        setup: SettingUp | None = None,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._cell = cell
        self._clock_s = clock_s
        self._sources = sources
        self._setup = setup = setup or SettingUp()
        self._notices = setup.notices or Notices()
        self._sockets: Sockets | None = None
        self._setup_page = dict[bool, str]()
        self._manual = manual
        self._taking: SetupRoutes | None = None
        self._settings = settings
        self._context = context
        self._page = StatusPage(cell, sources)
        is_set_up = settings.commissioning and setup.commissioner is not None
        state = settings.state if is_set_up else None
        self._users = None if state is None else UserFile(state / "users.json")
        self._invite = None if state is None else Invite(state)
        self._audit = None if state is None else AuditFile(state)
        self._auditor = Auditor(self._audit)
        self._access = Access(
            settings.password_hash,
            clock_s,
            cookie=cookie_name(cell, secure=settings.certificate is not None),
            metrics_hash=settings.metrics_password_hash,
            users=self._users,
            invite=self._invite,
        )
        self._names = ServedNames(settings)
        self._drawer = ThreadPoolExecutor(1, thread_name_prefix="web")
        self._assets = read_assets()
        facts = PageFacts(cell, not self._access.is_open, is_set_up, settings.links)
        self._handlers = PageHandlers(
            facts, self._page, self._drawer, self._assets, manual, metrics or _no_metrics
        )
        self._viewers = Viewers(self._handlers.status, self._page.history)
        self._runner: web.AppRunner | None = None
        self._listener: TcpListener | None = None
        self._handshakes = Rate(HANDSHAKES_PER_S)
        self._handshakes_of = Rates(HANDSHAKES_OF_ADDRESS_PER_S, HANDSHAKES_OF_ADDRESS_PER_S)
        self._requests = Rates(REQUESTS_PER_S, REQUESTS_AT_ONCE)
        self._limit = LogLimit(__name__)

    @property
    def port(self) -> int:
        """The listening port; 0 when closed."""
        return self._listener.port if self._listener is not None else 0

    async def start(self, listening: Sequence[socket.socket] | None = None) -> None:
        """Listen on the given open sockets, or at the address in the settings. Raises `ListenError`."""
        settings = self._settings
        context = self._context or page_context(settings)
        if context is None and settings.password_hash and not is_loopback(settings.host):
            log.warning("the status page sends its password in the clear: set web.certificate and web.key")
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_FORM_BYTES)
        app.on_response_prepare.append(self._guard_answer)
        secure = settings.certificate is not None
        forms = LoginForms(
            self._cell, self._access, self._auditor, users=self._users is not None, secure=secure
        )
        forms.add_to(app.router)
        app.router.add_get("/events", self._events)
        self._handlers.add_to(app.router)
        if settings.commissioning and self._setup.commissioner is not None:
            self._api(self._setup.commissioner).add_to(app.router)
            app.router.add_get("/setup", self._show_setup)
        self._runner = runner = web.AppRunner(
            app,
            handle_signals=False,
            access_log=None,
            shutdown_timeout=0.5,
            logger=_ServerLog(),
            auto_decompress=False,  # else a stranger's kilobytes expand to megabytes, in the event loop
        )
        await runner.setup()
        protocol = runner.server
        if protocol is None:
            raise RuntimeError("aiohttp's runner was set up and has no server")
        self._listener = TcpListener(
            "status page", lambda _client: protocol(), self._admit, idle_s=IDLE_S, context=context
        )
        try:
            if listening is None:
                await self._listener.open(settings.host, settings.port)
            else:
                self._listener.take(listening)
        except ListenError:
            await self.close()
            raise
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        place = f"{'https' if context is not None else 'http'}://{host}:{self.port}"
        log.info("status page: %s", place)
        if self._users is not None and self._invite is not None:
            log_user_status(self._users, self._invite, place)

    def _api(self, commissioner: Commissioner) -> Gate:
        """The API for setting the cell up: the routes that every cell has, and further ones."""
        table = RouteTable()
        self._taking = setup = SetupRoutes(commissioner, self._drawer)
        overview = OverviewRoutes(self._cell, self._page, self._sources, setup, table, self._access.cookie)
        table.add(setup, overview)
        if self._users is not None:
            table.add(People(self._access, self._users))
        if self._audit is not None:
            table.add(AuditRoutes(self._audit))
        live = self._setup.live or LivePictures(commissioner, self._notices)
        self._sockets = Sockets(
            live,
            self._notices,
            self._drawer,
            self._access,
            overview,
            setup.holds,
            lambda request: self._rate(request).forfeit(FLOODED_S),
        )
        table.add(self._sockets, *self._setup.routes)
        offers = sorted({route.plain_path.removeprefix(f"{BASE}/") for route in table})
        named = {"cell": self._cell, "modules": modules(self._assets), "offers": offers}
        self._setup_page = {
            built: render("setup.html", __package__, manual=built, **named) for built in (False, True)
        }
        return Gate(table, commissioner, self._access, self._auditor, setup.holds, self._clock_s)

    def announce(self, event: Event) -> None:
        """Take an event into account and wake the viewers."""
        had_error = self._page.has_error
        is_new = self._page.take(event)
        if is_new:
            self._viewers.wake()
        if self._taking is not None and isinstance(event, CellState) and self._taking.ended_by(event):
            self._auditor.post(
                AuditEntry("", "", "", "end", "setup", "ok", reason="by the plant (AUTO_LOCK)")
            )
        if is_new or isinstance(event, Idle):
            self._auditor.note_run(self._sources.fingerprint())
        # each second, too: the owner of the PLC's write right and AUTO_LOCK change without an event
        if self._sockets is not None and (is_new or isinstance(event, Idle)):
            self._sockets.cell_changed(at_once=self._page.has_error is not had_error)

    async def close(self) -> None:
        """End every viewer and release all resources."""
        self._viewers.close()
        if self._sockets is not None:
            await self._sockets.close()
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.shut()
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None
        if listener is not None:
            await listener.close()
        await self._auditor.close()
        await asyncio.to_thread(self._drawer.shutdown, wait=True, cancel_futures=True)

    # --- every connection --------------------------------------------------------------------

    def _admit(self, newcomer: TcpClient) -> bool:
        """Whether a new connection may stay; where all places are taken, an idle one is closed for it."""
        listener = self._listener
        if listener is None:
            return False
        place = network_of(newcomer.peer)
        is_tls = self._settings.certificate is not None
        if is_tls and not (self._handshakes_of.of(place).take() and self._handshakes.take()):
            self._limit.warning("status page: %s closed, too many TLS handshakes", newcomer.peer)
            return False
        if not self._requests.of(place).take():
            self._limit.warning("status page: %s closed, too many connections", newcomer.peer)
            return False
        clients = listener.clients
        may_stay, displaced = displaced_by(newcomer, clients)
        if displaced is not None or not may_stay:
            self._limit.warning("status page: %d connections, one of them %s", len(clients), newcomer.peer)
        if displaced is not None:
            displaced.abort()
        return may_stay

    def _client(self, request: web.Request) -> TcpClient | None:
        """The client of a request; None when it is gone."""
        transport, listener = request.transport, self._listener
        if transport is None or listener is None:
            return None
        return listener.client(transport.get_extra_info("peername"))

    async def _events(self, request: web.Request) -> web.StreamResponse:
        client = request.get(CLIENT)
        if client is None:  # it is gone
            return web.Response(status=503)
        return await self._viewers.serve(request, client, HEADERS)

    # --- every request -----------------------------------------------------------------------

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        client = self._client(request)
        if client is None:  # it is gone
            return web.Response(status=503)
        # buffered requests are read without waiting: give others their turn
        await asyncio.sleep(0)
        if not self._rate(request).take():
            self._limit.warning("status page: %s closed, too many requests", client.peer)
            response = web.Response(status=429, text="too many requests\n", headers=HEADERS)
            response.force_close()
            return response
        request[CLIENT] = client
        client.touch(busy=True)
        try:
            return await self._answer(request, handler)
        finally:
            client.touch()

    async def _guard_answer(self, request: web.Request, response: web.StreamResponse) -> None:
        """Count also requests that aiohttp answers before our handlers are called (`Expect:`)."""
        if CLIENT in request:
            return
        await asyncio.sleep(0)
        if not self._rate(request).take():
            response.force_close()

    def _rate(self, request: web.Request) -> Rate:
        """Rate limit of the session, else of the address: strangers use up nothing of a session's."""
        visitor = self._visitor(request)
        return self._requests.of(visitor.session if visitor is not None else network_of(request.remote or ""))

    async def _answer(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            host = request.headers.get("Host")
            if host is not None and not self._names.has(host):  # browsers always send one
                self._limit.warning("status page: %s asked for %r, not in web.names", request.remote, host)
                raise web.HTTPMisdirectedRequest(text="this host name is not served here\n")
            if "Content-Encoding" in request.headers:
                raise web.HTTPUnsupportedMediaType(text="expected a body that is not compressed\n")
            is_authorised = await self._is_authorised(request)
            request[CLIENT].is_authenticated = is_authorised
            if not (is_authorised or self._is_free(request)):
                is_page = request.path in ("/", "/setup") or request.path.startswith("/manual")
                if is_page and "text/html" in request.headers.get("Accept", ""):
                    raise web.HTTPSeeOther("/login?to=setup" if request.path == "/setup" else "/login")
                # the pages have a log-in form of their own; a scraper needs to know the scheme
                asked = {"WWW-Authenticate": 'Basic realm="edged"'} if request.path == "/metrics" else {}
                raise web.HTTPUnauthorized(text="log in first\n", headers=asked)
            response = await handler(request)
        except web.HTTPException as error:
            error.headers.update(HEADERS)
            raise
        except LinkError as error:
            response = web.Response(status=503, text=f"{error}\n")
        except TooManyAttempts as error:
            response = web.Response(status=429, text=f"{error}\n")
            response.headers["Retry-After"] = f"{math.ceil(error.wait_s)}"
        if not response.prepared:
            for name, value in HEADERS.items():
                response.headers.setdefault(name, value)
        return response

    async def _is_authorised(self, request: web.Request) -> bool:
        """Whether the sender may see the cell, or the metrics if these are requested."""
        if self._access.is_open or self._visitor(request) is not None:
            return True
        address, header = request.remote or "", request.headers.get("Authorization", "")
        if not header or self._is_free(request):
            return False
        if request.path == "/metrics" and await self._access.may_read_metrics(address, header):
            return True
        return await self._access.has_basic(address, header)

    def _is_free(self, request: web.Request) -> bool:
        """Whether the path is served without a password."""
        return request.path in FREE or (self._users is not None and request.path == "/invite")

    def _visitor(self, request: web.Request) -> Visitor | None:
        """Visitor whose session sent a request, if any."""
        return visitor_of(self._access, request)

    async def _show_setup(self, request: web.Request) -> web.Response:
        if self._users is not None and self._visitor(request) is None:  # its WebSocket would be refused
            raise web.HTTPSeeOther("/login?to=setup" if self._users.has_engineer else "/invite")
        return html(self._setup_page[is_built(self._manual)])
