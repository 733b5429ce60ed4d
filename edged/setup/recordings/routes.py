"""The routes of recorded cycles: the list, one with its features and pictures, and what would have been."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Annotated, Literal

from aiohttp import web
from pydantic import Field

from edged.adapters.web.routes import Body, Call, route
from edged.errors import FileFormatError, ImageError
from edged.identity.visitors import Role
from edged.setup.draftroutes import known
from edged.setup.recordings.recorded import MOST, CycleFilter, CycleList
from edged.setup.recordings.service import CycleDocument, Cycles
from edged.setup.recordings.whatif import Change, Features, LimitChange, WhatIf

CYCLE = "/cycles/{number:[0-9]{1,9}}"
WHAT_IF_BYTES = 32 * 1024
"""A job may have hundreds of features."""


class CycleQuery(Body):
    """Which recorded cycles. before : older than this number."""

    status: Literal["OK", "NO_TARGET", "LOW_QUALITY", "CAPTURE_FAULT"] | None = None
    reason: Annotated[str, Field(pattern="^[A-Z_]{1,40}$")] | None = None
    job: Annotated[str, Field(max_length=64)] | None = None
    before: Annotated[int, Field(ge=0, le=999_999_999)] | None = None
    most: Annotated[int, Field(ge=1, le=MOST)] = 50


class WhatIfQuestion(Body):
    """A change of limits, features, contrast or light; nothing of it: what would have helped."""

    limits: LimitChange | None = None
    features: Annotated[Features, Field(max_length=256)] | None = None
    contrast: Annotated[float, Field(gt=0, le=255)] | None = None
    light: Annotated[float, Field(ge=0.1, le=10)] | None = None

    def change(self) -> Change | None:
        """What is wanted; None: nothing of it was said."""
        said = {key: value for key, value in self if value is not None}
        return Change(**said) if said else None


class CycleRoutes:
    """The routes."""

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
