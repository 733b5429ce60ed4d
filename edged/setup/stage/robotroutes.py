"""The stage's virtual robot over HTTP: what its pendant shows, in the words of any brand."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from edged.adapters.web.routes import Answer, Body, Call, Problem, route
from edged.identity.visitors import Role
from edged.robot.orientations import Brand, pose_of
from edged.robot.pendant import PENDANTS, mm_per_unit
from edged.sim.robot import VirtualRobot
from edged.sim.showing import Thing
from edged.sim.stage import Stage

Pixel = Annotated[float, Field(ge=-1e4, le=1e4)]


class PendantQuery(Body):
    """In whose words. x, y : px of the left picture: the tip on what is nearest there; else the flange.

    noise_um : standard deviation of each coordinate; of rotations as much at 100 mm.
    """

    brand: Annotated[Brand, Field(strict=False)] = Brand.KUKA
    carries: Literal["board", "cameras"] = "board"
    x: Pixel | None = None
    y: Pixel | None = None
    noise_um: Annotated[float, Field(ge=0, le=1e4)] = 10.0

    @model_validator(mode="after")
    def _both_or_none(self) -> PendantQuery:
        if (self.x is None) != (self.y is None):
            raise ValueError("expected x and y, or neither")
        return self


class Walking(Body):
    """To the next pose."""


class Walked(Answer):
    """number : of the pose, of ten."""

    number: int


class PendantNow(Answer):
    """What the pendant shows; text : as it is copied."""

    numbers: list[float]
    text: str


class StageRobotRoutes:
    """The routes."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._robot = VirtualRobot(stage)

    @route("GET", "/stage/robot", "What the virtual robot's pendant shows", role=Role.VIEWER)
    async def _show(self, call: Call[PendantQuery]) -> PendantNow:
        body = call.body
        if body.x is not None and body.y is not None:
            point = self._robot.tip(body.carries, (body.x, body.y), body.noise_um)
            if point is None:
                raise Problem(409, "nothing_shown", "show board or part first")
            x, y, z = (point / mm_per_unit(body.brand)).tolist()
            numbers: tuple[float, ...] = (x, y, z)
        else:
            flange = self._robot.flange(body.carries, body.noise_um)
            if flange is None:
                raise Problem(409, "nothing_shown", "show the board first")
            numbers = pose_of(body.brand, flange)
        return PendantNow(numbers=list(numbers), text=PENDANTS[body.brand].text(numbers))

    @route(
        "POST",
        "/stage/robot/walk",
        "Let the virtual robot carry the board, or the cameras, to the next pose",
        role=Role.OPERATOR,
    )
    async def _walk(self, _call: Call[Walking]) -> Walked:
        number = self._robot.walk()
        if self._stage.cell.showing.thing is not Thing.BOARD:
            self._stage.show(Thing.BOARD)
        return Walked(number=number)
