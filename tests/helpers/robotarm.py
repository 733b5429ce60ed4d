"""The arm of a virtual robot, for the interpreters of robot languages: it goes to commanded poses at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import invert


class RobotArm:
    """flange : robot_from_flange now. flange_from_tip : of the active tool. places : where it stopped.

    moved : called with each new flange pose.
    """

    def __init__(
        self, flange: FloatArray, flange_from_tip: FloatArray, moved: Callable[[FloatArray], None]
    ) -> None:
        self.flange, self.flange_from_tip, self._moved = flange, flange_from_tip, moved
        self.places: list[FloatArray] = []

    @property
    def tip(self) -> FloatArray:
        """robot_from_tip now."""
        return np.asarray(self.flange @ self.flange_from_tip)

    def move(self, robot_from_tip: FloatArray) -> None:
        """Move the tool's tip to a pose."""
        self.flange = np.asarray(robot_from_tip @ invert(self.flange_from_tip))
        self._moved(self.flange)

    def rests(self) -> None:
        """Note that it has arrived and stands still."""
        if not self.places or self.places[-1] is not self.flange:
            self.places.append(self.flange)
