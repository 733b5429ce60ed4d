"""Routes of trying a job: on live pairs, by a still test, and in the whole working volume."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from edged.adapters.web.routes import Body, Call, Leased, Name, route
from edged.identity.visitors import Role
from edged.setup.draftroutes import Begun, known
from edged.setup.trials.documents import MapDocument, Stills, TrialDocument
from edged.setup.trials.service import Trials, What
from edged.setup.trials.stilltest import LEAST, MOST

Draft = Annotated[str, Field(pattern=r"^[0-9]{8}-[0-9]{6}-[0-9a-f]{4}$")]


class TrialSubject(Body):
    """A job by its name, or a teaching draft by its id; neither for the one that was tried last."""

    job: Name | None = None
    teaching: Draft | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> TrialSubject:
        if self.job is not None and self.teaching is not None:
            raise ValueError("expected job or teaching, not both")
        return self

    def what(self) -> What:
        """The job or draft to try."""
        return What(self.job, self.teaching)


class TrialSwitch(TrialSubject, Leased):
    """Whether to measure live pairs with the job."""

    on: bool


class HoldingStill(TrialSubject, Leased):
    """A still test: the number of pictures of a part that is not moved."""

    pictures: Annotated[int, Field(ge=LEAST, le=MOST)] = 30


class TrialRoutes:
    """Routes of trying a job."""

    def __init__(self, trials: Trials) -> None:
        self._trials = trials

    @route("GET", "/trials", "The trial as it stands", role=Role.VIEWER)
    async def _get(self, _call: Call[None]) -> TrialDocument:
        return await self._trials.document()

    @route("PUT", "/trials", "Measure each live pair by a job, or none", needs_lease=True)
    async def _turn(self, call: Call[TrialSwitch]) -> TrialDocument:
        return await known(self._trials.turn(call.body.token, call.body.what(), on=call.body.on))

    @route("GET", "/trials/still", "The last still test", role=Role.VIEWER)
    async def _last_still(self, _call: Call[None]) -> Stills:
        return Stills(last=await self._trials.last_still())

    @route(
        "POST",
        "/trials/still",
        "Hold the scatter of a part that lies still against its sigma",
        status=202,
        audit=True,
        needs_lease=True,
    )
    async def _hold_still(self, call: Call[HoldingStill]) -> Begun:
        body = call.body
        asked = self._trials.start_still_test(body.token, body.what(), body.pictures, call.visitor.name)
        call.trail.object = task = await known(asked)
        return Begun(task=task)

    @route("GET", "/trials/map", "The sigma to be expected in the working volume", role=Role.VIEWER)
    async def _map(self, call: Call[TrialSubject]) -> MapDocument:
        return await known(self._trials.map(call.body.what()))
