"""The rig in the robot's frame from touched points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain import FloatArray
from edged.errors import CalibrationError
from edged.vision.geometry.rigid import (
    apply,
    fit_rigid,
    skew,
)

TWIN_SHARE = 0.005
"""Points nearer to each other than this share of the whole spread say the same thing twice."""


FLAT_SHARE = 0.01
"""Less extent across the longest direction than this share: points on one line."""


MIRROR_GAIN = 20.0
"""A mirror image that fits so many times better is no accident."""


@dataclass(frozen=True, slots=True, eq=False)
class PointRegistration:
    """robot_from_rig from points that the robot touched.

    covariance (6, 6) : of a small motion (shift mm, rotation rad) about the robot's origin that follows it,
    from the residuals.
    residuals_mm, left_out_mm (N,) : distance of each point from the fit of all, and of all others.
    scale : best scale of the robot's over the rig's lengths; it should be 1. sigma_scale : of it.
    """

    robot_from_rig: FloatArray
    covariance: FloatArray
    residuals_mm: FloatArray
    left_out_mm: FloatArray
    scale: float
    sigma_scale: float

    @property
    def rms_mm(self) -> float:
        """Of the residuals."""
        return float(np.sqrt(np.mean(self.residuals_mm**2)))


def register_points(rig_mm: FloatArray, robot_mm: FloatArray) -> PointRegistration:
    """Fit robot = T rig over corresponding points (N, 3), N >= 3.

    Raises `CalibrationError` for too few, repeated or collinear points, for points in other units and for
    mirrored ones: with the reason.
    """
    rig, robot = np.asarray(rig_mm, np.float64), np.asarray(robot_mm, np.float64)
    if rig.ndim != 2 or rig.shape[1:] != (3,) or rig.shape != robot.shape or len(rig) < 3:
        raise CalibrationError(
            f"registration needs three or more points (N, 3) in both frames, got {rig.shape}, {robot.shape}"
        )
    if not (np.isfinite(rig).all() and np.isfinite(robot).all()):
        raise CalibrationError("registration needs finite coordinates")
    for name, points in (("rig", rig), ("robot", robot)):
        _check_spread(name, points)
    similar = fit_rigid(rig, robot, with_scale=True)
    _check_units(similar.scale)
    _check_hand(rig, robot)
    fit = fit_rigid(rig, robot)
    left_out = np.full(len(rig), np.nan)
    if len(rig) > 3:
        for k in range(len(rig)):
            others = np.arange(len(rig)) != k
            try:
                without = fit_rigid(rig[others], robot[others]).to_from_source
            except CalibrationError:  # the others lie on one line
                continue
            left_out[k] = float(np.linalg.norm(robot[k] - apply(without, rig[k])))
    extent = float(np.sqrt(np.sum((rig - rig.mean(axis=0)) ** 2)))
    # a fit states the shift of the rig's origin; as a motion of the whole frame it is that of the robot's
    frame = np.eye(6)
    frame[:3, 3:] = skew(fit.to_from_source[:3, 3])
    return PointRegistration(
        fit.to_from_source,
        frame @ fit.covariance @ frame.T,
        np.linalg.norm(fit.residuals_mm, axis=1),
        left_out,
        similar.scale,
        similar.sigma_mm / extent,
    )


def _check_spread(name: str, points: FloatArray) -> None:
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    twins = np.argwhere(np.triu(apart < TWIN_SHARE * apart.max(), 1))
    if len(twins):
        one, two = twins[0] + 1
        raise CalibrationError(f"points {one} and {two} are nearly the same place in the {name}'s frame")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < FLAT_SHARE * spread[0]:
        raise CalibrationError(
            f"the points lie on one line in the {name}'s frame: the rotation about it stays open; "
            "touch a point beside it"
        )


def _check_units(scale: float) -> None:
    units = {1000.0: "µm", 0.001: "m", 0.1: "cm", 1 / 25.4: "inches"}
    for factor, unit in units.items():
        if abs(scale / factor - 1) < 0.05:
            raise CalibrationError(
                f"the robot's lengths are {scale:.4g} times the rig's: they look like {unit}, expected mm"
            )


def _check_hand(rig: FloatArray, robot: FloatArray) -> None:
    """A left-handed frame fits its mirror image; flat sets of points look the same in a mirror."""
    if np.linalg.svd(rig - rig.mean(axis=0), compute_uv=False)[2] < 1e-3 * np.ptp(rig):
        return
    straight = fit_rigid(rig, robot).residuals_mm
    mirrored = fit_rigid(rig * [1.0, 1.0, -1.0], robot).residuals_mm
    if np.sqrt(np.mean(mirrored**2)) * MIRROR_GAIN < np.sqrt(np.mean(straight**2)):
        raise CalibrationError(
            "the robot's points are the rig's in a mirror: one axis has the wrong sign, or two are swapped"
        )
