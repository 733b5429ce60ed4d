"""Routes of recorded cycles: the list, one cycle with its features and pictures, and what-if questions.

Also those of regressions, in which a new job or rig is tried on all recorded cycles that it affects.
"""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Annotated, Literal

from aiohttp import web
from pydantic import Field, model_validator

from edged.adapters.web.routes import Answer, Body, Call, route
from edged.errors import FileFormatError, ImageError
from edged.identity.visitors import Role
from edged.setup.draftroutes import known
from edged.setup.recordings.candidates import CandidateContents
from edged.setup.recordings.recorded import MOST, CycleFilter, CycleList
from edged.setup.recordings.regressiondocuments import RegressionDocument, RegressionLine, TriedCandidate
from edged.setup.recordings.regressions import Regressions
from edged.setup.recordings.service import CycleDocument, Cycles
from edged.setup.recordings.setups import Contents
from edged.setup.recordings.whatif import Change, Features, JobChange, LimitChange, WhatIf

CYCLE = "/cycles/{number:[0-9]{1,9}}"
SMALL_PX = 160
WHAT_IF_BYTES = 32 * 1024
"""Limit on a question's size: a job may have hundreds of features."""


class CycleQuery(Body):
    """Selection of recorded cycles. before : only older ones than this number."""

    status: Literal["OK", "NO_TARGET", "LOW_QUALITY", "CAPTURE_FAULT"] | None = None
    reason: Annotated[str, Field(pattern="^[A-Z_]{1,40}$")] | None = None
    job: Annotated[str, Field(max_length=64)] | None = None
    before: Annotated[int, Field(ge=0, le=999_999_999)] | None = None
    most: Annotated[int, Field(ge=1, le=MOST)] = 50


class WhatIfQuestion(Body):
    """A change of limits, features, contrast or light; if empty, asks what would have helped."""

    limits: LimitChange | None = None
    features: Annotated[Features, Field(max_length=256)] | None = None
    contrast: Annotated[float, Field(gt=0, le=255)] | None = None
    light: Annotated[float, Field(ge=0.1, le=10)] | None = None

    def change(self) -> Change | None:
        """The stated change; None if nothing was stated."""
        stated = {key: value for key, value in self if value is not None}
        return Change(**stated) if stated else None


class CycleRoutes:
    """Routes of recorded cycles."""

    def __init__(self, cycles: Cycles) -> None:
        self._cycles = cycles

    @route("GET", "/cycles", "Recorded cycles, the youngest first", role=Role.VIEWER)
    async def _list(self, call: Call[CycleQuery]) -> CycleList:
        return await self._cycles.listed(CycleFilter(**dict(call.body)))

    @route(
        "GET",
        CYCLE,
        "A recorded cycle: its features as taught, as measured, and in a good cycle",
        role=Role.VIEWER,
    )
    async def _get(self, call: Call[None]) -> CycleDocument:
        return await known(self._cycles.document(int(call.part("number"))))

    @route(
        "GET", f"{CYCLE}/{{side:left|right}}.jpg", "A picture of it", role=Role.VIEWER, answer="image/jpeg"
    )
    async def _picture(self, call: Call[None]) -> web.Response:
        return await _jpeg(self._cycles.picture(int(call.part("number")), call.side))

    @route("GET", f"{CYCLE}/small.jpg", "Its left picture, small", role=Role.VIEWER, answer="image/jpeg")
    async def _small(self, call: Call[None]) -> web.Response:
        return await _jpeg(self._cycles.picture(int(call.part("number")), "left", SMALL_PX))

    @route(
        "GET",
        f"{CYCLE}/taught/{{side:left|right}}.jpg",
        "A picture of the pair that its job was taught from, where the job keeps it",
        role=Role.VIEWER,
        answer="image/jpeg",
    )
    async def _taught_picture(self, call: Call[None]) -> web.Response:
        return await _jpeg(self._cycles.taught_picture(int(call.part("number")), call.side))

    @route(
        "POST",
        f"{CYCLE}/what-if",
        "The same exposure by other limits, features, contrast or light; without any: what would have helped",
        limit_bytes=WHAT_IF_BYTES,
    )
    async def _what_if(self, call: Call[WhatIfQuestion]) -> WhatIf:
        return await known(self._cycles.what_if(int(call.part("number")), call.body.change()))


async def _jpeg(asked: Awaitable[bytes]) -> web.Response:
    try:
        data = await known(asked)
    except (FileFormatError, ImageError):
        raise web.HTTPNotFound from None
    return web.Response(body=data, content_type="image/jpeg")


IDENTITY = "[0-9]{8}-[0-9]{6}-[0-9a-f]{4}"
Identity = Annotated[str, Field(pattern=f"^{IDENTITY}$")]
LIMIT_BYTES = 32 * 1024


class ChangedJob(Body):
    """A job of the cell, by its folder's name, and the changes to it."""

    job: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_. +@=-]{0,127}$")]
    limits: LimitChange = LimitChange()
    features: Annotated[Features, Field(max_length=256)] = Field(default_factory=dict)
    contrast: Annotated[float, Field(gt=0, le=255)] | None = None


class Testing(Body):
    """The candidate to try: exactly one of these."""

    teaching: Identity | None = None
    calibration: Identity | None = None
    release: Annotated[int, Field(ge=1, le=999_999)] | None = None
    change: ChangedJob | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> Testing:
        if sum(value is not None for _, value in self) != 1:
            raise ValueError(f"expected one of {', '.join(type(self).model_fields)}")
        return self


class RegressionBegun(Answer):
    """A started regression: id of the task, and id that the result will have."""

    task: str
    regression: str


class RegressionList(Answer):
    """Kept regressions, newest first."""

    regressions: list[RegressionLine]


class RegressionRoutes:
    """Routes of regressions."""

    def __init__(self, regressions: Regressions, candidates: CandidateContents) -> None:
        self._regressions = regressions
        self._candidates = candidates

    @route(
        "POST",
        "/regressions",
        "Measure the recorded cycles by a new job or rig, against what runs",
        status=202,
        audit=True,
        limit_bytes=LIMIT_BYTES,
    )
    async def _begin(self, call: Call[Testing]) -> RegressionBegun:
        what, contents = await known(self._wanted(call.body))
        task, identity = await self._regressions.begin(contents, what, call.visitor.name)
        call.trail.object = f"{what.kind} {what.id}: {identity}"
        return RegressionBegun(task=task, regression=identity)

    async def _wanted(self, body: Testing) -> tuple[TriedCandidate, Contents]:
        if body.teaching is not None:
            what = TriedCandidate(kind="teaching", id=body.teaching)
            return what, await self._candidates.of_teaching(body.teaching)
        if body.calibration is not None:
            what = TriedCandidate(kind="calibration", id=body.calibration)
            return what, await self._candidates.of_calibration(body.calibration)
        if body.change is not None:
            change = JobChange(**body.change.model_dump(exclude={"job"}))
            what = TriedCandidate(kind="change", id=body.change.job)
            return what, await self._candidates.of_change(body.change.job, change)
        number = body.release or 0
        return TriedCandidate(kind="release", id=str(number)), await self._candidates.of_release(number)

    @route("GET", "/regressions", "The last regressions, the youngest first", role=Role.VIEWER)
    async def _list(self, _call: Call[None]) -> RegressionList:
        return RegressionList(regressions=await self._regressions.listed())

    @route(
        "GET",
        f"/regressions/{{id:{IDENTITY}}}",
        "A regression: which cycles come out otherwise, worst first",
        role=Role.VIEWER,
    )
    async def _get(self, call: Call[None]) -> RegressionDocument:
        return await known(self._regressions.get(call.part("id")))
