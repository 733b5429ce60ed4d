"""The routes of regressions: a new job or rig tried on all recorded cycles that it concerns."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from edged.adapters.web.routes import Answer, Body, Call, route
from edged.identity.visitors import Role
from edged.setup.draftroutes import known
from edged.setup.recordings.candidates import CandidateContents
from edged.setup.recordings.regressiondocuments import RegressionDocument, RegressionLine, TriedCandidate
from edged.setup.recordings.regressions import Regressions
from edged.setup.recordings.setups import Contents
from edged.setup.recordings.whatif import Features, JobChange, LimitChange

IDENTITY = "[0-9]{8}-[0-9]{6}-[0-9a-f]{4}"
Identity = Annotated[str, Field(pattern=f"^{IDENTITY}$")]
LIMIT_BYTES = 32 * 1024


class ChangedJob(Body):
    """A job of the cell, by its folder's name, and what is to be other."""

    job: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_. +@=-]{0,127}$")]
    limits: LimitChange = LimitChange()
    features: Annotated[Features, Field(max_length=256)] = Field(default_factory=dict)
    contrast: Annotated[float, Field(gt=0, le=255)] | None = None


class Testing(Body):
    """What is to be tried: one of them."""

    teaching: Identity | None = None
    calibration: Identity | None = None
    release: Annotated[int, Field(ge=1, le=999_999)] | None = None
    change: ChangedJob | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Testing:
        if sum(value is not None for _, value in self) != 1:
            raise ValueError(f"expected one of {', '.join(type(self).model_fields)}")
        return self


class RegressionBegun(Answer):
    """Long work: the task by its id, and the result's when that is done."""

    task: str
    regression: str


class RegressionList(Answer):
    """The kept ones, newest first."""

    regressions: list[RegressionLine]


class RegressionRoutes:
    """The routes."""

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
