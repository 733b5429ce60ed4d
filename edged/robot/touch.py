"""Registration of the rig in the robot's frame from touched points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError, Undetermined
from edged.vision.geometry.rigid import RigidFit, apply, fit_rigid, skew

TWIN_SHARE = 0.005
"""Points nearer to each other than this share of the largest distance count as repeated."""


FLAT_SHARE = 0.01
"""Points whose extent across the longest direction is below this share of it count as lying on one line."""


MIRROR_GAIN = 20.0
"""Factor by which the mirror image must fit better, so that it is not by chance."""


STUDENT_LIMITS = ((3, 11.9), (6, 4.87), (9, 3.73), (12, 3.29), (18, 2.91), (30, 2.66))
"""Degrees of freedom of the fit to the other points, and the square root of the 0.999 quantile of F(3, them):
a studentised error beyond it is significant (R. Cook and S. Weisberg, "Residuals and Influence in
Regression", 1982, 2.2)."""
STANDS_OUT = 2.0
"""Least ratio to the next largest studentised error; below it nothing tells which of two is wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class PointRegistration:
    """robot_from_rig from points that the robot touched.

    covariance (6, 6) : of a small motion (shift mm, rotation rad) about the robot's origin, applied after
    robot_from_rig; from the residuals.
    residuals_mm, held_out_mm (N,) : distance of each point from the fit of all, and of all others.
    others_rms_mm (N,) : rms of the fit without each point.
    studentised (N,) : held-out errors in units of those expected from the fit of the others.
    culprit : index of the only point that is significantly wrong; None without one, or when ambiguous.
    These are NaN, or None, where the other points do not determine a fit, as with three points.
    lengths_mm : largest difference between the distances of two points in both frames.
    scale : best ratio of the robot's to the rig's lengths; it should be 1. sigma_scale : its sigma.
    """

    robot_from_rig: FloatArray
    covariance: FloatArray
    residuals_mm: FloatArray
    held_out_mm: FloatArray
    others_rms_mm: FloatArray
    studentised: FloatArray
    culprit: int | None
    lengths_mm: float
    scale: float
    sigma_scale: float

    @property
    def rms_mm(self) -> float:
        """Rms of the residuals."""
        return float(np.sqrt(np.mean(self.residuals_mm**2)))


def register_points(rig_mm: FloatArray, robot_mm: FloatArray) -> PointRegistration:
    """Fit robot = T rig over corresponding points (N, 3), N >= 3.

    Raises `CalibrationError`, with the reason, for too few, repeated or collinear points, for points in other
    units and for mirrored ones.
    """
    rig, robot = np.asarray(rig_mm, np.float64), np.asarray(robot_mm, np.float64)
    if rig.ndim != 2 or rig.shape[1:] != (3,) or rig.shape != robot.shape or len(rig) < 3:
        raise CalibrationError(
            f"registration needs three or more points in both frames, got {len(rig)} and {len(robot)}"
        )
    if not (np.isfinite(rig).all() and np.isfinite(robot).all()):
        raise CalibrationError("registration needs finite coordinates")
    for name, points in (("rig", rig), ("robot", robot)):
        _check_spread(name, points)
    similar = fit_rigid(rig, robot, with_scale=True)
    _check_units(similar.scale)
    _check_hand(rig, robot)
    fit = fit_rigid(rig, robot)
    held_out, others_rms, studentised = _held_out(rig, robot)
    freedom = 3 * len(rig) - 6
    extent = float(np.sqrt(np.sum((rig - rig.mean(axis=0)) ** 2)))
    # the fit gives the shift of the rig's origin; convert it to a motion about the robot's origin
    frame = np.eye(6)
    frame[:3, 3:] = skew(fit.to_from_source[:3, 3])
    # the variance is estimated from few residuals: errors follow Student's t, which is wider by this factor
    covariance = fit.covariance * (freedom / (freedom - 2))
    return PointRegistration(
        fit.to_from_source,
        frame @ covariance @ frame.T,
        np.linalg.norm(fit.residuals_mm, axis=1),
        held_out,
        others_rms,
        studentised,
        _culprit(studentised),
        float(np.abs(_distances(rig) - _distances(robot)).max()),
        similar.scale,
        similar.sigma_mm / extent,
    )


def _held_out(rig: FloatArray, robot: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Error (N,) of each point by the fit of the others, rms of that fit, and the studentised error.

    A point far from the others has a large error by their fit even when it is right and one of them is
    wrong: errors of different points can only be compared in units of the expected error.
    """
    held_out, rms, studentised = (np.full(len(rig), np.nan) for _ in range(3))
    if len(rig) < 4:
        return held_out, rms, studentised
    for k in range(len(rig)):
        others = np.arange(len(rig)) != k
        try:
            fit: RigidFit = fit_rigid(rig[others], robot[others])
        except CalibrationError:  # the others lie on one line
            continue
        error = robot[k] - apply(fit.to_from_source, rig[k])
        arm = np.concatenate([np.eye(3), -skew(fit.to_from_source[:3, :3] @ rig[k])], axis=1)
        # exact points leave no residual; a nanometre keeps the matrix invertible
        expected = arm @ fit.covariance @ arm.T + (fit.sigma_mm**2 + 1e-12) * np.eye(3)
        held_out[k] = float(np.linalg.norm(error))
        rms[k] = float(np.sqrt(np.mean(np.sum(fit.residuals_mm**2, axis=1))))
        studentised[k] = float(np.sqrt(error @ np.linalg.solve(expected, error) / 3))
    return held_out, rms, studentised


def _culprit(studentised: FloatArray) -> int | None:
    """Index of the only point that is significantly wrong; None without one, or when ambiguous."""
    known = np.flatnonzero(np.isfinite(studentised))
    if len(known) < 2:
        return None
    order = known[np.argsort(-studentised[known])]
    freedom = 3 * (len(studentised) - 1) - 6
    limit = next(value for least, value in reversed(STUDENT_LIMITS) if freedom >= least)
    first, second = studentised[order[:2]]
    return int(order[0]) if first > limit and first > STANDS_OUT * second else None


def _distances(points: FloatArray) -> FloatArray:
    """Distances (N, N) between all points."""
    return np.asarray(np.linalg.norm(points[:, None] - points, axis=2))


def _check_spread(name: str, points: FloatArray) -> None:
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    twins = np.argwhere(np.triu(apart < TWIN_SHARE * apart.max(), 1))
    if len(twins):
        first, second = twins[0] + 1
        raise Undetermined(
            f"points {first} and {second} are nearly the same place in the {name}'s frame", "same_place"
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < FLAT_SHARE * spread[0]:
        raise Undetermined(
            f"the points lie on one line in the {name}'s frame: the rotation about it stays open; "
            "touch a point beside it",
            "on_one_line",
        )


def _check_units(scale: float) -> None:
    units = {1000.0: "µm", 0.001: "m", 0.1: "cm", 1 / 25.4: "inches"}
    for factor, unit in units.items():
        if abs(scale / factor - 1) < 0.05:
            raise CalibrationError(
                f"the robot's lengths are {scale:.4g} times the rig's: they look like {unit}, expected mm",
                "other_units",
            )


def _check_hand(rig: FloatArray, robot: FloatArray) -> None:
    """Raise `CalibrationError` if the mirrored points fit far better; flat sets look the same mirrored."""
    if np.linalg.svd(rig - rig.mean(axis=0), compute_uv=False)[2] < 1e-3 * np.ptp(rig):
        return
    straight = fit_rigid(rig, robot).residuals_mm
    mirrored = fit_rigid(rig * [1.0, 1.0, -1.0], robot).residuals_mm
    if np.sqrt(np.mean(mirrored**2)) * MIRROR_GAIN < np.sqrt(np.mean(straight**2)):
        raise CalibrationError(
            "the robot's points are a mirror image of the rig's: one axis has the wrong sign, "
            "or two are swapped",
            "mirrored",
        )
