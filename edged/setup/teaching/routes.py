"""Routes of job drafts."""

from __future__ import annotations

from base64 import b64decode
from typing import Annotated, Any, Literal

from pydantic import Field, JsonValue, model_validator

from edged.adapters.web.routes import Body, Call, Name, Problem, RouteTable, Token
from edged.errors import EdgedError
from edged.files.jobs.schema import TraySection
from edged.setup.documents import DraftHead
from edged.setup.draftroutes import DraftRoutes, Revised
from edged.setup.releases.routes import Activating, ReleaseDocument, add_activation, noted, signed_mandate
from edged.setup.releases.service import Activation
from edged.setup.teaching.documents import TeachingDocument, TeachingList
from edged.setup.teaching.model import (
    MOST_FURTHER,
    FeatureName,
    GripWanted,
    JobName,
    Length,
    Number,
    PairName,
    Pixels,
    Shapes,
    SizeWanted,
    TapPlace,
)
from edged.setup.teaching.service import Teachings
from edged.setup.teaching.wishes import Drawn
from edged.vision.part.job import MAX_TILT_DEG

REGION_BYTES = 512 * 1024
DRAWING_BYTES = 2 * 1024 * 1024
"""Most bytes of a DXF file, which shows a face of one part."""


class TeachingBeginning(Body):
    """Source of a new draft. token : take a fresh pair. cycle : take the pair of a recorded cycle.

    job : folder of a job to replace; without token or cycle, the pair that it keeps is used. name : default:
    a free one.
    """

    token: Token | None = None
    cycle: Annotated[int, Field(ge=0, le=10**9)] | None = None
    job: Annotated[str, Field(max_length=128)] | None = None
    name: JobName | None = None

    @model_validator(mode="after")
    def _from_something(self) -> TeachingBeginning:
        if self.token is not None and self.cycle is not None:
            raise ValueError("expected token or cycle, not both")
        if self.token is None and self.cycle is None and self.job is None:
            raise ValueError("expected a token, for a fresh pair, a cycle, or a job, for the pair it keeps")
        return self


class Regional(Revised):
    """Region as shapes, px of the raw left picture; later ones lie over earlier ones. Empty for all of it."""

    shapes: Shapes


class Tap(Revised):
    """Where the left picture was tapped, raw px."""

    x: Pixels
    y: Pixels


class Taking(Revised):
    """Whether features are used, by their key."""

    features: Annotated[dict[FeatureName, bool], Field(min_length=1, max_length=1000)]


class DrawingUpload(Revised):
    """A DXF drawing, in base64, from which the job is learnt instead of a region.

    depth_mm : of its face from the left camera; default: as stated before, or as the pair shows it.
    unit : used if the drawing does not state one. layers : only these; empty for all that are switched on.
    """

    name: Name
    data: Annotated[str, Field(min_length=1, max_length=4 * (DRAWING_BYTES // 3 + 1))]
    depth_mm: Length | None = None
    unit: Literal["mm", "cm", "m", "in"] | None = None
    layers: Annotated[tuple[Name, ...], Field(max_length=20)] = ()

    def drawn(self) -> Drawn:
        """Decode the drawing for the service. Raises `Problem` if it is not base64."""
        try:
            data = b64decode(self.data, validate=True)
        except ValueError as error:
            raise Problem(400, "invalid", "data: expected base64", field="data") from error
        return Drawn(data, self.name, self.depth_mm, self.unit, self.layers)


class AddedPair(Revised):
    """A further pair. token : take a fresh one. cycle : take that of a recorded cycle."""

    token: Token | None = None
    cycle: Annotated[int, Field(ge=0, le=10**9)] | None = None

    @model_validator(mode="after")
    def _from_one(self) -> AddedPair:
        if (self.token is None) == (self.cycle is None):
            raise ValueError("expected a token, for a fresh pair, or a cycle")
        return self


class KeptPairs(Revised):
    """Names of the further pairs to keep."""

    further: Annotated[tuple[PairName, ...], Field(max_length=MOST_FURTHER)]


class Wishing(Revised):
    """Changes to the wanted job; omitted fields stay. gripping, sizes, tray, tilt_deg : null: as taught."""

    name: JobName | None = None
    number: Number | None = None
    reference: FeatureName | TapPlace | None = None
    gripping: GripWanted | None = None
    sizes: Annotated[tuple[SizeWanted, ...], Field(max_length=200)] | None = None
    tray: TraySection | Literal["none"] | None = None
    tilt_deg: Annotated[float, Field(gt=0, le=MAX_TILT_DEG)] | None = None


class TeachingRoutes:
    """Routes of job drafts."""

    def __init__(self, teachings: Teachings, activation: Activation) -> None:
        self._teachings = teachings
        self._activation = activation

    def add_to(self, table: RouteTable) -> None:
        """Add the routes to a table."""
        routes = DraftRoutes(table, "/teachings", self._teachings.drafts, TeachingDocument)
        words = {"GET all": "All drafts of jobs, the youngest first", "GET": "A draft of a job as it stands"}
        routes.add_usual(TeachingList, "teachings", {**words, "DELETE": "Forget a draft"})
        routes.add_begin(self._begin, "Begin a draft of a job", TeachingBeginning)
        routes.add("PUT", "", self._wish, "What the job is to be", Wishing)
        routes.add_file(
            "/{side:left|right}.jpg",
            lambda draft, call: draft.picture(call.part("side"), "jpg"),
            "A picture of its pair, in full size",
            {"Cache-Control": "private, max-age=86400, immutable"},  # a pair never changes
        )
        routes.add("PUT", "/region", self._region, "Where the part is", Regional, limit_bytes=REGION_BYTES)
        routes.add(
            "POST", "/dxf", self._draw, "Learn from a drawing", DrawingUpload, limit_bytes=2 * DRAWING_BYTES
        )
        routes.add_file(
            "/{pair:[0-9a-f]{12}}-{side:left|right}.jpg",
            lambda draft, call: draft.picture(call.part("side"), "jpg", call.part("pair")),
            "A picture of a further pair, in full size",
            {"Cache-Control": "private, max-age=86400, immutable"},
        )
        routes.add("POST", "/further", self._add_pair, "Learn from a further pair, too", AddedPair)
        routes.add("PUT", "/further", self._keep_pairs, "Which further pairs stay", KeptPairs)
        routes.add("POST", "/tap", self._tap, "What was tapped is the part", Tap)
        what = "Take features, or leave them"
        routes.add("PUT", "/features", self._take, what, Taking, limit_bytes=64 * 1024)
        add_activation(routes, self._activate, "Let the cell have the job")

    async def _begin(self, call: Call[TeachingBeginning]) -> DraftHead:
        return await self._teachings.begin(call.visitor.name, **dict(call.body))

    async def _region(self, draft: str, call: Call[Regional]) -> DraftHead:
        return await self._teachings.set_region(draft, call.body.revision, call.body.shapes)

    async def _tap(self, draft: str, call: Call[Tap]) -> DraftHead:
        body = call.body
        return await self._teachings.tap(draft, body.revision, TapPlace(x=body.x, y=body.y))

    async def _draw(self, draft: str, call: Call[DrawingUpload]) -> DraftHead:
        return await self._teachings.draw(draft, call.body.revision, call.body.drawn())

    async def _add_pair(self, draft: str, call: Call[AddedPair]) -> DraftHead:
        body = call.body
        return await self._teachings.add_pair(draft, body.revision, token=body.token, cycle=body.cycle)

    async def _keep_pairs(self, draft: str, call: Call[KeptPairs]) -> DraftHead:
        return await self._teachings.keep_pairs(draft, call.body.revision, call.body.further)

    async def _take(self, draft: str, call: Call[Taking]) -> DraftHead:
        return await self._teachings.take(draft, call.body.revision, call.body.features)

    async def _wish(self, draft: str, call: Call[Wishing]) -> DraftHead:
        body, stated = call.body, call.body.model_fields_set
        sets: dict[str, JsonValue] = {}
        for name in ("name", "number"):
            if (value := getattr(body, name)) is not None:
                sets[name] = value
        # an explicit null is a value too
        sets |= {name: None for name in ("gripping", "sizes", "reference") if name in stated}
        sets |= body.model_dump(mode="json", include={"tilt_deg", "tray"} & stated)
        more: dict[str, Any] = {name: getattr(body, name) for name in ("reference", "gripping", "sizes")}
        return await self._teachings.wish(draft, body.revision, sets, **more)

    async def _activate(self, draft: str, call: Call[Activating]) -> ReleaseDocument:
        await self._activation.check(call.body.token)
        candidate = await self._teachings.candidate(draft)
        call.trail.object = candidate.folder
        # noted first: if killed after the activation, the draft must still know its job
        await self._teachings.note_activated(draft, candidate)
        try:
            asked = self._activation.activate_jobs(candidate.put, signed_mandate(call))
            release = await noted(call, self._activation.fingerprint, asked)
        except (EdgedError, OSError):
            await self._teachings.note_activated(draft, None)
            raise
        await self._teachings.note_job(draft)
        return release
