"""Things shown to the cameras of a virtual cell, and hands in front of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from edged.domain.arrays import FloatArray, Side
from edged.sim.render.scene import Part, PlacedPart, Plate, RenderedView, RoundedBox, Surface

Pose = FloatArray | Callable[[int], FloatArray]
"""rig_from_thing (4, 4), or a function that gives it for a time (UTC ns)."""

SKIN = Surface(albedo=0.38, contrast=0.12, feature_mm=1.5, seed=3)
GRIP_MM = 3.0
"""Distance of the fingers in front of the board that they hold."""
WAVE_MM, WAVE_HZ = 14.0, 1.3
"""Amplitude and frequency of a waving hand."""
BEFORE_LENS_MM = 55.0
"""Distance of a waving hand from its camera: so near that the other camera does not see it."""


class Thing(StrEnum):
    """Things that can be shown to the cameras."""

    PART = "part"
    BOARD = "board"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True, eq=False)
class ShownNow:
    """The thing shown, and its pose.

    pose : None: the part has a new random pose at every exposure. covered : fingers cover a corner of the
    board. waving : camera in front of which a hand is waved.
    """

    thing: Thing = Thing.PART
    pose: Pose | None = None
    covered: bool = False
    waving: Side | None = None

    def pose_at(self, at_ns: int) -> FloatArray | None:
        """rig_from_thing (4, 4) at a time; None for random poses."""
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
    """A hand in front of one camera, waving from side to side."""
    camera_from_hand = np.eye(4)
    camera_from_hand[0, 3] = WAVE_MM * math.sin(2.0 * math.pi * WAVE_HZ * (at_ns * 1e-9 % 1e6))
    camera_from_hand[2, 3] = BEFORE_LENS_MM
    hand = Part("hand", RoundedBox(0.0, 0.0, 12.0, 60.0, 5.0), SKIN)
    return PlacedPart(hand, np.linalg.inv(view.camera_from_rig) @ camera_from_hand)


def centre_of(plate: Plate) -> FloatArray:
    """plate_from_hand (4, 4): the hand holds a board at its centre."""
    points = plate.points_mm
    plate_from_hand = np.eye(4)
    plate_from_hand[:3, 3] = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return plate_from_hand
