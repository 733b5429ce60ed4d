"""A stage: a virtual cell with a simulated hand. The board follows what a screen shows."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

import cv2
import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.sim.cell import VirtualCell
from edged.sim.hand import Hand, Skill
from edged.sim.render.lens import rays_of_pixels
from edged.sim.render.scene import Plate, chessboard_plate
from edged.sim.showing import Thing, centre_of
from edged.vision.geometry.rigid import invert, rotation_matrix, transform

BOARD = (11, 8, 4.0)
"""Inner corners and squares (mm) of the board that fits the demo's view, and lies there at first."""
SHARPEST_PX, TURN_PX = 0.6, 3.0
"""Blur of a lens in focus, and what a quarter turn of its ring adds (in quadrature)."""
STEPS = 12
"""Gauss-Newton steps until the board lies on the outline: it starts within a few pixels."""
LAID = 1 << 30
"""Numbers of poses that are no scenes of a running cell."""
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
"""Corners of the grid of marks, in the order of a board's outline."""


def stage_board() -> Plate:
    """The board of the stage."""
    return chessboard_plate(*BOARD)


class Stage:
    """Board, part and hand of a virtual cell that has a board. Thread-safe as these are.

    clock : UTC ns, the cameras' own.
    Raises ValueError for a cell without a board.
    """

    def __init__(
        self,
        cell: VirtualCell,
        *,
        seed: int = 0,
        skill: Skill | None = None,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        if cell.board is None:
            raise ValueError("the cell has no board to hold")
        self.cell = cell
        self.grid = BOARD
        self._plate = cell.board
        self._clock = clock
        self._seed, self._laid = seed, 0
        self._plate_from_hand = centre_of(self._plate)
        self.hand = Hand(self._middle(), seed=seed, skill=skill)
        self._rings: dict[Side, float] = dict.fromkeys(SIDES, 0.0)
        cell.show(Thing.NOTHING)

    # --- what there is to see ------------------------------------------------------------------

    def show(self, thing: Thing, *, covered: bool = False) -> None:
        """The board in the hand, the part on the table, or nothing."""
        if thing is Thing.BOARD:
            self.cell.show(thing, self._board_at, covered=covered)
        elif thing is Thing.PART:
            self.lay()
        else:
            self.cell.show(thing)

    def lay(self) -> None:
        """The part somewhere else, where it stays."""
        self._laid += 1
        self.cell.show(Thing.PART, self.cell.pose(LAID + self._laid))

    def take_board(self, columns: int, rows: int, square_mm: float) -> None:
        """Another chessboard into the hand: inner corners, and its squares."""
        self.grid = columns, rows, square_mm
        self.cell.board = self._plate = chessboard_plate(columns, rows, square_mm)
        self._plate_from_hand = centre_of(self._plate)

    def turn_ring(self, side: Side, turn: float) -> None:
        """Focus a lens: -1 to 1 quarter turns, 0 is sharp. Raises ValueError outside."""
        if not -1.0 <= turn <= 1.0:
            raise ValueError(f"a ring turns from -1 to 1, not to {turn:g}")
        self._rings[side] = turn
        self.cell.focus(side, math.hypot(SHARPEST_PX, TURN_PX * turn))

    @property
    def rings(self) -> Mapping[Side, float]:
        """Turn of each lens from sharp."""
        return dict(self._rings)

    # --- the hand ------------------------------------------------------------------------------

    def hold(self, rig_from_board: FloatArray | None = None) -> None:
        """Move the board there, more or less; None: to the middle of what both cameras see."""
        goal = self._middle() if rig_from_board is None else rig_from_board @ self._plate_from_hand
        self.hand.move(goal, self._clock())

    def shown(self) -> tuple[Thing, FloatArray] | None:
        """What is before the cameras now, and where: rig_from_thing (4, 4); None for nothing."""
        showing = self.cell.showing
        pose = showing.pose_at(self._clock())
        return None if showing.thing is Thing.NOTHING or pose is None else (showing.thing, pose)

    def carry(self, rig_from_middle: FloatArray) -> None:
        """Let a robot hold the board's middle there: it neither misses nor trembles."""
        self.hand.lay(rig_from_middle, self._clock())

    def follow(self, outlines: Mapping[Side, FloatArray]) -> None:
        """Move the board to where a screen draws it, more or less.

        outlines : (4, 2) px of both pictures, or of the left one: the outermost marks (x_min, y_min),
        (x_max, y_min), (x_max, y_max), (x_min, y_max). Raises ValueError for what no board looks like.
        """
        self.hold(self.pose_of(outlines))

    def rest(self, still: bool) -> None:
        """Lay the board down, or take it up."""
        self.hand.rest(still, self._clock())

    def moving(self) -> bool:
        """Whether the hand is on its way."""
        return self.hand.moving(self._clock())

    def pose_of(self, outlines: Mapping[Side, FloatArray]) -> FloatArray:
        """(4, 4) rig_from_board of outlines as `follow` takes them: least squares in both pictures.

        A person lays the board onto both drawings by eye; drawings of a rig that is not known well yet do not
        fit each other, and the board lies between.
        """
        sides = [side for side in SIDES if side in outlines]
        views = {side: self.cell.view(side) for side in sides}
        marks = self._outline_mm()
        goal = np.concatenate([np.asarray(outlines[side], np.float64) for side in sides])
        if "left" not in outlines or goal.shape != (4 * len(sides), 2) or not np.isfinite(goal).all():
            raise ValueError("expected four points in each picture")
        rays = rays_of_pixels(views["left"].camera, goal[:4])
        found, turn, shift = cv2.solvePnP(marks, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not found or not np.isfinite(turn).all() or shift[2] <= 0:
            raise ValueError("no board looks like this")
        pose = _moved(np.eye(4), np.concatenate([shift.ravel(), turn.ravel()]).astype(np.float64))

        def seen(at: FloatArray) -> FloatArray:
            points = marks @ at[:3, :3].T + at[:3, 3]
            return np.concatenate([views[side].project(points) for side in sides]).ravel()

        for _ in range(STEPS):
            here = seen(pose)
            slopes = np.stack(
                [(seen(_moved(pose, 1e-4 * np.eye(6)[k])) - here) / 1e-4 for k in range(6)], axis=1
            )
            step, *_ = np.linalg.lstsq(slopes, goal.ravel() - here, rcond=None)
            pose = _moved(pose, step.astype(np.float64))
        return pose

    def _outline_mm(self) -> FloatArray:
        low, high = self._plate.points_mm.min(axis=0), self._plate.points_mm.max(axis=0)
        return np.array([low + (high - low) * (*corner, 0) for corner in CORNERS])

    def _board_at(self, at_ns: int) -> FloatArray:
        return self.hand.pose(at_ns) @ invert(self._plate_from_hand)

    def _middle(self) -> FloatArray:
        """Square to the left camera, in the middle of where the part may lie."""
        rig_from_hand = np.eye(4)
        rig_from_hand[:3, 3] = self.cell.middle_mm
        return rig_from_hand


def _moved(pose: FloatArray, step: FloatArray) -> FloatArray:
    """step (6,) : mm, and rad about the board's own origin."""
    return transform(rotation_matrix(step[3:]) @ pose[:3, :3], pose[:3, 3] + step[:3])
