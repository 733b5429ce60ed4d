"""Routes of acceptances and of studies of a size."""

from __future__ import annotations

import asyncio
from typing import Annotated

from aiohttp import web
from pydantic import Field

from edged.adapters.web.routes import Body, Call, Leased, Name, route
from edged.identity.visitors import Role
from edged.setup.acceptance.guided import MOST as MOST_OF_STUDY
from edged.setup.acceptance.guided import GuidedStudy, Millimetres, StudyDocument, StudyPlan
from edged.setup.acceptance.service import MOST, AcceptanceDocument, Accepting, PicturedTest, TestName
from edged.setup.draftroutes import Begun, report_answer, unknown


class TakingPictures(Leased):
    """The number of pictures to take for a test."""

    test: PicturedTest
    count: Annotated[int, Field(ge=1, le=MOST)] = 1


class Touching(Leased):
    """Touched points: lines of rig x, y, z and robot x, y, z, mm, as for `edged register touch`."""

    table: Annotated[str, Field(max_length=3500)]


class Clearing(Leased):
    """The test whose pictures are discarded."""

    test: TestName


class KnownLength(Body):
    """A measurement of the job, a circle, or two circles as A-B, and its true length."""

    name: Name
    mm: Millimetres


class Judging(Leased):
    """The job to judge by. length : known length in the pictures of that test; null if there are none."""

    job: Name
    length: KnownLength | None = None


class Planning(Leased):
    """The study to begin."""

    plan: StudyPlan


class MeasuringOnce(Leased):
    """A measurement of a study. done : number of measurements that the user sees."""

    done: Annotated[int, Field(ge=0, le=MOST_OF_STUDY)]


class AcceptanceRoutes:
    """Routes of acceptances and of studies of a size."""

    def __init__(self, accepting: Accepting, study: GuidedStudy) -> None:
        self._accepting = accepting
        self._study = study

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

    @route("GET", "/acceptance/study", "The study of a size as it stands", role=Role.VIEWER)
    async def _get_study(self, _call: Call[None]) -> StudyDocument:
        return await self._study.document()

    @route("POST", "/acceptance/study", "Begin a study", audit=True, needs_lease=True)
    async def _begin_study(self, call: Call[Planning]) -> StudyDocument:
        plan = call.body.plan
        call.trail.object = f"{plan.job} {plan.size}"
        return await self._study.begin(call.visitor.name, plan)

    @route("POST", "/acceptance/study/measure", "Measure the size once", needs_lease=True)
    async def _measure(self, call: Call[MeasuringOnce]) -> StudyDocument:
        return await self._study.measure(call.body.token, call.body.done)

    @route("POST", "/acceptance/study/back", "Throw the last measurement away", audit=True, needs_lease=True)
    async def _back(self, call: Call[MeasuringOnce]) -> StudyDocument:
        return await self._study.back(call.body.done)

    @route("POST", "/acceptance/study/end", "Forget the study", audit=True, needs_lease=True)
    async def _end_study(self, _call: Call[Leased]) -> StudyDocument:
        return await self._study.end()

    @route("GET", "/acceptance/study/report", "The page to sign", answer="text/html", role=Role.VIEWER)
    async def _study_report(self, _call: Call[None]) -> web.Response:
        page = await self._study.report()
        if page is None:
            raise unknown()
        return report_answer(page)
