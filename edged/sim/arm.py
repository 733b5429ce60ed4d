"""A robot arm that deviates from its controller's model: offsets, lengths, droop and backlash of its axes.

Three axes carry the wrist: the first turns about the vertical, the other two in the vertical plane through
the arm. The true position of the wrist for a position shown by the controller is computed from that chain,
not from any polynomial.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import rotation_matrix, transform

BASE_MM, UPPER_MM, FORE_MM = 400.0, 450.0, 480.0
"""Link lengths of a robot with a reach of 0.9 m."""
ROUNDS = 8
"""Fixed-point iterations; the error changes by a thousandth of each step, so that three would do."""


@dataclass(frozen=True, slots=True, eq=False)
class ErringArm:
    """Errors of the axes. offsets_rad (3,): constant; gears_rad (3,): twice per turn; droop_rad (3,): by
    gravity at full reach; backlash_rad (3,): half of the play. lengths_mm (3,): of the links. lean_rad (2,):
    of the first axis."""

    offsets_rad: FloatArray
    gears_rad: FloatArray
    droop_rad: FloatArray
    backlash_rad: FloatArray
    lengths_mm: FloatArray
    lean_rad: FloatArray

    @classmethod
    def drawn(cls, seed: int, size: float = 1.0, backlash_mm: float = 0.0) -> ErringArm:
        """Draw a random robot as delivered: with size 1 it is off by about 0.5 mm at half a metre.

        backlash_mm : half of the play of each axis, at half a metre from the axis.
        """
        rng = np.random.default_rng((seed, 77))

        def some(scale: float, count: int = 3) -> FloatArray:
            return np.asarray(size * scale * rng.standard_normal(count))

        play = np.full(3, backlash_mm / 500.0)
        return cls(some(5e-4), some(1.5e-4), np.abs(some(3e-4)), play, some(0.2), some(2e-4, 2))

    def reached(self, shown_mm: FloatArray, before_mm: FloatArray) -> FloatArray:
        """True position (3,) of the wrist when the controller shows a position reached from another one."""
        turn, shoulder, elbow = self._true_axes(shown_mm, before_mm)
        base, upper, fore = np.array([BASE_MM, UPPER_MM, FORE_MM]) + self.lengths_mm
        out = upper * math.cos(shoulder) + fore * math.cos(shoulder + elbow)
        up = base + upper * math.sin(shoulder) + fore * math.sin(shoulder + elbow)
        x, y = out * math.cos(turn), out * math.sin(turn)
        lean_x, lean_y = self.lean_rad
        return np.array([x + lean_y * up, y - lean_x * up, up + lean_x * y - lean_y * x])

    def flange(self, shown: FloatArray, before: FloatArray) -> FloatArray:
        """True robot_from_flange (4, 4) when the controller shows `shown`, reached from `before`.

        The flange is at the wrist, whose own axes have no error: its rotation error is that of the arm.
        """
        place_mm, before_mm = shown[:3, 3], before[:3, 3]
        lean = rotation_matrix(np.array([*self.lean_rad, 0.0]))
        true, believed = _fore_arm(self._true_axes(place_mm, before_mm)), _fore_arm(_axes(place_mm))
        return transform(lean @ true @ believed.T @ shown[:3, :3], self.reached(place_mm, before_mm))

    def _true_axes(self, shown_mm: FloatArray, before_mm: FloatArray) -> FloatArray:
        axes, before = _axes(shown_mm), _axes(before_mm)
        out_mm = math.hypot(float(shown_mm[0]), float(shown_mm[1]))
        pull = np.array([0.0, out_mm, math.cos(axes[1] + axes[2]) * FORE_MM]) / (UPPER_MM + FORE_MM)
        true = axes + self.offsets_rad + self.gears_rad * np.sin(2.0 * axes) - self.droop_rad * pull
        return np.asarray(true + self.backlash_rad * np.sign(before - axes))

    def shown(self, place_mm: FloatArray, before_mm: FloatArray) -> FloatArray:
        """Position (3,) that the controller shows when the wrist is truly at a position."""
        found = np.array(place_mm, np.float64)
        for _ in range(ROUNDS):
            found = found + place_mm - self.reached(found, before_mm)
        return found


def _fore_arm(axes: FloatArray) -> FloatArray:
    """Rotation (3, 3) of the link that carries the wrist."""
    turn, shoulder, elbow = axes
    return np.asarray(
        rotation_matrix(np.array([0.0, 0.0, turn])) @ rotation_matrix(np.array([0.0, -shoulder - elbow, 0.0]))
    )


def _axes(place_mm: FloatArray) -> FloatArray:
    """Inverse kinematics of the controller: turn, shoulder and elbow (3,) in rad for a position."""
    x, y, z = (float(value) for value in place_mm)
    out, up = math.hypot(x, y), z - BASE_MM
    far2 = out * out + up * up
    bend = (far2 - UPPER_MM**2 - FORE_MM**2) / (2.0 * UPPER_MM * FORE_MM)
    elbow = -math.acos(min(max(bend, -1.0), 1.0))
    shoulder = math.atan2(up, out) - math.atan2(
        FORE_MM * math.sin(elbow), UPPER_MM + FORE_MM * math.cos(elbow)
    )
    return np.array([math.atan2(y, x), shoulder, elbow])
