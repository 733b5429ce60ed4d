"""Map of a robot's error: its own position readings compared with where the cameras see its tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import I64, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RobotMap:
    """Data that the map is computed from; see `edged.robot.errormap`.

    expected_mm (N, 3) : touched places by the registration, robot's frame. shown_mm (N, 3) : what the robot
    showed with its tip there. degree : of the polynomial, from 1. hull (F, 3) : triangles of the convex hull
    of all places, as indices, anticlockwise seen from outside.
    """

    expected_mm: FloatArray
    shown_mm: FloatArray
    degree: int
    hull: I64


@dataclass(frozen=True, slots=True)
class MapFigures:
    """Quality of a cell's robot error map. degree : 0 if there is none.

    alone_mm, held_out_mm : rms error of held-out points, by the registration alone and with the map.
    noise_mm : one sigma of the error that no smooth map describes. least_mm, most_mm : bounds of the touched
    places, robot's frame.
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
    """Shift of a published position relative to the registration alone, robot's frame.

    shift_mm (3,). row (M,), mm : its sensitivity to the map's own noise, the same along each axis; its
    covariance with another shift by the same map is the product of both rows. noise_mm : one sigma of the
    error that no smooth map describes.
    """

    shift_mm: FloatArray
    row: FloatArray
    noise_mm: float

    @property
    def variance_mm2(self) -> float:
        """Variance of each coordinate."""
        return float(self.row @ self.row) + self.noise_mm**2

    def moved(self, pose: FloatArray) -> FloatArray:
        """Return a pose (4, 4) in the robot's frame, shifted."""
        result = np.array(pose)
        result[:3, 3] += self.shift_mm
        return result
