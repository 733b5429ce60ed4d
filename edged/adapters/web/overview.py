"""The cell at a glance, for the people who set it up: its state, and what is missing."""

from __future__ import annotations

import asyncio
import json

from aiohttp import web
from pydantic import Field

from edged.adapters.web.openapi import document_of
from edged.adapters.web.page import PageSources, StatusPage
from edged.adapters.web.routes import Answer, Call, RouteTable, route
from edged.adapters.web.setup import SetupRoutes
from edged.domain.cell import SetupSource
from edged.domain.numerals import known
from edged.identity.visitors import Role


class SetupNow(Answer):
    """Why and by whom the cell is in SETUP. source : person, no_calibration, no_job."""

    name: str | None = Field(description="null: unattended")
    unattended: bool = Field(description="somebody took it, and is silent")
    yours: bool = Field(description="taken from this very session")
    source: str


class Plc(Answer):
    """State of the PLC."""

    owner: str | None = Field(description="who holds the right to write commands")
    auto_lock: bool = Field(description="SETUP is forbidden")


class RigSigma(Answer):
    """Sigma of a point in the rig frame, µm."""

    x: float
    y: float
    z: float


class RigNow(Answer):
    """The rig in use. robot : yes, no, on_flange."""

    id: str
    robot: str
    verdict: str
    rows_px: float | None
    length_percent: float | None
    sigma_um: RigSigma | None = Field(
        description="by the calibration alone, where parts were taught; null: not known"
    )


class JobName(Answer):
    """A job that can be run."""

    number: int
    name: str


class CellNow(Answer):
    """The cell at this moment."""

    name: str
    state: str | None
    why: str = Field(description="why it does not measure, in English; empty: it does")
    error: str
    error_code: int = Field(description="of a camera's fault; 0: none")
    setup: SetupNow | None
    plc: Plc
    missing: list[str]
    rig: RigNow | None
    jobs: list[JobName]
    stage: bool


class OverviewRoutes:
    """Routes for the state of the cell and for the OpenAPI document of all routes.

    sources : data that events do not carry. setup : knows the session that took the cell last. table : all
    routes. cookie : name of the session cookie.
    """

    def __init__(
        self,
        cell: str,
        page: StatusPage,
        sources: PageSources,
        setup: SetupRoutes,
        table: RouteTable,
        cookie: str,
    ) -> None:
        self._cell = cell
        self._page = page
        self._sources = sources
        self._setup = setup
        self._table = table
        self._cookie = cookie
        self._described = ""

    @route("GET", "/openapi.json", "This document", role=Role.VIEWER, answer="application/json")
    async def _document(self, _call: Call[None]) -> web.Response:
        if not self._described:  # takes a tenth of a second, for the models of all routes
            document = await asyncio.to_thread(document_of, self._table, self._cell, self._cookie)
            self._described = json.dumps(document)
        return web.json_response(text=self._described)

    @route("GET", "/cell", "The cell at a glance", role=Role.VIEWER)
    async def _now(self, call: Call[None]) -> CellNow:
        return self.now(call.visitor.session)

    def now(self, session: str) -> CellNow:
        """The cell as one session sees it."""
        asked, state = self._sources.overview(), self._page.state
        setup = None
        if state is not None and state.setup is not SetupSource.NONE:
            is_person = state.setup is SetupSource.PERSON
            setup = SetupNow(
                name=state.setup_by or None,
                unattended=is_person and not state.setup_by,
                yours=is_person and self._setup.holds(session),
                source=state.setup.name.lower(),
            )
        rig = asked.rig
        return CellNow(
            name=self._cell,
            state=None if state is None else str(state.state),
            why="" if state is None else state.why,
            error="" if state is None else state.error,
            error_code=0 if state is None else state.error_code,
            setup=setup,
            plc=Plc(owner=asked.plc_owner or None, auto_lock=asked.auto_lock),
            missing=list(asked.missing),
            rig=None
            if rig is None
            else RigNow(
                id=rig.calibration_id,
                robot=rig.robot,
                verdict=rig.verdict,
                rows_px=known(rig.rows_px),
                length_percent=known(rig.length_percent),
                sigma_um=_sigma(rig.sigma_um),
            ),
            jobs=[JobName(number=number, name=name) for number, name in self._page.jobs()],
            stage=asked.stage,
        )


def _sigma(axes_um: tuple[float, float, float] | None) -> RigSigma | None:
    if axes_um is None:
        return None
    x, y, z = axes_um
    return RigSigma(x=x, y=y, z=z)
