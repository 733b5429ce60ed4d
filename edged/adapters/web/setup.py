"""/api/v1: taking the cell for SETUP, keeping it, giving it back, and pictures meanwhile.

Whatever changes the cell is asked in JSON, by a session of the page (a password is not enough: a scraper has
one), from a page of this very host. Errors are problems (RFC 9457) with a `code` for programs.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor
from functools import partial
from typing import Any

import cv2
from aiohttp import web

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.errors import CaptureError, SetupRefused
from edged.payload import Json
from edged.ports import Commissioner

log = logging.getLogger(__name__)

BASE = "/api/v1"
KEPT = 4
"""Pairs that can be fetched after they were taken."""
NAME_LENGTH = 64
PNG_QUICK = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class Problem(Exception):
    """What a request cannot have. code : for programs."""

    def __init__(self, status: int, code: str, detail: str) -> None:
        self.status = status
        self.code = code
        super().__init__(detail)

    def response(self) -> web.Response:
        """As it is answered."""
        document = {"status": self.status, "code": self.code, "detail": str(self)}
        return web.json_response(document, status=self.status, content_type="application/problem+json")


Handler = Callable[[web.Request, Json], Awaitable[web.StreamResponse]]


class SetupApi:
    """The routes of SETUP.

    may_write : whether a request comes of a session. encoder : where pictures are encoded.
    """

    def __init__(
        self,
        commissioner: Commissioner,
        may_write: Callable[[web.Request], bool],
        encoder: Executor,
    ) -> None:
        self._commissioner = commissioner
        self._may_write = may_write
        self._encoder = encoder
        self._pairs: OrderedDict[int, FramePair] = OrderedDict()
        self._count = 0

    def add_to(self, router: web.UrlDispatcher) -> None:
        """Add the routes."""
        router.add_post(f"{BASE}/setup", self._changing(self._enter))
        router.add_put(f"{BASE}/setup/lease", self._changing(self._renew))
        router.add_delete(f"{BASE}/setup", self._changing(self._leave))
        router.add_post(f"{BASE}/captures", self._changing(self._capture))
        router.add_get(f"{BASE}/captures/{{number:[0-9]{{1,9}}}}/{{side:left|right}}.png", self._picture)

    def _changing(self, handler: Handler) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
        async def handle(request: web.Request) -> web.StreamResponse:
            try:
                if not self._may_write(request):
                    raise Problem(403, "log_in", "log in on the page first: a password alone may only look")
                if request.headers.get("Origin") != f"{request.scheme}://{request.host}":
                    raise Problem(403, "origin", "asked by a page of another host, or by none")
                return await handler(request, await _document(request))
            except SetupRefused as error:
                return Problem(409, "setup_refused", str(error)).response()
            except CaptureError as error:
                return Problem(503, f"camera_{error.code}", str(error)).response()
            except Problem as problem:
                return problem.response()

        return handle

    async def _enter(self, request: web.Request, document: Json) -> web.Response:
        name, take_over = _text(document, "name"), document.get("take_over", False) is True
        token = await self._commissioner.enter_setup(name, take_over=take_over)
        log.info("setup: %s at %s has the cell", name, request.remote)
        return web.json_response({"token": token}, status=201)

    async def _renew(self, _request: web.Request, document: Json) -> web.Response:
        self._commissioner.renew_setup(_text(document, "token"))
        return web.Response(status=204)

    async def _leave(self, request: web.Request, document: Json) -> web.Response:
        """By who has the cell, with the token; or by somebody at the cell, with a name."""
        if "token" in document:
            self._commissioner.leave_setup(_text(document, "token"))
            log.info("setup: given back from %s", request.remote)
        else:
            name = _text(document, "name")
            self._commissioner.end_setup(name)
            log.info("setup: ended by %s at %s", name, request.remote)
        return web.Response(status=204)

    async def _capture(self, _request: web.Request, document: Json) -> web.Response:
        pair = await self._commissioner.capture(_text(document, "token"))
        self._count += 1
        self._pairs[self._count] = pair
        while len(self._pairs) > KEPT:
            self._pairs.popitem(last=False)
        place = f"{BASE}/captures/{self._count}"
        answer = {
            "exposed_ns": pair.exposed_ns,
            "skew_ms": abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-6,
            "left": f"{place}/left.png",
            "right": f"{place}/right.png",
        }
        return web.json_response(answer, status=201)

    async def _picture(self, request: web.Request) -> web.Response:
        """The raw image, every grey value as the camera gave it."""
        pair = self._pairs.get(int(request.match_info["number"]))
        if pair is None:
            return Problem(404, "gone", f"only the last {KEPT} pairs are kept").response()
        frame = pair.left if request.match_info["side"] == "left" else pair.right
        loop = asyncio.get_running_loop()
        data = await loop.run_in_executor(self._encoder, partial(_png, frame.image))
        return web.Response(body=data, content_type="image/png")


async def _document(request: web.Request) -> Json:
    """The object that a request holds. Raises `Problem`."""
    if request.content_type != "application/json":
        raise Problem(415, "json", "expected Content-Type: application/json")
    try:
        document = json.loads(await request.read())
    except (ValueError, RecursionError, web.RequestPayloadError) as error:
        raise Problem(400, "json", "expected JSON") from error
    if not isinstance(document, dict):
        raise Problem(400, "json", "expected a JSON object")
    return document


def _text(document: dict[str, Any], name: str) -> str:
    text = document.get(name)
    if not isinstance(text, str) or not text.strip() or not text.isprintable() or len(text) > NAME_LENGTH:
        raise Problem(400, name, f"{name}: expected a text of 1 to {NAME_LENGTH} letters")
    return text.strip()


def _png(image: Image) -> bytes:
    _, data = cv2.imencode(".png", image, PNG_QUICK)
    return data.tobytes()
