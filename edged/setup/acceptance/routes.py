"""The routes of an acceptance."""

from __future__ import annotations

import asyncio
from typing import Annotated

from aiohttp import web
from pydantic import Field

from edged.adapters.web.routes import Body, Call, Leased, Name, route
from edged.identity.visitors import Role
from edged.setup.acceptance.service import MOST, AcceptanceDocument, Accepting, PicturedTest, TestName
from edged.setup.draftroutes import Begun, report_answer, unknown

Millimetres = Annotated[float, Field(ge=0.001, le=100_000)]


class TakingPictures(Leased):
    """How many pictures of which test."""

    test: PicturedTest
    count: Annotated[int, Field(ge=1, le=MOST)] = 1


class Touching(Leased):
    """Lines of rig x, y, z and robot x, y, z, mm, as for `edged register touch`."""

    table: Annotated[str, Field(max_length=3500)]


class Clearing(Leased):
    """Which test is begun anew."""

    test: TestName


class KnownLength(Body):
    """A measurement of the job, a circle, or two circles as A-B, and its true length."""

    name: Name
    mm: Millimetres


class Judging(Leased):
    """By which job. length : what the pictures of the length show; null: there are none."""

    job: Name
    length: KnownLength | None = None


class AcceptanceRoutes:
    """The routes."""

    def __init__(self, accepting: Accepting) -> None:
        self._accepting = accepting

    @route("GET", "/acceptance", "The acceptance as it stands", role=Role.VIEWER)
    async def _get(self, _call: Call[None]) -> AcceptanceDocument:
        return await self._accepting.document()

    @route("POST", "/acceptance/pictures", "Take pictures of a test", status=202, needs_lease=True)
    async def _take(self, call: Call[TakingPictures]) -> Begun:
        return Begun(task=await self._accepting.take(call.body.token, call.body.test, call.body.count))

    @route("PUT", "/acceptance/robot", "Say what the robot touched", needs_lease=True)
    async def _touched(self, call: Call[Touching]) -> AcceptanceDocument:
        return await self._accepting.touched(call.body.token, call.body.table)

    @route("POST", "/acceptance/clear", "Begin a test anew", needs_lease=True)
    async def _clear(self, call: Call[Clearing]) -> AcceptanceDocument:
        return await self._accepting.clear(call.body.token, call.body.test)

    @route(
        "POST",
        "/acceptance/accept",
        "Judge the cell by what was taken",
        status=202,
        audit=True,
        needs_lease=True,
    )
    async def _accept(self, call: Call[Judging]) -> Begun:
        body = call.body
        length = None if body.length is None else (body.length.name, body.length.mm)
        asked = self._accepting.accept(body.token, call.visitor.name, body.job, length)
        call.trail.object = task = await asked
        return Begun(task=task)

    @route("GET", "/acceptance/report", "The page to sign", answer="text/html", role=Role.VIEWER)
    async def _report(self, _call: Call[None]) -> web.Response:
        try:
            page = await asyncio.to_thread(self._accepting.report.read_bytes)
        except FileNotFoundError:
            raise unknown() from None
        return report_answer(page)
