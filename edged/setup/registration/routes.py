"""The routes of drafts of registrations."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from aiohttp import web
from pydantic import Field, StringConstraints, model_validator

from edged.adapters.web.routes import Body, Call, Leased, Name, Problem, RouteTable, Token
from edged.files.atomic import read_bytes
from edged.identity.visitors import Role
from edged.robot.orientations import Brand
from edged.setup.calibration.routes import known
from edged.setup.registration.documents import Conventions, RegistrationDocument, RegistrationList
from edged.setup.registration.drafts import Change, RobotDraft
from edged.setup.registration.service import Given, Registrations
from edged.setup.releases.routes import Activating, ReleaseDocument, document_of_release, signature
from edged.setup.releases.service import Activation

DRAFT = "/registrations/{id:[0-9]{8}-[0-9]{6}-[0-9a-f]{4}}"
SAMPLE = DRAFT + "/samples/{name:(?:point|pose)_[0-9]{3}}"
PICTURE = DRAFT + "/pictures/{name:(?:look|pose)_[0-9]{3}}/{side:left|right}.jpg"
Board = Annotated[str, Field(max_length=100)]
Limit = Annotated[float, Field(gt=0, le=100, description="mm, of the held-out distances")]
BrandName = Annotated[Brand, Field(strict=False)]
Revision = Annotated[int, Field(ge=0, description="of the draft as it was seen: 412 for an older one")]
PlaceKey = Annotated[str, StringConstraints(min_length=1, max_length=100)]
Pasted = Annotated[str, Field(max_length=2000)]
Typed = Annotated[tuple[float, ...], Field(min_length=3, max_length=7, strict=False)]


class BeginningToRegister(Body):
    """How: cameras that stand still or are carried; touched points or poses of the flange; whose robot.

    board : that is touched, or that the flange holds; left out, with poses, that of the calibration.
    """

    mount: Literal["fixed", "flange"]
    kind: Literal["touch", "poses"]
    brand: BrandName | None = None
    board: Board = ""
    limit_mm: Limit = 0.5


class Revised(Body):
    """Of a draft as somebody saw it."""

    revision: Revision | None = None


class StatedOtherwise(Revised):
    """What is left out stays. brand : null for one that is not known."""

    brand: BrandName | None = None
    mount: Literal["fixed", "flange"] | None = None
    limit_mm: Limit | None = None


class Looking(Leased):
    """For marks of the draft's board, or for the part of a job."""

    job: Name | None = None


class Shown(Revised):
    """What the robot shows: numbers in its own order and units, or a text with them."""

    numbers: Typed | None = None
    text: Pasted | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Shown:
        if (self.numbers is None) == (self.text is None):
            raise ValueError("expected either numbers or text")
        return self

    @property
    def given(self) -> Given:
        """The same, for the drafts."""
        return Given(self.numbers, self.text)


class Sampling(Revised):
    """A touched place with what the robot shows; or, with the token, a pose, whose numbers may follow."""

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
    """A place, and what the robot shows with its tip there."""

    place: PlaceKey


class RegistrationRoutes:
    """The routes."""

    def __init__(self, registrations: Registrations, activation: Activation) -> None:
        self._registrations = registrations
        self._activation = activation

    def add_to(self, table: RouteTable) -> None:
        """Add them."""
        see = Role.VIEWER

        def writes(method: str, path: str, handler: Handler, what: str, body: Any, **more: Any) -> None:
            table.route(method, path, handler, what, body=body, answer=RegistrationDocument, **more)

        table.route(
            "GET",
            "/registrations",
            self._list,
            "Drafts of registrations, the youngest first, and the brands",
            role=see,
            answer=RegistrationList,
        )
        writes(
            "POST",
            "/registrations",
            self._begin,
            "Begin to register the rig to a robot",
            BeginningToRegister,
            status=201,
            audit=True,
        )
        table.route(
            "GET", DRAFT, self._get, "A registration as it stands", role=see, answer=RegistrationDocument
        )
        writes("PUT", DRAFT, self._state, "Brand, mount or limit", StatedOtherwise)
        table.route("DELETE", DRAFT, self._discard, "Discard a registration", body=Revised, audit=True)
        writes(
            "POST",
            f"{DRAFT}/looks",
            self._look,
            "Take a pair, and look for places to touch",
            Looking,
            status=201,
            needs_lease=True,
        )
        writes("POST", f"{DRAFT}/samples", self._sample, "A touched point, or a pose", Sampling, status=201)
        writes("PUT", SAMPLE, self._write, "What the robot showed there", Shown)
        writes("DELETE", SAMPLE, self._remove, "Leave a sample out", Revised)
        writes("POST", f"{SAMPLE}/restore", self._restore, "Use it again", Revised)
        writes("POST", f"{DRAFT}/undo", self._undo, "Take the last step back", Revised)
        writes("POST", f"{DRAFT}/redo", self._redo, "Take it again", Revised)
        table.route(
            "GET",
            f"{DRAFT}/conventions",
            self._conventions,
            "Every way to read the poses, ranked",
            role=see,
            answer=Conventions,
        )
        writes("POST", f"{DRAFT}/solve", self._solve, "Keep what the samples give", Revised, audit=True)
        writes(
            "POST",
            f"{DRAFT}/confirm",
            self._confirm,
            "How far a touch is from where it should be",
            Confirming,
        )
        table.route("GET", PICTURE, self._small, "A small picture", role=see, answer="image/jpeg")
        table.route(
            "POST",
            f"{DRAFT}/activate",
            self._activate,
            "Let the cell run by the registered rig",
            body=Activating,
            answer=ReleaseDocument,
            audit=True,
        )

    async def _list(self, _call: Call[None]) -> RegistrationList:
        return await self._registrations.listed()

    async def _begin(self, call: Call[BeginningToRegister]) -> RegistrationDocument:
        body = call.body
        document = await self._registrations.begin(
            call.visitor.name, body.mount, body.kind, body.brand, body.board, body.limit_mm
        )
        call.trail.object = document.id
        return document

    async def _get(self, call: Call[None]) -> RegistrationDocument:
        return await known(self._registrations.document(call.part("id")))

    async def _state(self, call: Call[StatedOtherwise]) -> RegistrationDocument:
        changes = call.body.model_dump(include=call.body.model_fields_set - {"revision"})
        changes = {name: value for name, value in changes.items() if value is not None or name == "brand"}
        return await self._change(call, lambda draft: draft.state_otherwise(**changes))

    async def _discard(self, call: Call[Revised]) -> None:
        await self._check(call)
        await known(self._registrations.remove(call.part("id")))

    async def _look(self, call: Call[Looking]) -> RegistrationDocument:
        body = call.body
        return await known(self._registrations.look(call.part("id"), body.token, body.job))

    async def _sample(self, call: Call[Sampling]) -> RegistrationDocument:
        body, identity = call.body, call.part("id")
        await self._check(call)
        said = body.numbers is not None or body.text is not None
        given = Given(body.numbers, body.text) if said else None
        if body.place is not None and given is not None:
            return await known(self._registrations.touch(identity, body.place, given))
        return await known(self._registrations.pose(identity, body.token or "", given))

    async def _write(self, call: Call[Shown]) -> RegistrationDocument:
        await self._check(call)
        return await known(self._registrations.write(call.part("id"), call.part("name"), call.body.given))

    async def _remove(self, call: Call[Revised]) -> RegistrationDocument:
        return await self._change(call, lambda draft: draft.remove(call.part("name")))

    async def _restore(self, call: Call[Revised]) -> RegistrationDocument:
        return await self._change(call, lambda draft: draft.restore(call.part("name")))

    async def _undo(self, call: Call[Revised]) -> RegistrationDocument:
        return await self._change(call, RobotDraft.undo)

    async def _redo(self, call: Call[Revised]) -> RegistrationDocument:
        return await self._change(call, RobotDraft.redo)

    async def _conventions(self, call: Call[None]) -> Conventions:
        return await known(self._registrations.conventions(call.part("id")))

    async def _solve(self, call: Call[Revised]) -> RegistrationDocument:
        await self._check(call)
        return await known(self._registrations.solve(call.part("id")))

    async def _confirm(self, call: Call[Confirming]) -> RegistrationDocument:
        await self._check(call)
        body = call.body
        return await known(self._registrations.confirm(call.part("id"), body.place, body.given))

    async def _small(self, call: Call[None]) -> web.Response:
        draft = await known(self._registrations.draft(call.part("id")))
        file = draft.small(call.part("name"), call.part("side"))
        if not file.is_file():
            raise Problem(404, "unknown", "there is no such picture")
        data = await asyncio.to_thread(read_bytes, file, "a small picture")
        return web.Response(body=data, content_type="image/jpeg")

    async def _activate(self, call: Call[Activating]) -> ReleaseDocument:
        self._activation.check(call.body.token)
        rig = await known(self._registrations.solution(call.part("id")))
        call.trail.before = self._activation.fingerprint
        signed = signature(call)
        release = await self._activation.activate(rig, call.visitor.name, call.body.note, signed)
        call.trail.after = release.fingerprint
        await self._registrations.tell(call.part("id"))
        return document_of_release(release, is_active=True)

    async def _change(self, call: Call[Any], change: Change) -> RegistrationDocument:
        await self._check(call)
        return await known(self._registrations.change(call.part("id"), change))

    async def _check(self, call: Call[Any]) -> None:
        """Raises `Problem` for a change of a draft that has changed since it was seen."""
        seen = call.body.revision
        if seen is None:
            return
        draft = await known(self._registrations.draft(call.part("id")))
        if seen != draft.state.revision:
            raise Problem(
                412,
                "stale",
                "the draft has changed since it was seen: look at it again",
                params={"revision": draft.state.revision},
            )


Handler = Callable[[Call[Any]], Awaitable[Any]]
