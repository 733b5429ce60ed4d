"""Handlers of everything outside /api/v1: pages, the manual, and the state of the cell."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from aiohttp import web

from edged.adapters.web.assets import run_modules, type_of
from edged.adapters.web.manualfiles import Manual, is_built, read_manual
from edged.adapters.web.page import THUMBNAIL_PX, StatusPage, picture
from edged.domain.arrays import Side
from edged.domain.measurement import Nearest
from edged.payload import Json
from edged.report.page import render

CACHED_BYTES = 4 * 1024 * 1024
"""Size of the cache of JPEGs, which several viewers ask for."""
WIDTHS_PX = {"": None, "/small": THUMBNAIL_PX, "/full": 1_000_000}


@dataclass(frozen=True, slots=True)
class PageFacts:
    """Facts of a cell that stand on its page.

    protected : there is a password. is_set_up : the set-up page is served. links : text and address, shown
    below the page.
    """

    cell: str
    protected: bool
    is_set_up: bool
    links: Mapping[str, str]


class PageHandlers:
    """Handlers of everything outside /api/v1 except log-in and viewers.

    drawer : executor that encodes pictures. metrics : text in Prometheus' format.
    """

    def __init__(
        self,
        facts: PageFacts,
        page: StatusPage,
        drawer: Executor,
        assets: Mapping[str, str],
        manual: Path,
        metrics: Callable[[], Awaitable[bytes]],
    ) -> None:
        self._page = page
        self._drawer = drawer
        self._assets = assets
        self._manual_folder = manual
        self._manual: Manual | None = None
        self._metrics = metrics
        self._protected = facts.protected
        self._pictures: OrderedDict[tuple[int, str, str], bytes] = OrderedDict()
        self._no_manual = render("nomanual.html", __package__, cell=facts.cell)
        named = {
            "cell": facts.cell,
            "setup": facts.is_set_up,
            "modules": run_modules(assets),
            "links": facts.links,
        }
        self._run = {
            built: render("index.html", __package__, manual=built, **named) for built in (False, True)
        }

    def add_to(self, router: web.UrlDispatcher) -> None:
        """Add the routes."""
        router.add_get("/", self._index)
        router.add_get("/status.json", self._status)
        router.add_get("/registers.json", self._registers)
        picture = "/picture/{cycle:[0-9]{1,15}}/{side:left|right}{size:(/small|/full)?}"
        router.add_get(picture, self._picture)
        router.add_get("/cycle/{cycle:[0-9]{1,15}}.json", self._cycle)
        router.add_get("/static/{name:.+}", self._static)
        router.add_get("/manual", self._manual_index)
        router.add_get("/manual/{path:.*}", self._manual_file)
        router.add_get("/metrics", self._show_metrics)
        router.add_get("/health", self._health)
        router.add_get("/ready", self._ready)

    async def status(self) -> Json:
        """State of the page, after the open queries for near misses have been run."""
        questions = self._page.questions()
        if questions:
            await asyncio.get_running_loop().run_in_executor(self._drawer, _ask, questions)
        return {**self._page.status(), "protected": self._protected}

    async def _index(self, _request: web.Request) -> web.Response:
        return html(self._run[is_built(self._manual_folder)])

    async def _static(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in self._assets:
            raise web.HTTPNotFound
        return web.Response(text=self._assets[name], content_type=type_of(name), charset="utf-8")

    async def _manual_index(self, _request: web.Request) -> web.Response:
        raise web.HTTPMovedPermanently("/manual/")

    async def _manual_file(self, request: web.Request) -> web.StreamResponse:
        """Serve a file of the manual; only files that existed at the first request are known."""
        if self._manual is None:
            self._manual = await asyncio.to_thread(read_manual, self._manual_folder)
        if self._manual is None:
            response = html(self._no_manual)
            response.set_status(404)
            return response
        path = request.match_info["path"] or "index.html"
        file = self._manual.files.get(path)
        if file is None:
            raise web.HTTPNotFound(text="the manual has no such page\n")
        return web.FileResponse(file, headers=self._manual.headers(path))

    async def _status(self, _request: web.Request) -> web.Response:
        return web.json_response(await self.status())

    async def _registers(self, _request: web.Request) -> web.Response:
        return web.json_response(await self._page.registers())

    async def _show_metrics(self, _request: web.Request) -> web.Response:
        return web.Response(
            body=await self._metrics(), headers={"Content-Type": "text/plain; version=0.0.4; charset=utf-8"}
        )

    async def _health(self, _request: web.Request) -> web.Response:
        """200 as long as the event loop answers, whatever the state of the cell, which is included."""
        state = self._page.state
        return web.json_response({"alive": True, "state": None if state is None else state.state})

    async def _ready(self, _request: web.Request) -> web.Response:
        """200 while a trigger would be carried out, else 503 with the reason."""
        state = self._page.state
        ready = state is not None and state.ready
        reason = "" if state is None else state.why
        return web.json_response({"ready": ready, "error": reason}, status=200 if ready else 503)

    async def _cycle(self, request: web.Request) -> web.Response:
        shown = self._page.cycle(int(request.match_info["cycle"]))
        if shown is None:
            raise web.HTTPNotFound(text="this cycle is no longer in memory\n")
        return web.json_response(shown)

    async def _picture(self, request: web.Request) -> web.Response:
        cycle, size = int(request.match_info["cycle"]), request.match_info["size"]
        side: Side = "left" if request.match_info["side"] == "left" else "right"
        pair = self._page.pair(cycle)
        if pair is None:
            raise web.HTTPNotFound(text="this cycle is no longer in memory\n")
        data = self._pictures.get((cycle, side, size))
        if data is None:
            draw = partial(picture, pair, self._page.rectification(), side, WIDTHS_PX[size])
            data = await asyncio.get_running_loop().run_in_executor(self._drawer, draw)
            self._pictures[cycle, side, size] = data
            while len(self._pictures) > 1 and sum(map(len, self._pictures.values())) > CACHED_BYTES:
                self._pictures.popitem(last=False)
        return web.Response(body=data, content_type="image/jpeg")


def _ask(questions: Sequence[Nearest]) -> None:
    for question in questions:
        question.ask()


def html(text: str) -> web.Response:
    """Response with an HTML page."""
    return web.Response(text=text, content_type="text/html", charset="utf-8")
