"""A stage: a virtual cell with a simulated hand, whose board follows the outlines drawn on a screen."""

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
"""Inner corners and square size (mm) of the initial board, which fits the demo's view."""
SHARPEST_PX, TURN_PX = 0.6, 3.0
"""Blur of a lens in focus, and that added (in quadrature) by a quarter turn of its focus ring."""
STEPS = 12
"""Gauss-Newton steps to fit the board to the outline, starting within a few pixels."""
LAID = 1 << 30
"""Start of pose numbers that are never used for scenes of a running cell."""
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
"""Corners of the grid of marks, in the order of a board's outline."""


def stage_board() -> Plate:
    """Make the stage's initial board."""
    return chessboard_plate(*BOARD)


class Stage:
    """Board, part and hand of a virtual cell that has a board. As thread-safe as these.

    clock : returns UTC ns, the same as for the cameras.
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
        self._laid = 0
        self._plate_from_hand = centre_of(self._plate)
        self.hand = Hand(self._middle(), seed=seed, skill=skill)
        self._rings: dict[Side, float] = dict.fromkeys(SIDES, 0.0)
        cell.show(Thing.NOTHING)

    # --- things shown --------------------------------------------------------------------------

    def show(self, thing: Thing, *, covered: bool = False) -> None:
        """Show the board in the hand, the part on the table, or nothing."""
        if thing is Thing.BOARD:
            self.cell.show(thing, self._board_at, covered=covered)
        elif thing is Thing.PART:
            self.lay()
        else:
            self.cell.show(thing)

    def lay(self) -> None:
        """Lay the part at a new random pose, where it stays."""
        self._laid += 1
        self.cell.show(Thing.PART, self.cell.pose(LAID + self._laid))

    def take_board(self, columns: int, rows: int, square_mm: float) -> None:
        """Take another chessboard into the hand. columns, rows : inner corners."""
        self.grid = columns, rows, square_mm
        self.cell.board = self._plate = chessboard_plate(columns, rows, square_mm)
        self._plate_from_hand = centre_of(self._plate)

    def turn_ring(self, side: Side, turn: float) -> None:
        """Turn a lens's focus ring: -1 to 1 quarter turns, 0 is sharp. Raises ValueError outside."""
        if not -1.0 <= turn <= 1.0:
            raise ValueError(f"a ring turns from -1 to 1, not to {turn:g}")
        self._rings[side] = turn
        self.cell.focus(side, math.hypot(SHARPEST_PX, TURN_PX * turn))

    @property
    def rings(self) -> Mapping[Side, float]:
        """Turn of each lens's focus ring, 0 for sharp."""
        return dict(self._rings)

    # --- the hand ------------------------------------------------------------------------------

    def hold(self, rig_from_board: FloatArray | None = None) -> None:
        """Move the board approximately to a pose; None: to the middle of the common field of view."""
        goal = self._middle() if rig_from_board is None else rig_from_board @ self._plate_from_hand
        self.hand.move(goal, self._clock())

    def shown(self) -> tuple[Thing, FloatArray] | None:
        """The thing shown now and its rig_from_thing (4, 4); None for nothing, or for random poses."""
        showing = self.cell.showing
        pose = showing.pose_at(self._clock())
        return None if showing.thing is Thing.NOTHING or pose is None else (showing.thing, pose)

    def carry(self, rig_from_middle: FloatArray) -> None:
        """Put the board's middle exactly at a pose, as held by a robot, without misses and tremor."""
        self.hand.lay(rig_from_middle, self._clock())

    def follow(self, outlines: Mapping[Side, FloatArray]) -> None:
        """Move the board approximately to the outline drawn on a screen.

        outlines : (4, 2) px in both pictures, or in the left one: the outermost marks (x_min, y_min),
        (x_max, y_min), (x_max, y_max), (x_min, y_max). Raises ValueError if no board can look like this.
        """
        self.hold(self.pose_of(outlines))

    def rest(self, still: bool) -> None:
        """Lay the board down, or take it up."""
        self.hand.rest(still, self._clock())

    def moving(self) -> bool:
        """Whether the hand is moving or about to move."""
        return self.hand.moving(self._clock())

    def pose_of(self, outlines: Mapping[Side, FloatArray]) -> FloatArray:
        """rig_from_board (4, 4) of outlines as in `follow`, by least squares in both pictures.

        A person aligns the board with both drawings by eye; while the rig is not well known, the drawings are
        inconsistent, and the board ends up in between.
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
        """Pose perpendicular to the left camera's axis, in the centre of the part's range."""
        rig_from_hand = np.eye(4)
        rig_from_hand[:3, 3] = self.cell.middle_mm
        return rig_from_hand


def _moved(pose: FloatArray, step: FloatArray) -> FloatArray:
    """Change a pose by step (6,) : mm, and rad about the board's own origin."""
    return transform(rotation_matrix(step[3:]) @ pose[:3, :3], pose[:3, 3] + step[:3])
