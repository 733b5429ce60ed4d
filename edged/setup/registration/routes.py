"""Routes of registration drafts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from edged.adapters.web.routes import Body, Call, Leased, Name, RouteTable, Token
from edged.identity.visitors import Role
from edged.robot.orientations import Brand
from edged.setup.documents import DraftHead
from edged.setup.draftroutes import DraftRoutes, Revised
from edged.setup.registration.documents import Conventions, RegistrationDocument, RegistrationList
from edged.setup.registration.drafts import RobotDraft
from edged.setup.registration.service import Given, Registrations
from edged.setup.releases.routes import Activating, ReleaseDocument, activated, add_activation
from edged.setup.releases.service import Activation

SAMPLE = "/samples/{name:(?:point|pose)_[0-9]{3}}"
PICTURE = "/pictures/{name:(?:look|pose)_[0-9]{3}}/{side:left|right}.jpg"
Board = Annotated[str, Field(max_length=100)]
Limit = Annotated[float, Field(gt=0, le=100, description="mm, of the held-out distances")]
BrandName = Annotated[Brand, Field(strict=False)]
PlaceKey = Annotated[str, StringConstraints(min_length=1, max_length=100)]
Pasted = Annotated[str, Field(max_length=2000)]
Typed = Annotated[tuple[float, ...], Field(min_length=3, max_length=7, strict=False)]


class BeginningToRegister(Body):
    """How to register: fixed or carried cameras; touched points or flange poses; brand of the robot.

    board : the one that is touched or held by the flange; default for poses: that of the calibration.
    """

    mount: Literal["fixed", "flange"]
    kind: Literal["touch", "poses"]
    brand: BrandName | None = None
    board: Board = ""
    limit_mm: Limit = 0.5


class StatedOtherwise(Revised):
    """Changes to a draft; omitted fields stay as they are. brand : null for an unknown one."""

    brand: BrandName | None = None
    mount: Literal["fixed", "flange"] | None = None
    limit_mm: Limit | None = None


class Looking(Leased):
    """Search for marks of the draft's board, or for the part of a job."""

    job: Name | None = None


class Shown(Revised):
    """Numbers that the robot shows, in its own order and units, or a text with them."""

    numbers: Typed | None = None
    text: Pasted | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> Shown:
        if (self.numbers is None) == (self.text is None):
            raise ValueError("expected either numbers or text")
        return self

    @property
    def given(self) -> Given:
        """The numbers or the text, as drafts take them."""
        return Given(self.numbers, self.text)


class Sampling(Revised):
    """A touched place with its numbers; or, with the lease's token, a pose, whose numbers may follow."""

    token: Token | None = None
    place: PlaceKey | None = None
    numbers: Typed | None = None
    text: Pasted | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Sampling:
        if (self.token is None) == (self.place is None):
            raise ValueError("expected either place, or token for a picture")
        if self.numbers is not None and self.text is not None:
            raise ValueError("expected either numbers or text")
        if self.place is not None and self.numbers is None and self.text is None:
            raise ValueError("a touched place needs numbers or text")
        return self


class Confirming(Shown):
    """A place, and the numbers that the robot shows with its tip there."""

    place: PlaceKey


class RegistrationRoutes:
    """Routes of registration drafts."""

    def __init__(self, registrations: Registrations, activation: Activation) -> None:
        self._registrations = registrations
        self._activation = activation

    def add_to(self, table: RouteTable) -> None:
        """Add the routes to a table."""
        see, ours = Role.VIEWER, self._registrations
        routes = DraftRoutes(table, "/registrations", ours.drafts, RegistrationDocument)
        words = {
            "GET all": "Drafts of registrations, the youngest first, brands, and the map of the robot's error"
        }
        words |= {"GET": "A registration as it stands", "DELETE": "Discard a registration"}
        routes.add_usual(RegistrationList, "registrations", words, ours.about)
        routes.add_begin(self._begin, "Begin to register the rig to a robot", BeginningToRegister)
        routes.add_change("PUT", "", self._restate, "Brand, mount or limit", StatedOtherwise)
        what = "Take a pair, and look for places to touch"
        routes.add("POST", "/looks", self._look, what, Looking, status=201, needs_lease=True)
        routes.add("POST", "/samples", self._sample, "A touched point, or a pose", Sampling, status=201)
        routes.add("PUT", SAMPLE, self._write, "What the robot showed there", Shown)
        routes.add_change(
            "DELETE",
            SAMPLE,
            lambda draft, call: draft.remove(call.part("name")),
            "Leave a sample out",
            Revised,
        )
        routes.add_change(
            "POST",
            f"{SAMPLE}/restore",
            lambda draft, call: draft.restore(call.part("name")),
            "Use it again",
            Revised,
        )
        what = "Every way to read the poses, ranked"
        routes.add(
            "GET",
            "/conventions",
            lambda draft, _: ours.conventions(draft),
            what,
            role=see,
            answer=Conventions,
        )
        routes.add("POST", "/solve", self._solve, "Keep what the samples give", Revised, audit=True)
        routes.add(
            "POST", "/confirm", self._confirm, "How far a touch is from where it should be", Confirming
        )
        routes.add_file(PICTURE, _small, "A small picture")
        add_activation(routes, self._activate, "Let the cell run by the registered rig")

    async def _begin(self, call: Call[BeginningToRegister]) -> DraftHead:
        return await self._registrations.begin(call.visitor.name, **dict(call.body))

    def _restate(self, draft: RobotDraft, call: Call[StatedOtherwise]) -> None:
        changes = call.body.model_dump(include=call.body.model_fields_set - {"revision"})
        draft.restate(
            **{name: value for name, value in changes.items() if value is not None or name == "brand"}
        )

    async def _look(self, draft: str, call: Call[Looking]) -> DraftHead:
        return await self._registrations.look(draft, call.body.token, call.body.job)

    async def _sample(self, draft: str, call: Call[Sampling]) -> DraftHead:
        body = call.body
        is_stated = body.numbers is not None or body.text is not None
        given = Given(body.numbers, body.text) if is_stated else None
        if body.place is not None and given is not None:
            return await self._registrations.touch(draft, body.place, given, body.revision)
        return await self._registrations.pose(draft, body.token or "", given, body.revision)

    async def _write(self, draft: str, call: Call[Shown]) -> DraftHead:
        body = call.body
        return await self._registrations.write(draft, call.part("name"), body.given, body.revision)

    async def _solve(self, draft: str, call: Call[Revised]) -> DraftHead:
        return await self._registrations.solve(draft, call.body.revision)

    async def _confirm(self, draft: str, call: Call[Confirming]) -> DraftHead:
        body = call.body
        return await self._registrations.confirm(draft, body.place, body.given, body.revision)

    async def _activate(self, _draft: str, call: Call[Activating]) -> ReleaseDocument:
        ours = self._registrations
        return await activated(self._activation, call, ours.solution, ours.drafts)


def _small(draft: RobotDraft, call: Call[None]) -> Path | None:
    file = draft.small(call.part("name"), call.part("side"))
    return file if file.is_file() else None
