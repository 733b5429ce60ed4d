"""Routes of calibration drafts, of tasks, and of checks of the rig in use."""

from __future__ import annotations

import asyncio
from typing import Annotated

from aiohttp import web
from pydantic import Field, model_validator

from edged.adapters.web.routes import Body, Call, Leased, Name, RouteTable, route
from edged.errors import CalibrationError
from edged.identity.visitors import Role
from edged.setup.calibration.checks import CheckDocument, Checked, Checks
from edged.setup.calibration.documents import DraftDocument, DraftList
from edged.setup.calibration.service import Calibrations
from edged.setup.documents import DraftHead
from edged.setup.draftroutes import Begun, DraftRoutes, Nothing, known, report_answer, unknown
from edged.setup.jobs.tasks import TaskDocument, Tasks
from edged.setup.releases.routes import Activating, ReleaseDocument, activated, add_activation
from edged.setup.releases.service import Activation
from edged.vision.boards.board import parse_boards
from edged.vision.calibration.lenschoice import LensWish

VIEW = "/views/{name:view_[0-9]{3}}"
TASK = "/tasks/{id:[0-9a-f]{12}}"
Goal = Annotated[float, Field(gt=0, le=1e6, description="µm: none of the sigmas of X, Y, Z beyond it")]


class CalibrationBeginning(Body):
    """The boards, as `edged calibrate --board` takes them; or "recognise" the one in view, with its pitch."""

    boards: Annotated[tuple[Annotated[str, Field(max_length=100)], ...], Field(max_length=8)] = ()
    recognise: bool = False
    mm: Annotated[float, Field(gt=0, le=1e4, description="pitch of a board that is recognised")] | None = None
    goal_um: Goal | None = None
    lens: LensWish = "auto"

    @model_validator(mode="after")
    def _is_consistent(self) -> CalibrationBeginning:
        if self.recognise == bool(self.boards) or self.recognise != (self.mm is not None):
            raise ValueError('expected either boards, or "recognise": true with mm')
        return self


class Wanted(Body):
    """Goal of the calibration."""

    goal_um: Goal | None


class Auto(Leased):
    """Whether pairs are taken automatically when the board is held still in a useful place."""

    on: bool


class CalibrationRoutes:
    """Routes of calibration drafts and of tasks."""

    def __init__(self, calibrations: Calibrations, tasks: Tasks, activation: Activation) -> None:
        self._calibrations = calibrations
        self._tasks = tasks
        self._activation = activation

    def add_to(self, table: RouteTable) -> None:
        """Add the routes to a table."""
        see, ours = Role.VIEWER, self._calibrations
        routes = DraftRoutes(table, "/calibrations", ours.drafts, DraftDocument, Nothing)
        words = {"GET all": "All drafts, the youngest first", "GET": "A draft as it stands"}
        routes.add_usual(DraftList, "calibrations", {**words, "DELETE": "Discard a draft"})
        routes.add_begin(self._begin, "Begin a draft", CalibrationBeginning)
        routes.add_change(
            "PUT", "", lambda draft, call: draft.set_goal(call.body.goal_um), "What is wanted of it", Wanted
        )
        what = "Go on with a draft: live pairs are looked at for it, and for no other"
        routes.add("POST", "/go-on", lambda draft, _: ours.go_on(draft), what, Nothing)
        routes.add("POST", "/views", self._add, "Take a pair", Leased, status=201, needs_lease=True)
        routes.add(
            "PUT", "/auto", self._auto, "Whether pairs are taken by themselves", Auto, needs_lease=True
        )
        routes.add_change(
            "DELETE", VIEW, lambda draft, call: draft.remove(call.part("name")), "Leave a view out", Nothing
        )
        routes.add_file(
            VIEW + "/{side:left|right}.jpg",
            lambda draft, call: (
                draft.small(call.part("name"), call.part("side"))
                if call.part("name") in draft.state.taken
                else None
            ),
            "A small picture",
        )
        what = "Solve it, and hold views out: half a minute for 20 pairs"
        routes.add("POST", "/solve", self._solve, what, Nothing, answer=Begun, status=202, audit=True)
        add_activation(routes, self._activate, "Let the cell run by what the draft was solved to")
        what = "What it was solved to, for people"
        routes.add("GET", "/report", self._report, what, answer="text/html", role=see)

    async def _begin(self, call: Call[CalibrationBeginning]) -> DraftHead:
        body = call.body
        return await self._calibrations.begin(
            call.visitor.name, body.boards, body.mm, body.goal_um, body.lens
        )

    async def _add(self, draft: str, call: Call[Leased]) -> DraftHead:
        return await self._calibrations.add(draft, call.body.token)

    async def _auto(self, draft: str, call: Call[Auto]) -> DraftHead:
        return await self._calibrations.set_auto_capture(draft, call.body.token, on=call.body.on)

    async def _solve(self, draft: str, call: Call[Nothing]) -> Begun:
        call.trail.object = task = await self._calibrations.solve(draft)
        return Begun(task=task)

    async def _activate(self, draft: str, call: Call[Activating]) -> ReleaseDocument:
        ours = self._calibrations
        release = await activated(self._activation, call, ours.solution, ours.drafts)
        ours.stop_auto_capture(draft)
        return release

    async def _report(self, draft: str, _: Call[None]) -> web.Response:
        page = await asyncio.to_thread((await self._calibrations.drafts.get(draft)).draft.report)
        return report_answer(page)

    @route("GET", TASK, "How far long work is", role=Role.VIEWER)
    async def _task(self, call: Call[None]) -> TaskDocument:
        try:
            return self._tasks.document(call.part("id"))
        except KeyError:
            raise unknown() from None

    @route("DELETE", TASK, "End long work")
    async def _cancel(self, call: Call[Nothing]) -> TaskDocument:
        return await known(self._tasks.cancel(call.part("id")))


Millimetres = Annotated[float, Field(ge=0.001, le=100_000)]


class Checking(Leased):
    """Check by a board, as `edged verify --board` takes it; or by a part: its job, and true lengths in mm.

    lengths : by the name of a measurement of the job, of a circle (its diameter), or of two circles as A-B.
    """

    board: Annotated[str, Field(max_length=100)] | None = None
    job: Name | None = None
    lengths: Annotated[dict[Name, Millimetres], Field(max_length=20)] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_consistent(self) -> Checking:
        if (self.board is None) == (self.job is None) or (self.job is None) == bool(self.lengths):
            raise ValueError("expected either board, or job with lengths")
        return self


class CheckRoutes:
    """Routes of checks of the rig in use."""

    def __init__(self, checks: Checks) -> None:
        self._checks = checks

    @route("GET", "/checks", "The last check of the rig", role=Role.VIEWER)
    async def _last(self, _call: Call[None]) -> Checked:
        return await self._checks.last()

    @route(
        "POST",
        "/checks",
        "Take a pair of a board, or of a part of known size, and say whether the rig in use still holds",
        status=201,
        audit=True,
        needs_lease=True,
    )
    async def _check(self, call: Call[Checking]) -> CheckDocument:
        body, author = call.body, call.visitor.name
        if body.board is not None:
            boards = parse_boards(body.board)
            if len(boards) != 1:
                raise CalibrationError("expected one board")
            document = await self._checks.by_board(body.token, author, boards[0])
        else:
            document = await self._checks.by_part(body.token, author, body.job or "", body.lengths)
        call.trail.object = f"{document.calibration} {document.verdict}"
        return document
