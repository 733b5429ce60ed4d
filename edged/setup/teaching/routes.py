"""The routes of drafts of jobs."""

from __future__ import annotations

import asyncio
from base64 import b64decode
from collections.abc import Awaitable
from typing import Annotated, Literal, TypeVar

from aiohttp import web
from pydantic import Field, JsonValue, model_validator

from edged.adapters.web.routes import Body, Call, Name, Problem, RouteTable, Token
from edged.errors import EdgedError
from edged.files.atomic import read_bytes
from edged.identity.visitors import Role
from edged.setup.calibration.routes import known
from edged.setup.releases.routes import Activating, ReleaseDocument, document_of_release, signature
from edged.setup.releases.service import Activation
from edged.setup.teaching.documents import Stale, TeachingDocument, TeachingList
from edged.setup.teaching.model import (
    FeatureName,
    JobName,
    Length,
    Millimetres,
    Number,
    Pixels,
    Point,
    Shapes,
)
from edged.setup.teaching.service import Teachings
from edged.setup.teaching.wishes import Drawn, Grip, Tapped, WantedSize
from edged.vision.part.job import MAX_TILT_DEG, MeasurementKind

TEACHING = "/teachings/{id:[0-9]{8}-[0-9]{6}-[0-9a-f]{4}}"
REGION_BYTES = 512 * 1024
DRAWING_BYTES = 2 * 1024 * 1024
"""Of a DXF file: a face of one part."""
Angle = Annotated[float, Field(ge=-360, le=360)]
T = TypeVar("T")
Way = Annotated[float, Field(ge=0, le=2000)]


class Beginning(Body):
    """token : take a fresh pair. cycle : take that of a recorded cycle. job : the folder of a job that is to
    be replaced; without token or cycle from the pair that it keeps. name : left out: one that is free.
    """

    token: Token | None = None
    cycle: Annotated[int, Field(ge=0, le=10**9)] | None = None
    job: Annotated[str, Field(max_length=128)] | None = None
    name: JobName | None = None

    @model_validator(mode="after")
    def _from_something(self) -> Beginning:
        if self.token is not None and self.cycle is not None:
            raise ValueError("expected token or cycle, not both")
        if self.token is None and self.cycle is None and self.job is None:
            raise ValueError("expected a token, for a fresh pair, a cycle, or a job, for the pair it keeps")
        return self


class Revised(Body):
    """revision : of the document that it is about; another one there is, by then, answers 412 with that."""

    revision: Annotated[int, Field(ge=0)] | None = None


class Regional(Revised):
    """Shapes, px of the raw left picture; later ones lie over earlier ones. None: the whole picture."""

    shapes: Shapes


class Tap(Revised):
    """Where the left picture was tapped, raw px."""

    x: Pixels
    y: Pixels


class Taking(Revised):
    """Features by their key: taken or left."""

    features: Annotated[dict[FeatureName, bool], Field(min_length=1, max_length=1000)]


class Drawing(Revised):
    """A DXF drawing, in base64, from which the job is learnt instead of a region. depth_mm : of its face from
    the left camera; left out: as the pair shows it. unit : where the drawing does not say it. layers : only
    these; none: all that are switched on.
    """

    name: Name
    data: Annotated[str, Field(min_length=1, max_length=4 * (DRAWING_BYTES // 3 + 1))]
    depth_mm: Length | None = None
    unit: Literal["mm", "cm", "m", "in"] | None = None
    layers: Annotated[tuple[Name, ...], Field(max_length=20)] = ()

    def drawn(self) -> Drawn:
        """As the workshop takes it. Raises `Problem` for what is no base64."""
        try:
            data = b64decode(self.data, validate=True)
        except ValueError as error:
            raise Problem(400, "invalid", "data: expected base64", field="data") from error
        return Drawn(data, self.name, self.depth_mm, self.unit, self.layers)


class TapPlace(Body):
    """Where the left picture was tapped, raw px."""

    x: Pixels
    y: Pixels


class GripWanted(Body):
    """Where a tool takes the part: in the part's frame, angles about its fixed x, y, z; or at, a point of its
    face, raw px of the left picture.
    """

    at: Point | None = None
    x_mm: Millimetres = 0.0
    y_mm: Millimetres = 0.0
    z_mm: Millimetres = 0.0
    a_deg: Angle = 0.0
    b_deg: Angle = 0.0
    c_deg: Angle = 0.0
    approach_mm: Way = 50.0
    retreat_mm: Way | None = None
    symmetry: Annotated[int, Field(ge=0, le=360)] = 1
    name: FeatureName = "grip"

    def grip(self) -> Grip:
        """As the workshop takes it."""
        return Grip(
            at=None if self.at is None else Tapped(*self.at),
            position_mm=(self.x_mm, self.y_mm, self.z_mm),
            rotation_deg=(self.a_deg, self.b_deg, self.c_deg),
            approach_mm=self.approach_mm,
            retreat_mm=self.retreat_mm,
            symmetry=self.symmetry,
            name=self.name,
        )


class SizeWanted(Body):
    """A size of features; nominal and tolerance in mm, of an angle in degrees. key : its name."""

    key: FeatureName | None = None
    kind: MeasurementKind
    of: Annotated[tuple[FeatureName, ...], Field(max_length=2)] = ()
    nominal: Millimetres | None = None
    tolerance: Length | None = None


class Wishing(Revised):
    """What the job is to be; what is left out stays. null of gripping, sizes and tilt_deg: as taught."""

    name: JobName | None = None
    number: Number | None = None
    reference: FeatureName | TapPlace | None = None
    gripping: GripWanted | None = None
    sizes: Annotated[tuple[SizeWanted, ...], Field(max_length=200)] | None = None
    tilt_deg: Annotated[float, Field(gt=0, le=MAX_TILT_DEG)] | None = None


class TeachingRoutes:
    """The routes."""

    def __init__(self, teachings: Teachings, activation: Activation) -> None:
        self._teachings = teachings
        self._activation = activation

    def add_to(self, table: RouteTable) -> None:
        """Add them."""
        see, one = Role.VIEWER, TeachingDocument
        table.route(
            "GET",
            "/teachings",
            self._list,
            "All drafts of jobs, the youngest first",
            role=see,
            answer=TeachingList,
        )
        table.route(
            "POST",
            "/teachings",
            self._begin,
            "Begin a draft of a job",
            body=Beginning,
            answer=one,
            status=201,
            audit=True,
        )
        table.route("GET", TEACHING, self._get, "A draft of a job as it stands", role=see, answer=one)
        table.route("PUT", TEACHING, self._wish, "What the job is to be", body=Wishing, answer=one)
        table.route("DELETE", TEACHING, self._remove, "Forget a draft", body=Revised, audit=True)
        table.route(
            "GET",
            f"{TEACHING}/{{side:left|right}}.jpg",
            self._picture,
            "A picture of its pair, in full size",
            role=see,
            answer="image/jpeg",
        )
        table.route(
            "PUT",
            f"{TEACHING}/region",
            self._region,
            "Where the part is",
            body=Regional,
            answer=one,
            limit_bytes=REGION_BYTES,
        )
        table.route(
            "POST",
            f"{TEACHING}/dxf",
            self._draw,
            "Learn from a drawing",
            body=Drawing,
            answer=one,
            limit_bytes=2 * DRAWING_BYTES,
        )
        table.route("POST", f"{TEACHING}/tap", self._tap, "What was tapped is the part", body=Tap, answer=one)
        table.route(
            "PUT",
            f"{TEACHING}/features",
            self._take,
            "Take features, or leave them",
            body=Taking,
            answer=one,
            limit_bytes=64 * 1024,
        )
        table.route(
            "POST", f"{TEACHING}/undo", self._undo, "Take the last step back", body=Revised, answer=one
        )
        table.route("POST", f"{TEACHING}/redo", self._redo, "Take it again", body=Revised, answer=one)

        table.route(
            "POST",
            f"{TEACHING}/activate",
            self._activate,
            "Let the cell have the job",
            body=Activating,
            answer=ReleaseDocument,
            audit=True,
        )

    async def _list(self, _call: Call[None]) -> TeachingList:
        return await self._teachings.listed()

    async def _begin(self, call: Call[Beginning]) -> TeachingDocument:
        body = call.body
        asked = self._teachings.begin(
            call.visitor.name, token=body.token, name=body.name, job=body.job, cycle=body.cycle
        )
        draft = await known(asked)
        call.trail.object = draft.id
        return draft

    async def _get(self, call: Call[None]) -> TeachingDocument:
        return await known(self._teachings.document(call.part("id")))

    async def _remove(self, call: Call[Revised]) -> None:
        await changed(self._teachings.remove(call.part("id"), call.body.revision))

    async def _region(self, call: Call[Regional]) -> TeachingDocument:
        body = call.body
        return await changed(self._teachings.set_region(call.part("id"), body.revision, body.shapes))

    async def _tap(self, call: Call[Tap]) -> TeachingDocument:
        body = call.body
        return await changed(self._teachings.tap(call.part("id"), body.revision, Tapped(body.x, body.y)))

    async def _draw(self, call: Call[Drawing]) -> TeachingDocument:
        body = call.body
        return await changed(self._teachings.draw(call.part("id"), body.revision, body.drawn()))

    async def _take(self, call: Call[Taking]) -> TeachingDocument:
        body = call.body
        return await changed(self._teachings.take(call.part("id"), body.revision, body.features))

    async def _wish(self, call: Call[Wishing]) -> TeachingDocument:
        body, stated = call.body, call.body.model_fields_set
        sets: dict[str, JsonValue] = {}
        if body.name is not None:
            sets["name"] = body.name
        if body.number is not None:
            sets["number"] = body.number
        # null is a wish, too
        sets |= {key: None for key in ("gripping", "sizes", "reference") if key in stated}
        if "tilt_deg" in stated:
            sets["tilt_deg"] = body.tilt_deg
        place = body.reference
        asked = self._teachings.wish(
            call.part("id"),
            body.revision,
            sets,
            reference=Tapped(place.x, place.y) if isinstance(place, TapPlace) else place,
            gripping=None if body.gripping is None else body.gripping.grip(),
            sizes=None if body.sizes is None else [_wanted(one) for one in body.sizes],
        )
        return await changed(asked)

    async def _undo(self, call: Call[Revised]) -> TeachingDocument:
        return await changed(self._teachings.step(call.part("id"), call.body.revision, -1))

    async def _redo(self, call: Call[Revised]) -> TeachingDocument:
        return await changed(self._teachings.step(call.part("id"), call.body.revision, 1))

    async def _activate(self, call: Call[Activating]) -> ReleaseDocument:
        self._activation.check(call.body.token)
        identity, body = call.part("id"), call.body
        candidate = await known(self._teachings.candidate(identity))
        call.trail.object, call.trail.before = candidate.folder, self._activation.fingerprint
        # first: a kill after the exchange must not leave a draft that does not know its job
        await self._teachings.note_activated(identity, candidate)
        try:
            release = await self._activation.activate_jobs(
                candidate.put, call.visitor.name, body.note, signature(call)
            )
        except (EdgedError, OSError):
            await self._teachings.note_activated(identity, None)
            raise
        call.trail.after = release.fingerprint
        await self._teachings.tell(identity)
        return document_of_release(release, is_active=True)

    async def _picture(self, call: Call[None]) -> web.Response:
        draft = await known(self._teachings.draft(call.part("id")))
        data = await asyncio.to_thread(read_bytes, draft.picture(call.part("side"), "jpg"), "a picture")
        # a pair never changes
        headers = {"Cache-Control": "private, max-age=86400, immutable"}
        return web.Response(body=data, content_type="image/jpeg", headers=headers)


def _wanted(one: SizeWanted) -> WantedSize:
    return WantedSize(one.kind, one.of, one.key, one.nominal, one.tolerance)


async def changed(asked: Awaitable[T]) -> T:
    """An answer to a change. Raises `Problem` where somebody else was quicker, or there is no such thing."""
    try:
        return await known(asked)
    except Stale as stale:
        newer = stale.document.model_dump(mode="json")
        raise Problem(412, "stale", str(stale), params={"document": newer}) from stale
