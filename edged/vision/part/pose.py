"""In-plane pose of a part in its measured face: taught features fitted to the measured ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.curves.outlines import Curve
from edged.vision.curves.planefit import PlaneFit
from edged.vision.geometry.rigid import rotation_2d, wrapped
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, SlotFeature
from edged.vision.part.params import MEASURING


class Observation(NamedTuple):
    """One curve: measured minus taught, its derivative by (shift, turn, growth), its inverse covariance.

    by_fit (M, P) : derivative by the parameters of the fit.  taught (M, M) : covariance of the taught place.
    """

    gap: FloatArray
    rows: FloatArray
    inverse: FloatArray
    by_fit: FloatArray
    taught: FloatArray


class _Solved(NamedTuple):
    """The unknowns by robust least squares, and their covariance if all curves erred independently.

    by_fit (U, P) : derivative by the parameters of the fit.
    taught (U, U) : covariance from the taught places.
    excess : variance of the curves over what is expected of them, a factor of at least 1.
    """

    values: FloatArray
    covariance: FloatArray
    by_fit: FloatArray
    taught: FloatArray
    excess: float


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
class InPlaneMotion:
    """Motion of the part within the fitted face, relative to the face's axes.

    shift (2,) mm, turn in rad; covariance (3, 3) of (shift, turn), edge_covariance the share of it that comes
    from the edges, not from the calibration.
    """

    shift: FloatArray
    turn: float
    covariance: FloatArray
    edge_covariance: FloatArray

    def apply(self, point: FloatArray) -> FloatArray:
        """Place (2,) of a taught point after the motion."""
        return np.asarray(rotation_2d(self.turn) @ point + self.shift)


def find_motion(job: Job, fit: PlaneFit) -> InPlaneMotion | None:
    """The motion in the face that brings the taught features onto the measured ones; robust.

    A feature that lies elsewhere (another edge beside it, a worn corner) loses all of its weight.
    An error of the rig turns all features alike: the covariance contains this common error.
    None when the features leave the rotation undetermined.
    """
    solved = _solved(_observations(job, fit), 3)
    if solved is None:
        return None
    by_edges = solved.excess * (solved.by_fit @ fit.edge_covariance @ solved.by_fit.T + solved.taught)
    by_rig = solved.by_fit @ (fit.covariance - fit.edge_covariance) @ solved.by_fit.T
    return InPlaneMotion(solved.values[:2], float(solved.values[2]), by_edges + by_rig, by_edges)


def scale_of_features(job: Job, fit: PlaneFit) -> tuple[float, float]:
    """Relative growth of the features' distances since teaching, and its sigma; NaN if undetermined."""
    observations = _observations(job, fit)
    if sum(len(observation.gap) for observation in observations) < 4 + MEASURING.min_spare:
        return math.nan, math.nan
    solved = _solved(observations, 4)
    if solved is None:
        return math.nan, math.nan
    return float(solved.values[3]), math.sqrt(max(float(solved.covariance[3, 3]), 0.0))


def form_mm(job: Job, fit: PlaneFit, motion: InPlaneMotion) -> float:
    """Largest deviation of an edge's or slot's middle from its taught place, or of half a slot's size."""
    unknowns = np.append(motion.shift, motion.turn)
    far = [
        float(np.linalg.norm((observation.gap - observation.rows[:, :3] @ unknowns)[:-1]))
        for observation in _observations(job, fit)
    ]
    seen = {found.curve.name: found.curve for found in fit.fits}
    for slot in job.slots:
        if slot.name in seen:
            wrong = seen[slot.name].parameters[3:] - (slot.length_mm, slot.width_mm)
            far.append(0.5 * float(np.abs(wrong).max()))
    return max(far)


def _solved(observations: list[Observation], unknowns: int) -> _Solved | None:
    """Solve for 3 unknowns (shift and turn) or 4 (also growth); None if they are undetermined."""
    motion, weights, far = np.zeros(unknowns), np.ones(len(observations)), np.zeros(len(observations))
    normal = np.zeros((unknowns, unknowns))
    for _ in range(MEASURING.pose_rounds):
        normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        for observation, weight in zip(observations, weights, strict=True):
            design = observation.rows[:, :unknowns]
            normal += weight * design.T @ observation.inverse @ design
            right += weight * design.T @ observation.inverse @ observation.gap
        scale = np.sqrt(np.diag(normal))
        if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > 1e10:
            return None
        motion = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        misfits = [observation.gap - observation.rows[:, :unknowns] @ motion for observation in observations]
        far = np.array(
            [
                math.sqrt(r @ observation.inverse @ r / len(r))
                for r, observation in zip(misfits, observations, strict=True)
            ]
        )
        weights = tukey_weights(far, max(mad_sigma(far), 1.0))
    sizes = [len(observation.gap) for observation in observations]
    freedom = sum(sizes) - unknowns
    chi2 = float(np.sum(weights * far**2 * sizes)) / max(freedom, 1)
    inverse = np.linalg.inv(normal)
    by_fit, taught, excess = [], np.zeros((unknowns, unknowns)), max(chi2, 1.0)
    for observation, weight in zip(observations, weights, strict=True):
        gain = weight * inverse @ observation.rows[:, :unknowns].T @ observation.inverse
        by_fit.append(gain @ observation.by_fit)
        taught += gain @ observation.taught @ gain.T
    return _Solved(motion, np.asarray(inverse * excess), np.sum(by_fit, axis=0), taught, excess)


def _observations(job: Job, fit: PlaneFit) -> list[Observation]:
    """One for each curve that was both taught and measured."""
    taught = {circle.name: np.append(circle.centre_mm[:2], 0.0) for circle in job.circles}
    taught |= {slot.name: np.append(slot.centre_mm[:2], slot.angle_rad) for slot in job.slots}
    taught |= {edge.name: edge_curve(edge, True).parameters for edge in job.edges}
    observations: list[Observation] = []
    for found in fit.fits:
        curve = found.curve
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
        size = sizes[curve.kind]
        by_fit = np.zeros((3, len(fit.covariance)))
        by_fit[:size, where] = np.eye(size, where.stop - where.start)
        by_fit = project @ by_fit
        spread = (
            np.diag([MEASURING.taught_sigma_mm, MEASURING.taught_sigma_mm, MEASURING.taught_sigma_mm / lever])
            ** 2
        )
        taught_spread = project @ spread @ project.T
        inverse = np.asarray(
            np.linalg.inv(by_fit @ fit.covariance @ by_fit.T + taught_spread), dtype=np.float64
        )
        observations.append(Observation(project @ gap, project @ rows, inverse, by_fit, taught_spread))
    return observations
