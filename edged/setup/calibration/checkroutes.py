"""The routes of checks of the rig in use."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from edged.adapters.web.routes import Call, Leased, Name, route
from edged.errors import CalibrationError
from edged.identity.visitors import Role
from edged.setup.calibration.checks import CheckDocument, Checked, Checks
from edged.vision.boards.board import parse_boards

Millimetres = Annotated[float, Field(ge=0.001, le=100_000)]


class Checking(Leased):
    """By a board, as `edged verify --board` takes it; or by a part: its job, and true lengths in mm.

    lengths : by the name of a measurement of the job, of a circle (its diameter), or of two circles as A-B.
    """

    board: Annotated[str, Field(max_length=100)] | None = None
    job: Name | None = None
    lengths: Annotated[dict[Name, Millimetres], Field(max_length=20)] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_of_both(self) -> Checking:
        if (self.board is None) == (self.job is None) or (self.job is None) == bool(self.lengths):
            raise ValueError("expected either board, or job with lengths")
        return self


class CheckRoutes:
    """The routes."""

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
