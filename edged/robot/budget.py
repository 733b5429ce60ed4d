"""Uncertainty budget of a pose: terms that add up to the published variance, to the last bit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Target
from edged.robot.covariance import robot_covariance, rotate_covariance


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """Variances (6,), each at least 0, in the frame in which the pose is published.

    X, Y, Z in mm², then the rotation about these axes in rad².

    edges : noise, blur and shape of the measured edges. calibration : parameters of the rig.
    registration : of the rig in the robot's frame, the map of the robot's error, and the position of a belt.
    doubt : contradictions between the measurement and the rig (`Target.doubt_mm`).
    marks : correction by reference marks; None without one.
    Their exact sum, rounded once (`math.fsum`), is the published variance, bit by bit.
    """

    edges: FloatArray
    calibration: FloatArray
    registration: FloatArray
    doubt: FloatArray
    marks: FloatArray | None = None

    @property
    def terms(self) -> tuple[FloatArray, ...]:
        """Edges, calibration, registration, doubt; with reference marks a fifth."""
        terms = self.edges, self.calibration, self.registration, self.doubt
        return terms if self.marks is None else (*terms, self.marks)


def budget_of(
    target: Target, robot_from_rig: FloatArray | None, registration: FloatArray | None
) -> Budget | None:
    """Budget of a pose as published; None if the edges' share is not known, or a term is not finite."""
    if target.by_edges is None:
        return None
    own = whole = target.covariance
    by_edges, by_doubt = target.by_edges, target.by_doubt
    by_marks = np.zeros((6, 6)) if target.by_marks is None else target.by_marks
    if robot_from_rig is not None:
        own = rotate_covariance(target.covariance, robot_from_rig)
        whole = robot_covariance(target, robot_from_rig, registration)
        by_edges, by_doubt, by_marks = (
            rotate_covariance(part, robot_from_rig) for part in (by_edges, by_doubt, by_marks)
        )
    edges, doubt, total, marks = np.diag(by_edges), np.diag(by_doubt), np.diag(whole), np.diag(by_marks)
    rest = np.diag(own) - edges - doubt
    found = [edges, rest, total - np.diag(own), doubt]
    if target.by_marks is not None:
        found = [edges, rest - marks, total - np.diag(own), doubt, marks]
    terms = np.stack(found)  # differences are as exact as their sums: a negative value is rounding
    if not (np.isfinite(terms).all() and np.isfinite(total).all()):
        return None
    terms = np.maximum(terms, 0.0)
    for axis in range(6):
        _settle(terms[:, axis], float(total[axis]))
    return Budget(*terms)


def _settle(terms: FloatArray, total: float) -> None:
    """Correct rounding errors in place, so that the terms add up to total: in the largest term.

    The remaining difference is at most half a unit in the total's last place; where it is exactly that, and
    the tie is broken the wrong way, a smaller term is moved by its own last place.
    """
    first, *others = np.argsort(-terms)
    terms[first] += math.fsum([total, *-terms])
    found = terms.copy()
    for index in (first, *others):
        for side in (0.0, np.inf, -np.inf):
            terms[:] = found
            if side:
                terms[index] = max(np.nextafter(found[index], side), 0.0)
            if math.fsum(terms) == total:
                return
