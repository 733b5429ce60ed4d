"""Effects of temperature and knocks on the cameras of a virtual cell, exactly known at any time.

Each component follows the ambient temperature with its own time constant. The bar between the cameras
expands, the stand moves both cameras, lenses and sensors shift in their seats, focal lengths change, and the
plate of the reference marks expands. The size of these effects is in `Sensitivity`; their directions are
determined by the seed. World coordinates are those of the rig at the beginning.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import invert, rotation_matrix, transform

DAY_S = 86_400.0
STEPS_OF_A_DAY = 96
"""Straight segments of a day's sine: they deviate by 0.05 % of the swing."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """Ambient temperature relative to the beginning: linear between points (s, K).

    Constant before the first point and after the last one.
    """

    points: tuple[tuple[float, float], ...]

    @classmethod
    def days(cls, swing_k: float, days: float = 1.0, day_s: float = DAY_S) -> Schedule:
        """Schedule of a sine of +- swing_k over each day."""
        count = math.ceil(STEPS_OF_A_DAY * days)
        times = [day_s * k / STEPS_OF_A_DAY for k in range(count + 1)]
        return cls(tuple((t, swing_k * math.sin(2.0 * math.pi * t / day_s)) for t in times))

    def around_k(self, at_s: float) -> float:
        """Ambient temperature at a time."""
        times, kelvins = zip(*self.points, strict=True)
        return float(np.interp(at_s, times, kelvins))

    def of_thing_k(self, at_s: float, lag_s: float) -> float:
        """Temperature of a component that follows the ambient one with a time constant, by exact solution.

        On a line a + b t, starting at T0: a + b (t - lag) + (T0 - a + b lag) exp(-t / lag).
        """
        first_s, own_k = self.points[0]
        if at_s <= first_s:
            return own_k
        last = bisect_right(self.points, at_s, key=lambda point: point[0])
        corners = (*self.points[:last], (at_s, self.around_k(at_s)))
        for (begin_s, begin_k), (end_s, end_k) in itertools.pairwise(corners):
            takes_s = end_s - begin_s
            if takes_s > 0.0:
                slope = (end_k - begin_k) / takes_s
                lagging = begin_k - slope * lag_s
                own_k = lagging + slope * takes_s + (own_k - lagging) * math.exp(-takes_s / lag_s)
        return own_k


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Effects of a kelvin, and thermal time constants of the components.

    Material constants are those of handbooks: aluminium 23.1, steel 11.5 per million and kelvin. A seat shift
    of 0.1 µm, a turn of 10 µrad and a focal length change of 10 per million for each kelvin give, over 10 K,
    the displacements whose effects `docs/how-to/marks.md` describes. Time constants are those of blocks of
    metal of 0.2 to 3 kg in still air (10 W/(m² K)).
    """

    bar_per_k: float = 23.1e-6
    stand_mm_per_k: float = 0.0035
    turn_rad_per_k: float = 10e-6
    seat_mm_per_k: float = 1e-4
    focal_per_k: float = 10e-6
    plate_per_k: float = 11.5e-6
    pixel_mm: float = 4.65e-3
    bar_lag_s: float = 3_600.0
    stand_lag_s: float = 7_200.0
    camera_lag_s: tuple[float, float] = (1_200.0, 1_500.0)
    plate_lag_s: float = 5_400.0


@dataclass(frozen=True, slots=True)
class Knock:
    """A lasting displacement of a camera, or of the whole rig, by a knock.

    shift_mm, turn_rad (3,) : in that camera's axes, about its centre; for the rig those of the left camera.
    """

    at_s: float
    hit: Side | Literal["rig"]
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def moved(self) -> FloatArray:
        """Motion (4, 4): new pose from old pose."""
        return transform(rotation_matrix(np.array(self.turn_rad)), np.array(self.shift_mm))


@dataclass(frozen=True, slots=True, eq=False)
class TrueCameras:
    """True state of the cameras at one moment.

    left_from_world, right_from_world (4, 4).  plate_scale : expansion factor of the plate of the marks.
    """

    left: CameraModel
    right: CameraModel
    left_from_world: FloatArray
    right_from_world: FloatArray
    plate_scale: float

    def camera(self, side: Side) -> tuple[CameraModel, FloatArray]:
        """One camera and its pose camera_from_world (4, 4)."""
        return (self.left, self.left_from_world) if side == "left" else (self.right, self.right_from_world)

    @property
    def rig(self) -> StereoRig:
        """The rig that a perfect calibration would find at this moment."""
        right_from_left = self.right_from_world @ invert(self.left_from_world)
        return StereoRig(self.left, self.right, right_from_left, "weather")


@dataclass(frozen=True, slots=True, eq=False)
class Weather:
    """A rig under changing conditions. rig : its initial state; seed : determines directions of movements."""

    rig: StereoRig
    schedule: Schedule
    knocks: Sequence[Knock] = ()
    seed: int = 0
    does: Sensitivity = field(default_factory=Sensitivity)

    def at(self, at_s: float) -> TrueCameras:
        """State of the cameras at a time after the beginning."""
        does, schedule = self.does, self.schedule
        bar_k = schedule.of_thing_k(at_s, does.bar_lag_s)
        stand_k = schedule.of_thing_k(at_s, does.stand_lag_s)
        plate_k = schedule.of_thing_k(at_s, does.plate_lag_s)
        rng = np.random.default_rng((self.seed, 31))
        stand = transform(
            rotation_matrix(0.5 * does.turn_rad_per_k * stand_k * _direction(rng)),
            does.stand_mm_per_k * stand_k * _direction(rng),
        )
        along = np.eye(4)
        along[:3, 3] = does.bar_per_k * bar_k * self.rig.right_from_left[:3, 3]
        stood = {"left": np.eye(4), "right": along @ self.rig.right_from_left}
        cameras = {}
        for side, lag_s in zip(SIDES, does.camera_lag_s, strict=True):
            own_k = schedule.of_thing_k(at_s, lag_s)
            turned = rotation_matrix(does.turn_rad_per_k * own_k * _direction(rng))
            pose = transform(turned, np.zeros(3)) @ stood[side] @ invert(stand)
            cameras[side] = self._warm(side, own_k, rng), pose
        for knock in self.knocks:
            if at_s >= knock.at_s:
                for side in SIDES:
                    camera, pose = cameras[side]
                    if knock.hit == "rig":
                        cameras[side] = camera, pose @ invert(knock.moved)
                    elif knock.hit == side:
                        cameras[side] = camera, invert(knock.moved) @ pose
        (left, in_left), (right, in_right) = (cameras[side] for side in SIDES)
        return TrueCameras(left, right, in_left, in_right, 1.0 + does.plate_per_k * plate_k)

    def _warm(self, side: Side, own_k: float, rng: np.random.Generator) -> CameraModel:
        """A camera with the present focal length and principal point."""
        camera, does = self.rig.camera(side), self.does
        seat_px = does.seat_mm_per_k * own_k / does.pixel_mm * _direction(rng)
        grown = 1.0 + does.focal_per_k * own_k * rng.choice((-1.0, 1.0))
        return replace(
            camera,
            fx=camera.fx * grown,
            fy=camera.fy * grown,
            cx=camera.cx + float(seat_px[0]),
            cy=camera.cy + float(seat_px[1]),
        )


def _direction(rng: np.random.Generator) -> FloatArray:
    """A random unit vector (3,)."""
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))
