"""Routes to take the cell for SETUP, extend the lease, give the cell back, and take pictures meanwhile."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from concurrent.futures import Executor

from aiohttp import web
from pydantic import Field, model_validator

from edged.adapters.web.routes import BASE, Answer, Body, Call, Leased, Name, Problem, Token, route
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.frames import FramePair
from edged.identity.visitors import Role
from edged.pictures.encoding import png
from edged.ports import Commissioner

log = logging.getLogger(__name__)

KEPT = 4
"""Number of captured pairs kept for download."""
ENDED = {CellPhase.READY, CellPhase.FAULT, CellPhase.SETUP}
"""States of a cell whose SETUP by a person is over; a cell that stops still belongs to that person."""


class Entering(Body):
    """Request for the cell."""

    name: Name | None = Field(None, description="left out: the name of the visitor")
    take_over: bool = Field(False, description="also from somebody who has it")


class Lease(Answer):
    """Lease of the cell, which belongs to the holder of the token."""

    token: str


class Leaving(Body):
    """Request to end SETUP, by the holder with the token, or by another person.

    name : default: the visitor's.
    """

    token: Token | None = None
    name: Name | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> Leaving:
        if self.token is not None and self.name is not None:
            raise ValueError("expected the token or a name, not both")
        return self


class Capture(Answer):
    """A captured pair. left, right : paths of its raw pictures."""

    exposed_ns: int
    skew_ms: float
    left: str
    right: str


class SetupRoutes:
    """The routes of SETUP. encoder : executor that encodes pictures."""

    def __init__(self, commissioner: Commissioner, encoder: Executor) -> None:
        self._commissioner = commissioner
        self._encoder = encoder
        self._pairs: OrderedDict[int, FramePair] = OrderedDict()
        self._count = 0
        self._holder = ""
        self._is_taken = False

    def holds(self, session: str) -> bool:
        """Whether this session was the last to take the cell, and SETUP has not been ended since."""
        return session != "" and session == self._holder

    def ended_by(self, state: CellState) -> bool:
        """Whether a person's SETUP has just been ended by the plant, not by a request here."""
        was_taken, self._is_taken = self._is_taken, state.setup is SetupSource.PERSON
        is_over = was_taken and not self._is_taken and self._holder != "" and state.state in ENDED
        if is_over:
            self._holder = ""
        return is_over

    @route("POST", "/setup", "Take the cell after the running cycle", status=201, audit=True)
    async def _enter(self, call: Call[Entering]) -> Lease:
        name = call.body.name or call.visitor.name
        token = await self._commissioner.enter_setup(name, take_over=call.body.take_over)
        self._holder = call.visitor.session
        call.trail.reason = f"{name}, also from somebody else" if call.body.take_over else name
        log.info("setup: %s at %s has the cell", name, call.visitor.address)
        return Lease(token=token)

    @route(
        "PUT",
        "/setup/lease",
        "Somebody still looks after the cell: once a minute at least",
        role=Role.VIEWER,
        is_by_itself=True,
        needs_lease=True,
    )
    async def _renew(self, _call: Call[Leased]) -> None:
        """Do nothing: the gate has extended the lease already."""

    @route(
        "DELETE", "/setup", "Give the cell back, or end SETUP for its holder", role=Role.OPERATOR, audit=True
    )
    async def _leave(self, call: Call[Leaving]) -> None:
        if call.body.token is not None:
            await self._commissioner.leave_setup(call.body.token)
            log.info("setup: given back from %s", call.visitor.address)
        else:
            name = call.body.name or call.visitor.name
            call.trail.reason = f"{name}, for the holder"
            await self._commissioner.end_setup(name)
            log.info("setup: ended by %s at %s", name, call.visitor.address)
        self._holder = ""

    @route("POST", "/captures", "One exposure of both cameras", status=201, needs_lease=True)
    async def _capture(self, call: Call[Leased]) -> Capture:
        pair = await self._commissioner.capture(call.body.token)
        self._count += 1
        self._pairs[self._count] = pair
        while len(self._pairs) > KEPT:
            self._pairs.popitem(last=False)
        place = f"{BASE}/captures/{self._count}"
        return Capture(
            exposed_ns=pair.exposed_ns,
            skew_ms=abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-6,
            left=f"{place}/left.png",
            right=f"{place}/right.png",
        )

    @route(
        "GET",
        "/captures/{number:[0-9]{1,9}}/{side:left|right}.png",
        "A raw image of a capture, every grey value as the camera gave it",
        role=Role.VIEWER,
        answer="image/png",
    )
    async def _picture(self, call: Call[None]) -> web.Response:
        pair = self._pairs.get(int(call.part("number")))
        if pair is None:
            raise Problem(404, "gone", f"only the last {KEPT} pairs are kept")
        frame = pair.side(call.side)
        loop = asyncio.get_running_loop()
        data = await loop.run_in_executor(self._encoder, png, frame.image)
        return web.Response(body=data, content_type="image/png")
