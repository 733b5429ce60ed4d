"""The routes of drafts of calibrations, and of tasks."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Annotated, TypeVar

from aiohttp import web
from pydantic import Field, model_validator

from edged.adapters.web.routes import Answer, Body, Call, Leased, Problem, RouteTable
from edged.files.atomic import read_bytes
from edged.identity.visitors import Role
from edged.setup.calibration.documents import DraftDocument, DraftList
from edged.setup.calibration.drafts import Draft
from edged.setup.calibration.service import Calibrations
from edged.setup.jobs.tasks import TaskDocument, Tasks
from edged.vision.calibration.lenschoice import LensWish

DRAFT = "/calibrations/{id:[0-9]{8}-[0-9]{6}-[0-9a-f]{4}}"
VIEW = DRAFT + "/views/{name:view_[0-9]{3}}"
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
"""Of reports: they hold their own style and pictures, and run nothing."""
Goal = Annotated[float, Field(gt=0, le=1e6, description="µm: none of the sigmas of X, Y, Z beyond it")]
T = TypeVar("T")


class Beginning(Body):
    """Which board: as `edged calibrate --board` takes it; or the one that the cameras see, and its pitch."""

    boards: Annotated[tuple[Annotated[str, Field(max_length=100)], ...], Field(max_length=8)] = ()
    recognise: bool = False
    mm: Annotated[float, Field(gt=0, le=1e4, description="pitch of a board that is recognised")] | None = None
    goal_um: Goal | None = None
    lens: LensWish = "auto"

    @model_validator(mode="after")
    def _one_of_both(self) -> Beginning:
        if self.recognise == bool(self.boards) or self.recognise != (self.mm is not None):
            raise ValueError('expected either boards, or "recognise": true with mm')
        return self


class Wanted(Body):
    """What is wanted of the calibration."""

    goal_um: Goal | None


class Auto(Leased):
    """Whether pictures are taken when the board is held still, where it is of use."""

    on: bool


class Nothing(Body):
    """All that is to be said is in the path."""


class Begun(Answer):
    """Long work: ask for it by its id."""

    task: str


class CalibrationRoutes:
    """The routes."""

    def __init__(self, calibrations: Calibrations, tasks: Tasks) -> None:
        self._calibrations = calibrations
        self._tasks = tasks

    def add_to(self, table: RouteTable) -> None:
        """Add them."""
        see = Role.VIEWER
        table.route(
            "GET", "/calibrations", self._list, "All drafts, the youngest first", role=see, answer=DraftList
        )
        table.route(
            "POST",
            "/calibrations",
            self._begin,
            "Begin a draft",
            body=Beginning,
            answer=DraftDocument,
            status=201,
            audit=True,
        )
        table.route("GET", DRAFT, self._get, "A draft as it stands", role=see, answer=DraftDocument)
        table.route("PUT", DRAFT, self._want, "What is wanted of it", body=Wanted, answer=DraftDocument)
        table.route("DELETE", DRAFT, self._discard, "Discard a draft", body=Nothing, audit=True)
        table.route(
            "POST",
            f"{DRAFT}/go-on",
            self._go_on,
            "Go on with a draft: live pairs are looked at for it, and for no other",
            body=Nothing,
            answer=DraftDocument,
        )
        table.route(
            "POST",
            f"{DRAFT}/views",
            self._add,
            "Take a pair",
            body=Leased,
            answer=DraftDocument,
            status=201,
            needs_lease=True,
        )
        table.route(
            "PUT",
            f"{DRAFT}/auto",
            self._auto,
            "Whether pairs are taken by themselves",
            body=Auto,
            answer=DraftDocument,
            needs_lease=True,
        )
        table.route("DELETE", VIEW, self._remove, "Leave a view out", body=Nothing, answer=DraftDocument)
        table.route(
            "GET",
            f"{VIEW}/{{side:left|right}}.jpg",
            self._small,
            "A small picture",
            role=see,
            answer="image/jpeg",
        )
        table.route(
            "POST", f"{DRAFT}/undo", self._undo, "Take the last step back", body=Nothing, answer=DraftDocument
        )
        table.route("POST", f"{DRAFT}/redo", self._redo, "Take it again", body=Nothing, answer=DraftDocument)
        table.route(
            "POST",
            f"{DRAFT}/solve",
            self._solve,
            "Solve it, and hold views out: half a minute for 20 pairs",
            body=Nothing,
            answer=Begun,
            status=202,
            audit=True,
        )
        table.route(
            "GET",
            f"{DRAFT}/report",
            self._report,
            "What it was solved to, for people",
            answer="text/html",
            role=see,
        )
        task = "/tasks/{id:[0-9a-f]{12}}"
        table.route("GET", task, self._task, "How far long work is", role=see, answer=TaskDocument)
        table.route("DELETE", task, self._cancel, "End long work", body=Nothing, answer=TaskDocument)

    async def _list(self, _call: Call[None]) -> DraftList:
        return await self._calibrations.listed()

    async def _begin(self, call: Call[Beginning]) -> DraftDocument:
        body = call.body
        draft = await self._calibrations.begin(
            call.visitor.name, body.boards, body.mm, body.goal_um, body.lens
        )
        call.trail.object = draft.id
        return draft

    async def _get(self, call: Call[None]) -> DraftDocument:
        return await known(self._calibrations.document(call.part("id")))

    async def _add(self, call: Call[Leased]) -> DraftDocument:
        return await known(self._calibrations.add(call.part("id"), call.body.token))

    async def _want(self, call: Call[Wanted]) -> DraftDocument:
        return await self._change(call.part("id"), lambda draft: draft.set_goal(call.body.goal_um))

    async def _discard(self, call: Call[Nothing]) -> None:
        await known(self._calibrations.remove(call.part("id")))

    async def _go_on(self, call: Call[Nothing]) -> DraftDocument:
        return await known(self._calibrations.go_on(call.part("id")))

    async def _auto(self, call: Call[Auto]) -> DraftDocument:
        body = call.body
        return await known(self._calibrations.take_by_itself(call.part("id"), body.token, on=body.on))

    async def _remove(self, call: Call[Nothing]) -> DraftDocument:
        return await self._change(call.part("id"), lambda draft: draft.remove(call.part("name")))

    async def _undo(self, call: Call[Nothing]) -> DraftDocument:
        return await self._change(call.part("id"), Draft.undo)

    async def _redo(self, call: Call[Nothing]) -> DraftDocument:
        return await self._change(call.part("id"), Draft.redo)

    async def _change(self, identity: str, change: Callable[[Draft], None]) -> DraftDocument:
        return await known(self._calibrations.change(identity, change))

    async def _solve(self, call: Call[Nothing]) -> Begun:
        call.trail.object = task = await known(self._calibrations.solve(call.part("id")))
        return Begun(task=task)

    async def _report(self, call: Call[None]) -> web.Response:
        draft = await known(self._calibrations.draft(call.part("id")))
        page = await asyncio.to_thread(draft.report)
        headers = {"Content-Security-Policy": REPORT_POLICY}
        return web.Response(body=page, content_type="text/html", charset="utf-8", headers=headers)

    async def _small(self, call: Call[None]) -> web.Response:
        draft = await known(self._calibrations.draft(call.part("id")))
        if call.part("name") not in draft.state.taken:
            raise _unknown()
        file = draft.thumbnail(call.part("name"), call.part("side"))
        data = await asyncio.to_thread(read_bytes, file, "a small picture")
        return web.Response(body=data, content_type="image/jpeg")

    async def _task(self, call: Call[None]) -> TaskDocument:
        try:
            return self._tasks.document(call.part("id"))
        except KeyError:
            raise _unknown() from None

    async def _cancel(self, call: Call[Nothing]) -> TaskDocument:
        try:
            await self._tasks.cancel(call.part("id"))
        except KeyError:
            raise _unknown() from None
        return self._tasks.document(call.part("id"))


async def known(asked: Awaitable[T]) -> T:
    """An answer about something that there is. Raises `Problem` where there is no such thing."""
    try:
        return await asked
    except KeyError:
        raise _unknown() from None


def _unknown() -> Problem:
    return Problem(404, "unknown", "there is no such thing, or not any more")
