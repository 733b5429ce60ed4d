"""How a part lies in its measured face: taught features laid onto the measured ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.curves.outlines import Curve
from edged.vision.curves.planefit import PlaneFit
from edged.vision.geometry.rigid import rotation_2d, wrapped
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, SlotFeature

TAUGHT_SIGMA_MM = 0.003
"""What a feature's taught place is worth: the precision of one measurement of a machined edge."""
ROUNDS = 8
MIN_SPARE = 2
"""More observations than unknowns, before a growth is told from a feature that lies elsewhere."""

Observation = tuple[FloatArray, FloatArray, FloatArray]
"""Of one curve: measured minus taught, its derivative by (shift, turn, growth), its inverse covariance."""


def circle_curve(circle: CircleFeature, free_polarity: bool) -> Curve:
    """A taught circle as a curve of the part's face."""
    x, y, height = (float(value) for value in circle.centre_mm)
    parameters = np.array([x, y, circle.radius_mm])
    return Curve(circle.name, "circle", parameters, 0 if free_polarity else circle.polarity, height_mm=height)


def edge_curve(edge: EdgeFeature, free_polarity: bool, sign: int = 1) -> Curve:
    """A taught edge as a curve of the part's face."""
    middle = 0.5 * (edge.start_mm + edge.end_mm)
    parameters = np.array([middle[0], middle[1], edge.angle_rad])
    polarity = 0 if free_polarity else sign * edge.polarity
    return Curve(edge.name, "edge", parameters, polarity, edge.length_mm, float(middle[2]))


def slot_curve(slot: SlotFeature, free_polarity: bool, sign: int = 1) -> Curve:
    """A taught slot as a curve of the part's face."""
    x, y, height = slot.centre_mm
    parameters = np.array([x, y, slot.angle_rad, slot.length_mm, slot.width_mm])
    return Curve(slot.name, "slot", parameters, 0 if free_polarity else sign * slot.polarity, 0.0, height)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How the part lies in the fitted face against where the face's axes put it.

    shift (2,) mm, turn in rad; covariance (3, 3) of (shift, turn).
    """

    shift: FloatArray
    turn: float
    covariance: FloatArray

    def apply(self, point: FloatArray) -> FloatArray:
        """(2,) where a taught point lies."""
        return np.asarray(rotation_2d(self.turn) @ point + self.shift)


def find_motion(job: Job, fit: PlaneFit) -> Motion | None:
    """The motion in the face that lays the taught features onto the measured ones; robust.

    A feature that lies elsewhere (another edge beside it, a worn corner) loses its weight as a whole.
    None when the features leave the rotation open.
    """
    solved = _solved(_observations(job, fit), 3)
    if solved is None:
        return None
    motion, covariance = solved
    return Motion(motion[:2], float(motion[2]), covariance)


def scale_of_features(job: Job, fit: PlaneFit) -> tuple[float, float]:
    """By which share the features lie farther apart than taught, and its sigma; NaN: they do not tell."""
    observations = _observations(job, fit)
    if sum(len(gap) for gap, _, _ in observations) < 4 + MIN_SPARE:
        return math.nan, math.nan
    solved = _solved(observations, 4)
    if solved is None:
        return math.nan, math.nan
    motion, covariance = solved
    return float(motion[3]), math.sqrt(max(float(covariance[3, 3]), 0.0))


def form_mm(job: Job, fit: PlaneFit, motion: Motion) -> float:
    """Farthest that an edge or slot lies from its taught outline, laid there by the motion; at its middle."""
    unknowns = np.append(motion.shift, motion.turn)
    far = [
        float(np.linalg.norm((gap - design[:, :3] @ unknowns)[:-1]))
        for gap, design, _ in _observations(job, fit)
    ]
    seen = {one.curve.name: one.curve for one in fit.fits}
    for slot in job.slots:
        if slot.name in seen:
            wrong = seen[slot.name].parameters[3:] - (slot.length_mm, slot.width_mm)
            far.append(0.5 * float(np.abs(wrong).max()))
    return max(far)


def _solved(observations: list[Observation], unknowns: int) -> tuple[FloatArray, FloatArray] | None:
    """The first unknowns (3: shift and turn; 4: and growth) by robust least squares, and their covariance."""
    motion, weights, far = np.zeros(unknowns), np.ones(len(observations)), np.zeros(len(observations))
    normal = np.zeros((unknowns, unknowns))
    for _ in range(ROUNDS):
        normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        for (gap, full, inverse), weight in zip(observations, weights, strict=True):
            design = full[:, :unknowns]
            normal += weight * design.T @ inverse @ design
            right += weight * design.T @ inverse @ gap
        scale = np.sqrt(np.diag(normal))
        if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > 1e10:
            return None
        motion = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        misfits = [gap - full[:, :unknowns] @ motion for gap, full, _ in observations]
        far = np.array(
            [
                math.sqrt(r @ inverse @ r / len(r))
                for r, (_, _, inverse) in zip(misfits, observations, strict=True)
            ]
        )
        weights = tukey_weights(far, max(mad_sigma(far), 1.0))
    freedom = sum(len(gap) for gap, _, _ in observations) - unknowns
    chi2 = float(np.sum(weights * far**2 * [len(gap) for gap, _, _ in observations])) / max(freedom, 1)
    return motion, np.asarray(np.linalg.inv(normal) * max(chi2, 1.0))


def _observations(job: Job, fit: PlaneFit) -> list[Observation]:
    """One for each curve that was both taught and measured."""
    taught = {circle.name: np.append(circle.centre_mm[:2], 0.0) for circle in job.circles}
    taught |= {slot.name: np.append(slot.centre_mm[:2], slot.angle_rad) for slot in job.slots}
    taught |= {edge.name: edge_curve(edge, True).parameters for edge in job.edges}
    observations: list[Observation] = []
    for one in fit.fits:
        curve = one.curve
        where = fit.place(curve.name)
        if where is None or curve.name not in taught:
            continue
        x, y, angle = taught[curve.name]
        rows = np.array([[1.0, 0.0, -y, x], [0.0, 1.0, x, y], [0.0, 0.0, 1.0, 0.0]])
        sizes = {"circle": 2, "slot": 3, "edge": 3}
        project = np.eye(3)[: sizes[curve.kind]]
        lever = curve.perimeter_mm / math.sqrt(12)
        if curve.kind == "edge":
            project = np.array([[-math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        gap = curve.parameters[:3] - taught[curve.name]
        gap[2] = wrapped(gap[2], math.pi)
        spread = np.zeros((3, 3))
        known = fit.covariance[where, where][: sizes[curve.kind], : sizes[curve.kind]]
        spread[: len(known), : len(known)] = known
        spread += np.diag([TAUGHT_SIGMA_MM, TAUGHT_SIGMA_MM, TAUGHT_SIGMA_MM / lever]) ** 2
        inverse = np.asarray(np.linalg.inv(project @ spread @ project.T), dtype=np.float64)
        observations.append((project @ gap, project @ rows, inverse))
    return observations
