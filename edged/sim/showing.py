"""What lies or is held before the cameras of a virtual cell, and the hands around it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from edged.domain.arrays import FloatArray, Side
from edged.sim.render.scene import Part, PlacedPart, Plate, RenderedView, RoundedBox, Surface

Pose = FloatArray | Callable[[int], FloatArray]
"""(4, 4) rig_from_thing, or what it is at a time (UTC ns)."""

SKIN = Surface(albedo=0.38, contrast=0.12, feature_mm=1.5, seed=3)
GRIP_MM = 3.0
"""Fingers lie so far before the board that they hold."""
WAVE_MM, WAVE_HZ = 14.0, 1.3
"""Half way and rate of a hand that waves."""
BEFORE_LENS_MM = 55.0
"""A hand that waves before one camera: so near that the other does not see it."""


class Thing(StrEnum):
    """The thing on the table."""

    PART = "part"
    BOARD = "board"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True, eq=False)
class ShownNow:
    """The thing shown, and its pose.

    pose : None: the part lies elsewhere at every exposure. covered : fingers cover a corner of the board.
    waving : a hand moves before this camera.
    """

    thing: Thing = Thing.PART
    pose: Pose | None = None
    covered: bool = False
    waving: Side | None = None

    def pose_at(self, at_ns: int) -> FloatArray | None:
        """(4, 4) rig_from_thing; None where it lies anywhere."""
        return self.pose(at_ns) if callable(self.pose) else self.pose


def fingers(plate: Plate, rig_from_plate: FloatArray) -> PlacedPart:
    """A thumb across the first corner of a board, over its first marks."""
    low, high = plate.points_mm.min(axis=0), plate.points_mm.max(axis=0)
    length, width = 0.34 * (high - low)[:2]
    # from outside the board to a third of its width
    thumb = RoundedBox(low[0], low[1], 2.0 * length, width, 0.45 * width)
    before = np.eye(4)
    before[2, 3] = -GRIP_MM
    return PlacedPart(Part("thumb", thumb, SKIN), rig_from_plate @ before)


def waving_hand(view: RenderedView, at_ns: int) -> PlacedPart:
    """A hand before one camera, on its way from side to side."""
    camera_from_hand = np.eye(4)
    camera_from_hand[0, 3] = WAVE_MM * math.sin(2.0 * math.pi * WAVE_HZ * (at_ns * 1e-9 % 1e6))
    camera_from_hand[2, 3] = BEFORE_LENS_MM
    hand = Part("hand", RoundedBox(0.0, 0.0, 12.0, 60.0, 5.0), SKIN)
    return PlacedPart(hand, np.linalg.inv(view.camera_from_rig) @ camera_from_hand)


def centre_of(plate: Plate) -> FloatArray:
    """(4, 4) plate_from_hand: the hand holds a board by its middle."""
    points = plate.points_mm
    plate_from_hand = np.eye(4)
    plate_from_hand[:3, 3] = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return plate_from_hand
