"""Routes that the drafts of all topics have in common."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from aiohttp import web
from pydantic import Field

from edged.adapters.web.routes import Answer, Body, Call, Given, Problem, RouteTable
from edged.files.atomic import read_bytes
from edged.identity.visitors import Role
from edged.setup.documents import DraftHead
from edged.setup.drafts import OpenDrafts, StaleDraft

DRAFT = "/{id:[0-9]{8}-[0-9]{6}-[0-9a-f]{4}}"
Revision = Annotated[int, Field(ge=0, description="of the draft as it was seen: 412 for an older one")]
T = TypeVar("T")
B = TypeVar("B")

REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
"""Content security policy of reports: style and pictures are embedded, and no scripts run."""


def report_answer(page: bytes) -> web.Response:
    """Response with a report page."""
    headers = {"Content-Security-Policy": REPORT_POLICY}
    return web.Response(body=page, content_type="text/html", charset="utf-8", headers=headers)


class Nothing(Body):
    """Empty body: the path says everything."""


class Revised(Body):
    """Change of a draft as it was seen; if it has changed since, the answer is 412 with the newer one."""

    revision: Revision | None = None


class Begun(Answer):
    """Id of the started task, to ask for its progress."""

    task: str


def unknown() -> Problem:
    """Problem for something that does not exist."""
    return Problem(404, "unknown", "there is no such thing, or not any more")


async def known(asked: Awaitable[T]) -> T:
    """Await an answer; raises `Problem` for a `KeyError`, and for a draft that has changed meanwhile."""
    try:
        return await asked
    except KeyError:
        raise unknown() from None
    except StaleDraft as stale:
        newer = stale.document.model_dump(mode="json")
        params = {"document": newer, "revision": newer["revision"]}
        raise Problem(412, "stale", str(stale), params=params) from stale


class DraftRoutes:
    """Routes of one topic's drafts, below a path.

    answer : answer of most of them.  body : of undo, redo and discard.
    """

    def __init__(
        self,
        table: RouteTable,
        path: str,
        drafts: OpenDrafts[Any, Any, Any],
        answer: type[DraftHead],
        body: type[Body] = Revised,
    ) -> None:
        self._table = table
        self._path = path
        self._drafts = drafts
        self._answer = answer
        self._body = body

    def add(
        self,
        method: str,
        path: str,
        handler: Callable[[str, Call[B]], Awaitable[Given]],
        what: str,
        body: type[B] | None = None,
        **more: Any,
    ) -> None:
        """Add a route of a draft, as `RouteTable.route` does; the handler also gets the draft's id."""

        async def handle(call: Call[B]) -> Given:
            return await known(handler(call.part("id"), call))

        answer = more.pop("answer", self._answer)
        self._table.route(
            method, f"{self._path}{DRAFT}{path}", handle, what, body=body, answer=answer, **more
        )

    def add_usual(
        self,
        listed: type[Answer] | type[Any],
        field: str,
        words: Mapping[str, str],
        about: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        """Add routes to list, get, discard, undo and redo drafts.

        field : of the list with the drafts.  words : descriptions for "GET all", "GET", "DELETE".
        about : returns other fields of the list.
        """

        async def listing(_call: Call[None]) -> Given:
            return listed.model_validate({field: await self._drafts.summaries(), **about()})

        async def discard(identity: str, call: Call[Any]) -> None:
            await self._drafts.remove(identity, getattr(call.body, "revision", None))

        see = Role.VIEWER
        self._table.route("GET", self._path, listing, words["GET all"], role=see, answer=listed)
        self.add("GET", "", lambda draft, _: self._drafts.document(draft), words["GET"], role=see)
        self.add("DELETE", "", discard, words["DELETE"], self._body, answer=None, audit=True)
        self.add_change("POST", "/undo", lambda draft, _: draft.undo(), "Take the last step back", self._body)
        self.add_change("POST", "/redo", lambda draft, _: draft.redo(), "Take it again", self._body)

    def add_change(
        self,
        method: str,
        path: str,
        change: Callable[[Any, Call[B]], object],
        what: str,
        body: type[B],
        **more: Any,
    ) -> None:
        """Add a route that changes a draft's files. change : called in a thread, with the draft."""

        def handle(identity: str, call: Call[B]) -> Awaitable[DraftHead]:
            revision = getattr(call.body, "revision", None)
            return self._drafts.change(identity, lambda draft: change(draft, call), revision)

        self.add(method, path, handle, what, body, **more)

    def add_begin(self, begin: Callable[[Call[B]], Awaitable[DraftHead]], what: str, body: type[B]) -> None:
        """Add the route that begins a draft."""

        async def handle(call: Call[B]) -> DraftHead:
            draft = await known(begin(call))
            call.trail.object = draft.id
            return draft

        self._table.route(
            "POST", self._path, handle, what, body=body, answer=self._answer, status=201, audit=True
        )

    def add_file(
        self,
        path: str,
        file: Callable[[Any, Call[None]], Path | None],
        what: str,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        """Add the route of a JPEG. file : returns its path for a draft; None if there is none."""

        async def handle(identity: str, call: Call[None]) -> web.Response:
            found = file((await self._drafts.get(identity)).draft, call)
            if found is None:
                raise unknown()
            data = await asyncio.to_thread(read_bytes, found, "a picture")
            return web.Response(body=data, content_type="image/jpeg", headers=headers)

        self.add("GET", path, handle, what, role=Role.VIEWER, answer="image/jpeg")
