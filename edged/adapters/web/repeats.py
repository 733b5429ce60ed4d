"""Requests repeated because their response was lost: they get the first response again and are not run twice.

The client chooses an `Idempotency-Key` for each action that is wanted once, and sends it with each attempt.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from aiohttp import web
from pydantic import BaseModel

from edged.adapters.web.routes import Problem
from edged.identity.visitors import Visitor

HEADER = "Idempotency-Key"
MAX_LETTERS = 64
KEPT, KEPT_S = 256, 600.0
MAX_BYTES = 100_000
"""Largest response that is kept; only pictures are larger, and their requests change nothing."""


@dataclass(frozen=True, slots=True)
class _Answer:
    status: int
    body: bytes
    content_type: str


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """A request. answer : None when it was refused or broken off, so that it may be run again."""

    digest: bytes
    since_s: float
    answer: asyncio.Future[_Answer | None] = field(default_factory=lambda: asyncio.Future())


class Repeats:
    """Requests with a key in the last minutes, by session, method, path and key."""

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._asked: OrderedDict[tuple[str, str, str, str], _Asked] = OrderedDict()

    async def once(
        self,
        visitor: Visitor,
        request: web.Request,
        body: BaseModel | None,
        do: Callable[[], Awaitable[web.StreamResponse]],
    ) -> tuple[web.StreamResponse, bool]:
        """Return the response, and whether it is a kept one.

        Raises as `do`; `Problem` for a key that was sent before with another body.
        body : as it was parsed; None for one that is read piece by piece, whose request is always run.
        Refusals are not kept: the next attempt may succeed.
        """
        name = request.headers.get(HEADER)
        if name is None or body is None or not visitor.session:
            return await do(), False
        if not 0 < len(name) <= MAX_LETTERS:
            raise Problem(400, "invalid", f"{HEADER}: expected 1 to {MAX_LETTERS} letters")
        key = (visitor.session, request.method, request.path, name)
        digest = hashlib.sha256(body.model_dump_json().encode()).digest()
        self._forget()
        while (before := self._asked.get(key)) is not None:
            if before.digest != digest:
                raise Problem(422, "key", f"{HEADER}: it was sent before with another body")
            answer = await asyncio.shield(before.answer)
            if answer is not None:
                return web.Response(
                    body=answer.body, status=answer.status, content_type=answer.content_type
                ), True
        asked = self._asked[key] = _Asked(digest, self._clock_s())
        kept: _Answer | None = None
        try:
            response = await do()
            if isinstance(response, web.Response) and isinstance(response.body, bytes | None):
                content = response.body or b""
                if len(content) <= MAX_BYTES:
                    kept = _Answer(response.status, content, response.content_type)
            return response, False
        finally:
            if kept is None:
                del self._asked[key]
            asked.answer.set_result(kept)

    def _forget(self) -> None:
        """Forget answered requests that are old, and the oldest of them while there are too many."""
        old_s = self._clock_s() - KEPT_S
        done = [key for key, asked in self._asked.items() if asked.answer.done()]
        surplus = len(self._asked) - KEPT + 1
        for index, key in enumerate(done):
            if index < surplus or self._asked[key].since_s < old_s:
                del self._asked[key]
