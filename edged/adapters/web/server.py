"""HTTP for the status page, the manual, /metrics, /health and /ready: aiohttp in the daemon's loop.

A viewer never delays a cycle: `announce` only sets a flag for each viewer, who is served in its own task;
a slow one gets the newest state, not all of them. Nothing here changes the cell.
"""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
import math
import ssl
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from urllib.parse import parse_qs

from aiohttp import web

from edged.adapters.web.access import Access, TooManyAttempts
from edged.adapters.web.manualfiles import FOLDER, Manual, read_manual
from edged.adapters.web.page import Page, Sources, picture
from edged.domain import Event, Side
from edged.errors import ListenError
from edged.payload import Json
from edged.report.page import render

log = logging.getLogger(__name__)

PERIOD_S = 0.2
"""A viewer hears of changes this often at most."""
ALIVE_S = 15.0
"""Without a change, a comment keeps the connection open and finds out who has gone."""
MAX_VIEWERS = 32
MAX_FORM_BYTES = 4096
COOKIE = "edged_session"
CACHED_PICTURES = 4
STATIC = {
    "app.js": "text/javascript",
    "style.css": "text/css",
    "login.css": "text/css",
    "icon.svg": "image/svg+xml",
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
FREE = {"/health", "/ready", "/login", "/static/login.css", "/static/icon.svg"}
"""Answered without a password: they say nothing of what the cell makes."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Where and for whom.

    password_hash : Argon2; "" is for loopback only.  certificate, key : PEM, both or none.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    password_hash: str = ""
    certificate: Path | None = None
    key: Path | None = None


class WebPublisher:
    """Serves the page and the manual (`edged.ports.Publisher`).

    manual : folder that it was built into. context : `page_context`; None: read at the start.
    """

    def __init__(
        self,
        cell: str,
        settings: WebSettings,
        sources: Sources,
        *,
        manual: Path = FOLDER,
        context: ssl.SSLContext | None = None,
    ) -> None:
        self._settings = settings
        self._context = context
        self._page = Page(cell, sources)
        self._access = Access(settings.password_hash)
        self._manual_folder = manual
        self._manual: Manual | None = None
        self._viewers: set[asyncio.Event] = set()
        self._pictures: OrderedDict[tuple[int, str], bytes] = OrderedDict()
        self._drawer = ThreadPoolExecutor(1, thread_name_prefix="web")
        self._html = {name: render(f"{name}.html", __package__) for name in ("index", "login", "nomanual")}
        self._runner: web.AppRunner | None = None
        self._closing = False

    @property
    def port(self) -> int:
        """The port that is listened on."""
        addresses = self._runner.addresses if self._runner is not None else []
        return int(addresses[0][1]) if addresses else 0

    async def start(self) -> None:
        """Listen. Raises `ListenError`."""
        settings = self._settings
        context = self._context or page_context(settings)
        if context is None and settings.password_hash and not is_loopback(settings.host):
            log.warning("the status page sends its password in the clear: set web.certificate and web.key")
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_FORM_BYTES)
        app.router.add_get("/", self._index)
        app.router.add_get("/login", self._login_form)
        app.router.add_post("/login", self._log_in)
        app.router.add_post("/logout", self._log_out)
        app.router.add_get("/events", self._events)
        app.router.add_get("/status.json", self._status)
        app.router.add_get("/registers.json", self._registers)
        app.router.add_get("/picture/{cycle:[0-9]{1,15}}/{side:left|right}", self._picture)
        app.router.add_get("/static/{name}", self._static)
        app.router.add_get("/manual", self._manual_index)
        app.router.add_get("/manual/{path:.*}", self._manual_file)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_get("/health", self._health)
        app.router.add_get("/ready", self._ready)
        self._runner = web.AppRunner(app, handle_signals=False, access_log=None, shutdown_timeout=0.5)
        await self._runner.setup()
        try:
            await web.TCPSite(self._runner, settings.host, settings.port, ssl_context=context).start()
        except OSError as error:
            await self.close()
            place = f"{settings.host}:{settings.port}"
            raise ListenError(f"status page on {place}: {error.strerror or error}") from error

    def announce(self, event: Event) -> None:
        """Note the event and wake the viewers."""
        if self._page.take(event):
            for viewer in self._viewers:
                viewer.set()

    async def close(self) -> None:
        """End every viewer and leave nothing behind."""
        self._closing = True
        for viewer in self._viewers:
            viewer.set()
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None
        await asyncio.to_thread(self._drawer.shutdown, wait=True, cancel_futures=True)

    # --- every request -----------------------------------------------------------------------

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            if not self._is_our_host(request):
                raise web.HTTPMisdirectedRequest(text="this host name is not served here\n")
            if not await self._may_see(request):
                is_page = request.path == "/" or request.path.startswith("/manual")
                if is_page and "text/html" in request.headers.get("Accept", ""):
                    raise web.HTTPSeeOther("/login")
                # a browser's page asks with its own form; a scraper must be told how
                asked = {"WWW-Authenticate": 'Basic realm="edged"'} if request.path == "/metrics" else {}
                raise web.HTTPUnauthorized(text="log in first\n", headers=asked)
            response = await handler(request)
        except web.HTTPException as error:
            error.headers.update(HEADERS)
            raise
        except TooManyAttempts as error:
            response = web.Response(status=429, text=f"{error}\n")
            response.headers["Retry-After"] = f"{math.ceil(error.wait_s)}"
        if not response.prepared:
            for name, value in HEADERS.items():
                response.headers.setdefault(name, value)
        return response

    def _is_our_host(self, request: web.Request) -> bool:
        """A page elsewhere must not reach a cell without password through a name of its own (rebinding)."""
        if not self._access.is_open:
            return True
        name = request.host.rsplit(":", 1)[0].strip("[]") if request.host else ""
        return name == self._settings.host or is_loopback(name)

    async def _may_see(self, request: web.Request) -> bool:
        if self._access.is_open or request.path in FREE:
            return True
        if self._access.has_session(request.cookies.get(COOKIE, "")):
            return True
        header = request.headers.get("Authorization", "")
        return bool(header) and await self._access.has_basic(request.remote or "", header)

    # --- pages -------------------------------------------------------------------------------

    async def _index(self, _request: web.Request) -> web.Response:
        return _text(self._html["index"], "text/html")

    async def _static(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in STATIC:
            raise web.HTTPNotFound
        return _file(name, STATIC[name])

    async def _manual_index(self, _request: web.Request) -> web.Response:
        raise web.HTTPMovedPermanently("/manual/")

    async def _manual_file(self, request: web.Request) -> web.StreamResponse:
        """One file of the manual: a name that was there when it was first asked for, and no other."""
        if self._manual is None:
            self._manual = await asyncio.to_thread(read_manual, self._manual_folder)
        if self._manual is None:
            response = _text(self._html["nomanual"], "text/html")
            response.set_status(404)
            return response
        path = request.match_info["path"] or "index.html"
        file = self._manual.files.get(path)
        if file is None:
            raise web.HTTPNotFound(text="the manual has no such page\n")
        return web.FileResponse(file, headers=self._manual.headers(path))

    async def _login_form(self, _request: web.Request) -> web.Response:
        return _text(self._html["login"], "text/html")

    async def _log_in(self, request: web.Request) -> web.Response:
        # not `request.post()`: it fails on what a browser would not send, other character sets for example
        form = parse_qs((await request.read()).decode("ascii", "replace"))
        password = form.get("password", [""])[0]
        cookie = await self._access.log_in(request.remote or "", password) if password else None
        if cookie is None:
            log.warning("status page: wrong password from %s", request.remote)
            raise web.HTTPSeeOther("/login?wrong")
        answer = web.HTTPSeeOther("/")
        secure = self._settings.certificate is not None
        answer.set_cookie(COOKIE, cookie, httponly=True, samesite="Strict", secure=secure, path="/")
        raise answer

    async def _log_out(self, request: web.Request) -> web.Response:
        self._access.log_out(request.cookies.get(COOKIE, ""))
        answer = web.HTTPSeeOther("/login")
        answer.del_cookie(COOKIE, path="/")
        raise answer

    # --- data --------------------------------------------------------------------------------

    async def _status(self, _request: web.Request) -> web.Response:
        return web.json_response(self._shown())

    def _shown(self) -> Json:
        return {**self._page.status(), "protected": not self._access.is_open}

    async def _registers(self, _request: web.Request) -> web.Response:
        return web.json_response(self._page.registers())

    async def _metrics(self, _request: web.Request) -> web.Response:
        return web.Response(
            body=self._page.metrics(), headers={"Content-Type": "text/plain; version=0.0.4; charset=utf-8"}
        )

    async def _health(self, _request: web.Request) -> web.Response:
        """200 as long as the loop answers; the state is the cell's own."""
        state = self._page.state
        return web.json_response({"alive": True, "state": None if state is None else state.state})

    async def _ready(self, _request: web.Request) -> web.Response:
        """200 when a trigger would be carried out, else 503 with the reason."""
        state = self._page.state
        ready = state is not None and state.ready
        reason = "" if state is None else state.error
        return web.json_response({"ready": ready, "error": reason}, status=200 if ready else 503)

    async def _picture(self, request: web.Request) -> web.Response:
        cycle = int(request.match_info["cycle"])
        side: Side = "left" if request.match_info["side"] == "left" else "right"
        pair = self._page.pair(cycle)
        if pair is None:
            raise web.HTTPNotFound(text="this cycle is no longer in memory\n")
        data = self._pictures.get((cycle, side))
        if data is None:
            draw = partial(picture, pair, self._page.rectification(), side)
            data = await asyncio.get_running_loop().run_in_executor(self._drawer, draw)
            self._pictures[cycle, side] = data
            while len(self._pictures) > CACHED_PICTURES:
                self._pictures.popitem(last=False)
        return web.Response(body=data, content_type="image/jpeg")

    async def _events(self, request: web.Request) -> web.StreamResponse:
        """Server-sent events: the whole history once, then the newest state after each change."""
        if len(self._viewers) >= MAX_VIEWERS:
            raise web.HTTPServiceUnavailable(text=f"{MAX_VIEWERS} viewers are connected already\n")
        response = web.StreamResponse(headers={**HEADERS, "Content-Type": "text/event-stream"})
        viewer = asyncio.Event()
        self._viewers.add(viewer)
        try:
            await response.prepare(request)
            points = self._page.history()
            await response.write(_event("all", {**self._shown(), "points": points}))
            while not self._closing:
                try:
                    await asyncio.wait_for(viewer.wait(), ALIVE_S)
                except TimeoutError:
                    await response.write(b": alive\n\n")
                    continue
                viewer.clear()
                if not self._closing:
                    points = self._page.history(after=points[-1]["cycle"] if points else 0) or points[-1:]
                    await response.write(_event("update", {**self._shown(), "points": points}))
                    await asyncio.sleep(PERIOD_S)
        except ConnectionResetError:  # the viewer has gone
            pass
        finally:
            self._viewers.discard(viewer)
        return response


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to the address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _event(name: str, data: Json) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data, separators=(',', ':'))}\n\n".encode()


def _file(name: str, content_type: str) -> web.Response:
    return _text((files(__package__) / "static" / name).read_text("utf-8"), content_type)


def _text(text: str, content_type: str) -> web.Response:
    return web.Response(text=text, content_type=content_type, charset="utf-8")


def page_context(settings: WebSettings) -> ssl.SSLContext | None:
    """TLS of the page; None without certificate. Raises `ListenError` for files that do not fit."""
    if settings.certificate is None or settings.key is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(settings.certificate, settings.key)
    except (OSError, ssl.SSLError) as error:
        raise ListenError(f"status page: {settings.certificate}, {settings.key}: {error}") from error
    return context
