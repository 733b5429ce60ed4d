"""What a robot may pick of what was found, and in which order: pure functions of an outcome."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from edged.domain import FloatArray, Order, Outcome, Picking, Reject, Target


def picked(outcome: Outcome, picking: Picking, robot_from_rig: FloatArray | None) -> Outcome:
    """The outcome with its good parts first, in the order that the job asks for.

    robot_from_rig (4, 4) : None where the rig is not registered. Parts that are equal stay as they were: by
    their score.
    """
    key = _KEYS[picking.order]

    def place(target: Target) -> tuple[bool, float]:
        value = key(target, robot_from_rig)
        return target.reject != Reject.NONE, value if math.isfinite(value) else math.inf

    targets = sorted(outcome.targets, key=place)
    return replace(outcome, targets=tuple(targets))


def _agreement(target: Target, _robot: FloatArray | None) -> float:
    return -target.match.score


def _distance_mm(target: Target, _robot: FloatArray | None) -> float:
    return float(np.linalg.norm(target.position_mm))


def _depth_mm(target: Target, robot_from_rig: FloatArray | None) -> float:
    """Below the robot's origin; without a robot along the camera's axis."""
    if robot_from_rig is None:
        return float(target.position_mm[2])
    return -float(robot_from_rig[2, :3] @ target.position_mm)


def _left_px(target: Target, _robot: FloatArray | None) -> float:
    return target.match.x_px


def _variance_mm2(target: Target, _robot: FloatArray | None) -> float:
    return float(np.trace(target.covariance[:3, :3]))


_KEYS: dict[Order, Callable[[Target, FloatArray | None], float]] = {
    Order.SCORE: _agreement,
    Order.NEAREST: _distance_mm,
    Order.TOPMOST: _depth_mm,
    Order.LEFTMOST: _left_px,
    Order.LEAST_SIGMA: _variance_mm2,
}
"""The least comes first."""
