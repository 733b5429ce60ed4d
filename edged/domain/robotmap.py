"""The map of a robot's error: where it says that it is, against where the cameras see its tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import I64, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RobotMap:
    """What the map is computed from; see `edged.robot.errormap`.

    expected_mm (N, 3) : places by the registration, robot's frame. shown_mm (N, 3) : what the robot showed
    with its tip there. degree : of the polynomial, from 1. hull (F, 3) : triangles around all places, their
    corners by number, anticlockwise as seen from outside.
    """

    expected_mm: FloatArray
    shown_mm: FloatArray
    degree: int
    hull: I64


@dataclass(frozen=True, slots=True)
class MapFigures:
    """How a cell's map of its robot's error does. degree : 0 where there is none.

    alone_mm, held_out_mm : rms of points that were left out, by the registration alone and with the map.
    noise_mm : one sigma of what no smooth map tells. least_mm, most_mm : of the places, robot's frame.
    """

    degree: int = 0
    points: int = 0
    alone_mm: float = 0.0
    held_out_mm: float = 0.0
    noise_mm: float = 0.0
    least_mm: tuple[float, ...] = ()
    most_mm: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RobotShift:
    """By how much what is published differs from the registration alone, robot's frame.

    shift_mm (3,). row (M,), mm : what the map's own noise moves it by, along each axis alike; with another
    shift by the same map it has the product of both rows in common. noise_mm : one sigma of what no
    smooth map tells.
    """

    shift_mm: FloatArray
    row: FloatArray
    noise_mm: float

    @property
    def variance_mm2(self) -> float:
        """Variance of each coordinate."""
        return float(self.row @ self.row) + self.noise_mm**2

    def moved(self, pose: FloatArray) -> FloatArray:
        """The pose (4, 4) of the robot's frame, shifted."""
        result = np.array(pose)
        result[:3, 3] += self.shift_mm
        return result
