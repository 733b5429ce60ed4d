"""Routes of reference marks."""

from __future__ import annotations

from edged.adapters.web.routes import Call, Leased, route
from edged.identity.visitors import Role
from edged.setup.draftroutes import Begun
from edged.setup.marking.service import Marking, MarksDocument, MarksLookDocument


class MarksRoutes:
    """Routes of reference marks."""

    def __init__(self, marking: Marking) -> None:
        self._marking = marking

    @route("GET", "/marks", "The reference marks as they stand", role=Role.VIEWER)
    async def _get(self, _call: Call[None]) -> MarksDocument:
        return await self._marking.document()

    @route("POST", "/marks/look", "Take a pair, and say what its marks say", needs_lease=True)
    async def _look(self, call: Call[Leased]) -> MarksLookDocument:
        return await self._marking.look(call.body.token)

    @route(
        "POST",
        "/marks/teach",
        "Take pairs, teach the marks that all of them show, and correct by them",
        status=202,
        audit=True,
        needs_lease=True,
        needs_password=True,
    )
    async def _teach(self, call: Call[Leased]) -> Begun:
        call.trail.object = task = await self._marking.teach(call.body.token, call.visitor.name)
        return Begun(task=task)
