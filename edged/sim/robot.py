"""A virtual robot beside a stage: it holds the board or the cameras, and touches points they see."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from edged.domain.arrays import FloatArray
from edged.sim.showing import Thing
from edged.sim.stage import Stage
from edged.vision.geometry.rigid import invert, rotation_matrix, transform

Carried = Literal["board", "cameras"]
LEVER_MM = 100.0
"""Distance at which the noise of a rotation equals that of a position."""
WALK_DEG = (
    (0, 0, 0),
    (14, 0, 20),
    (-14, 0, -20),
    (0, 14, 40),
    (0, -14, -40),
    (10, 10, -30),
    (-10, 10, 30),
    (10, -10, 10),
    (-10, -10, -10),
    (12, 5, 35),
)
"""Rotations about x, y and z of the carried thing, for the ten poses of a robot's program."""
SHIFT_MM = 6.0


def _rotated(degrees: tuple[float, float, float], shift_mm: tuple[float, float, float]) -> FloatArray:
    x, y, z = np.radians(degrees)
    turned = (
        rotation_matrix(np.array([0, 0, z]))
        @ rotation_matrix(np.array([0, y, 0]))
        @ rotation_matrix(np.array([x, 0, 0]))
    )
    return transform(turned, np.array(shift_mm))


FLANGE_FROM_BOARD = _rotated((3.0, 178.0, 40.0), (12.0, -30.0, 85.0))
"""Pose of the board in the robot's gripper."""
FLANGE_FROM_RIG = _rotated((2.0, -4.0, 95.0), (60.0, -20.0, 110.0))
"""Pose of the cameras on the flange."""
ROBOT_FROM_BOARD = _rotated((0.5, 1.0, 20.0), (520.0, -80.0, 15.0))
"""Pose of the board while the robot carries the cameras."""


class VirtualRobot:
    """A robot whose controller shows the true state of the stage, with noise. Raises ValueError if the
    cell's own rig is not registered to a robot."""

    def __init__(self, stage: Stage) -> None:
        if stage.cell.rig.robot_from_rig is None:
            raise ValueError("the cell's rig knows no robot")
        self._stage = stage
        self._robot_from_rig = stage.cell.rig.robot_from_rig
        self._rng = np.random.default_rng((0, 9))
        self._steps = 0

    def walk(self) -> int:
        """Carry the board, or the cameras over it, to the next of ten poses; returns its number, from 1."""
        turn = WALK_DEG[self._steps % len(WALK_DEG)]
        place = np.eye(4)
        place[:3, 3] = self._stage.cell.middle_mm
        angle = 2.4 * self._steps
        shift = (SHIFT_MM * math.cos(angle), SHIFT_MM * math.sin(angle), 0.5 * SHIFT_MM * math.cos(3 * angle))
        self._stage.carry(place @ _rotated(turn, shift))
        self._steps += 1
        return 1 + (self._steps - 1) % len(WALK_DEG)

    def flange(self, carries: Carried, noise_um: float = 0.0) -> FloatArray | None:
        """robot_from_flange (4, 4); None while no board is shown."""
        shown = self._stage.shown()
        if shown is None or shown[0] is not Thing.BOARD:
            return None
        if carries == "board":
            pose = self._robot_from_rig @ shown[1] @ invert(FLANGE_FROM_BOARD)
        else:
            pose = ROBOT_FROM_BOARD @ invert(shown[1]) @ invert(FLANGE_FROM_RIG)
        shift = self._rng.normal(0.0, 1e-3 * noise_um, 3)
        turn = rotation_matrix(self._rng.normal(0.0, 1e-3 * noise_um / LEVER_MM, 3))
        return transform(turn @ pose[:3, :3], pose[:3, 3] + shift)

    def tip(self, carries: Carried, left_px: tuple[float, float], noise_um: float = 0.0) -> FloatArray | None:
        """Tip position (3,) mm, robot frame, on the feature nearest to a point of the left picture.

        Features are the centres of the part's circles, or the board's marks; None while nothing is shown.
        If the robot carries the cameras, the thing shown lies at the board's pose.
        """
        shown = self._stage.shown()
        if shown is None:
            return None
        thing, rig_from_thing = shown
        points = self._points(thing, rig_from_thing)
        seen = self._stage.cell.view("left").project(points)
        nearest = points[int(np.argmin(np.linalg.norm(seen - np.array(left_px), axis=1)))]
        robot_from_rig = self._robot_from_rig
        if carries == "cameras":
            robot_from_rig = ROBOT_FROM_BOARD @ invert(rig_from_thing)
        at = robot_from_rig[:3, :3] @ nearest + robot_from_rig[:3, 3]
        return np.asarray(at + self._rng.normal(0.0, 1e-3 * noise_um, 3))

    def _points(self, thing: Thing, rig_from_thing: FloatArray) -> FloatArray:
        board, circles = self._stage.cell.board, self._stage.cell.part.circles
        if thing is Thing.BOARD and board is not None:
            own = np.asarray(board.points_mm)
        else:
            own = np.array([(disc.x_mm, disc.y_mm, 0.0) for _, disc in circles])
        return np.asarray(own @ rig_from_thing[:3, :3].T + rig_from_thing[:3, 3])
