"""The routes of trying a job: on live pairs, by a part that lies still, in the whole working volume."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from edged.adapters.web.routes import Body, Call, Leased, Name, RouteTable
from edged.identity.visitors import Role
from edged.setup.calibration.routes import Begun, known
from edged.setup.trials.documents import MapDocument, Stills, TrialDocument
from edged.setup.trials.service import Trials, What
from edged.setup.trials.stilltest import LEAST, MOST

Draft = Annotated[str, Field(pattern=r"^[0-9]{8}-[0-9]{6}-[0-9a-f]{4}$")]


class Wanted(Body):
    """A job by its name, or a teaching draft by its id; neither: what was tried last."""

    job: Name | None = None
    teaching: Draft | None = None

    @model_validator(mode="after")
    def _one_at_most(self) -> Wanted:
        if self.job is not None and self.teaching is not None:
            raise ValueError("expected job or teaching, not both")
        return self

    def what(self) -> What:
        """As the workshop has it."""
        return What(self.job, self.teaching)


class Trying(Wanted, Leased):
    """Whether live pairs are measured by it."""

    on: bool


class HoldingStill(Wanted, Leased):
    """How many pictures of a part that nobody touches."""

    pictures: Annotated[int, Field(ge=LEAST, le=MOST)] = 30


class TrialRoutes:
    """The routes."""

    def __init__(self, trials: Trials) -> None:
        self._trials = trials

    def add_to(self, table: RouteTable) -> None:
        """Add them."""
        see = Role.VIEWER
        table.route("GET", "/trials", self._get, "The trial as it stands", role=see, answer=TrialDocument)
        table.route(
            "PUT",
            "/trials",
            self._turn,
            "Measure each live pair by a job, or none",
            body=Trying,
            answer=TrialDocument,
            needs_lease=True,
        )
        table.route("GET", "/trials/still", self._last_still, "The last still test", role=see, answer=Stills)
        table.route(
            "POST",
            "/trials/still",
            self._hold_still,
            "Hold the scatter of a part that lies still against its sigma",
            body=HoldingStill,
            answer=Begun,
            status=202,
            audit=True,
            needs_lease=True,
        )
        table.route(
            "GET",
            "/trials/map",
            self._map,
            "The sigma to be expected in the working volume",
            role=see,
            body=Wanted,
            answer=MapDocument,
        )

    async def _get(self, _call: Call[None]) -> TrialDocument:
        return await self._trials.document()

    async def _turn(self, call: Call[Trying]) -> TrialDocument:
        return await known(self._trials.turn(call.body.token, call.body.what(), on=call.body.on))

    async def _last_still(self, _call: Call[None]) -> Stills:
        return Stills(last=await self._trials.last_still())

    async def _hold_still(self, call: Call[HoldingStill]) -> Begun:
        body = call.body
        asked = self._trials.hold_still(body.token, body.what(), body.pictures, call.visitor.name)
        call.trail.object = task = await known(asked)
        return Begun(task=task)

    async def _map(self, call: Call[Wanted]) -> MapDocument:
        return await known(self._trials.map(call.body.what()))
