"""Routes of the stage, only in `edged demo --stage`: move the virtual hand, and see the exact truth.

Also of its virtual robot: the numbers on its pendant, in the convention of any brand.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from edged.adapters.terminal import TruthComparison
from edged.adapters.web.routes import Answer, Body, Call, Problem, route
from edged.domain.arrays import SIDES, FloatArray, Side
from edged.domain.events import Event, Snapshot
from edged.identity.visitors import Role
from edged.robot.orientations import Brand, pose_of
from edged.robot.pendant import PENDANTS, mm_per_unit
from edged.sim.robot import VirtualRobot
from edged.sim.showing import Thing
from edged.sim.stage import Stage

Turn = Annotated[float, Field(ge=-1, le=1)]
Corner = Annotated[list[float], Field(min_length=2, max_length=2)]
Outline = Annotated[list[Corner], Field(min_length=4, max_length=4)]
Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Pose = Annotated[list[Row], Field(min_length=4, max_length=4)]
Name = Literal["left", "right"]


class Rings(Body):
    """Focus rings of both lenses, in quarter turns from sharp."""

    left: Turn | None = None
    right: Turn | None = None


class ShowRequest(Body):
    """Objects to show to the cameras; omitted fields stay. waving : "none" ends it."""

    showing: Literal["part", "board", "nothing"] | None = None
    covered: bool | None = None
    still: bool | None = None
    waving: Literal["left", "right", "none"] | None = None
    rings: Rings | None = None


class Holding(Body):
    """Place for the board: an outline in both pictures or the left one, a pose, or by default the middle."""

    left: Outline | None = None
    right: Outline | list[Corner] | None = Field(None, description="empty: not drawn")
    rig_from_board: Pose | None = None


class Laying(Body):
    """Lay the part somewhere else."""


class StageNow(Answer):
    """Objects in front of the cameras. board : its specification, as for a calibration."""

    showing: Literal["part", "board", "nothing"]
    board: str
    moving: bool
    still: bool
    covered: bool
    waving: Name | None
    rings: dict[str, float]


class TruthNow(Answer):
    """The last result and the truth. error_mm : measured - true, rig frame; null if nothing to compare."""

    at_ns: int | None = None
    showing: Literal["part", "board", "nothing"] | None = None
    rig_from_thing: list[list[float]] | None = None
    status: str | None = None
    error_mm: list[float] | None = None
    sigma_mm: list[float] | None = None
    angle_deg: float | None = None


class StageRoutes:
    """Routes of the stage, and a publisher that remembers the last result. robot : the robot's routes."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self.robot = StageRobotRoutes(stage)
        self._last: Snapshot | None = None

    # --- publisher -----------------------------------------------------------------------------

    async def start(self) -> None:
        """Nothing to open."""

    def announce(self, event: Event) -> None:
        """Remember the last result."""
        if isinstance(event, Snapshot):
            self._last = event

    async def close(self) -> None:
        """Nothing to close."""

    # --- routes --------------------------------------------------------------------------------

    @route("GET", "/stage", "What is before the virtual cameras", role=Role.VIEWER)
    async def _now(self, _call: Call[Any]) -> StageNow:
        stage, showing = self._stage, self._stage.cell.showing
        columns, rows, square_mm = stage.grid
        return StageNow(
            showing=showing.thing.value,
            board=f"chessboard:{columns}x{rows}:{square_mm:g}",
            moving=stage.moving(),
            still=stage.hand.still,
            covered=showing.covered,
            waving=showing.waving,
            rings=dict(stage.rings.items()),
        )

    @route(
        "PUT", "/stage", "Show board, part or nothing; wave a hand; turn a lens's ring", role=Role.OPERATOR
    )
    async def _show(self, call: Call[ShowRequest]) -> StageNow:
        body, stage = call.body, self._stage
        before = stage.cell.showing
        thing = before.thing if body.showing is None else Thing(body.showing)
        covered = before.covered if body.covered is None else body.covered
        if (thing, covered) != (before.thing, before.covered):
            stage.show(thing, covered=covered)
        if body.still is not None:
            stage.rest(body.still)
        if body.waving is not None:
            stage.cell.wave(None if body.waving == "none" else body.waving)
        if body.rings is not None:
            for side in SIDES:
                turn = getattr(body.rings, side)
                if turn is not None:
                    await asyncio.to_thread(stage.turn_ring, side, turn)
        return await self._now(call)

    @route("PUT", "/stage/hand", "Move the board, by a hand that trembles and misses", role=Role.OPERATOR)
    async def _hold(self, call: Call[Holding]) -> StageNow:
        body, stage = call.body, self._stage
        if body.left is not None:
            outlines: dict[Side, FloatArray] = {"left": np.array(body.left)}
            if body.right:
                outlines["right"] = np.array(body.right)
            _tried(lambda: stage.follow(outlines))
        else:
            stage.hold(None if body.rig_from_board is None else _rigid(body.rig_from_board))
        if stage.cell.showing.thing is not Thing.BOARD:
            stage.show(Thing.BOARD)
        return await self._now(call)

    @route("POST", "/stage/lay", "Lay the part somewhere else", role=Role.OPERATOR)
    async def _lay(self, call: Call[Laying]) -> StageNow:
        self._stage.lay()
        return await self._now(call)

    @route("GET", "/stage/truth", "The last result beside what is true", role=Role.VIEWER)
    async def _truth(self, _call: Call[None]) -> TruthNow:
        last = self._last
        true = None if last is None else self._stage.cell.truth(last.exposed_ns)
        if last is None or true is None:
            return TruthNow()
        seen = TruthComparison.of(last, true.rig_from_part) if true.thing is Thing.PART else None
        return TruthNow(
            at_ns=last.exposed_ns,
            showing=true.thing.value,
            rig_from_thing=true.rig_from_part.tolist(),
            status=str(last.status),
            error_mm=None if seen is None else seen.error_mm.tolist(),
            sigma_mm=None if seen is None else seen.sigma_mm.tolist(),
            angle_deg=None if seen is None else float(np.degrees(seen.angle_rad)),
        )


def _tried(action: Callable[[], Any]) -> None:
    try:
        action()
    except ValueError as error:
        raise Problem(422, "no_board", str(error)) from error


def _rigid(rows: list[list[float]]) -> FloatArray:
    """Pose from its rows. Raises `Problem` if it is not a rigid pose."""
    pose = np.array(rows)
    turn = pose[:3, :3]
    is_rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not is_rigid or pose[3].tolist() != [0, 0, 0, 1] or np.abs(pose[:3, 3]).max() > 1000:
        raise Problem(422, "no_pose", "expected a rotation and a place within a metre")
    return pose


Pixel = Annotated[float, Field(ge=-1e4, le=1e4)]


class PendantQuery(Body):
    """Request for the pendant's numbers. x, y : px of the left picture: the tip is placed on the nearest
    feature; without them, the flange's pose is shown.

    noise_um : standard deviation of each coordinate; for rotations the same at 100 mm.
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
    """Move to the next pose."""


class Walked(Answer):
    """Pose that was reached. number : of the pose, out of ten."""

    number: int


class PendantNow(Answer):
    """Numbers that the pendant shows. text : the same as text, for copying."""

    numbers: list[float]
    text: str


class StageRobotRoutes:
    """Routes of the virtual robot."""

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
