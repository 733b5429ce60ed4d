"""Hand-eye calibration: the rig's place relative to the robot, from robot poses with views of a board.

Transforms are rigid (4, 4), lengths mm, rotations rad. "Flange" is the frame whose pose the robot reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain.arrays import B8, FloatArray
from edged.errors import CalibrationError, Undetermined
from edged.vision.geometry.rigid import (
    apply,
    invert,
    nearest_rotation,
    rotation_matrix,
    rotation_vector,
    skew,
    transform,
)

Mount = Literal["eye-to-hand", "eye-in-hand"]

MIN_POSES = 4
MIN_TURN_RAD = np.radians(5.0)
MIN_AXES_SPREAD = 0.05
"""Least spread of the rotation axes: second singular value over the first; below it they are parallel."""
OUTLIER = 6.0
"""Outlier limit in units of the median residual: a mistyped pose, or a board that was moved."""
MIN_KEPT = 0.6
"""Least share of poses that agree; below it no outlier can be identified, and all poses are kept."""
REWEIGHTED = 12
LEAST_KEPT = 1e-3
"""Lower bound of the share of a pose's error left in its residuals: below it the pose alone decides."""


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """Rig and board in the robot's frames, from poses of the flange with views of the board.

    rig : robot_from_rig (eye-to-hand) or flange_from_rig (eye-in-hand).
    board : flange_from_board (eye-to-hand) or robot_from_board (eye-in-hand).
    covariance (6, 6) : of a small motion (shift mm, rotation rad) applied after `rig`, from the scatter
    of the poses.
    used (N,) bool : poses that were not rejected as outliers.
    held_out_mm, held_out_rad (N,) : error of each pose by a fit of the other used ones; NaN if these are too
    few, or if it was not asked for (`hold_out`).
    """

    mount: Mount
    rig: FloatArray
    board: FloatArray
    covariance: FloatArray
    used: B8
    rms_mm: float
    held_out_mm: FloatArray
    held_out_rad: FloatArray


def hand_eye(
    robot_from_flange: Sequence[FloatArray],
    rig_from_board: Sequence[FloatArray],
    board_mm: FloatArray,
    mount: Mount,
    *,
    hold_out: bool = True,
) -> HandEye:
    """Solve A Y = X B over poses: robot_from_flange flange_from_board = robot_from_rig rig_from_board.

    For eye-in-hand A is flange_from_robot, and X is flange_from_rig. board_mm (M, 3) : marks over which the
    residuals are taken, so that angles are weighted by what they move. hold_out : also fit without each pose
    in turn. Start: F. Park and B. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group",
    1994, doi:10.1109/70.326576; then least squares over both unknowns at once, without outliers.
    Raises `CalibrationError` for too few poses and for motions that do not determine the result.
    """
    A = np.array(robot_from_flange, np.float64)
    B = np.array(rig_from_board, np.float64)
    if A.shape != B.shape or A.shape[1:] != (4, 4) or len(A) < MIN_POSES:
        raise CalibrationError(
            f"hand-eye needs {MIN_POSES} or more poses, each with a view; got {len(A)} and {len(B)}"
        )
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise CalibrationError("hand-eye needs finite poses")
    if mount == "eye-in-hand":
        A = np.array([invert(pose) for pose in A])
    _check_motion(A)
    span = board_mm - board_mm.mean(axis=0)
    marks = board_mm.mean(axis=0) + span[_hull(span)]
    X, Y = _start(A, B)
    X, Y, used = _without_outliers(A, B, X, Y, marks)
    covariance = _covariance(A[used], B[used], X, Y, marks)
    nothing = np.full(len(A), np.nan)
    held_mm, held_rad = _held_out(A, B, X, Y, marks, used) if hold_out else (nothing, nothing)
    rms = float(np.sqrt(np.mean(_errors_mm(A[used], B[used], X, Y, marks) ** 2)))
    return HandEye(mount, X, Y, covariance, used, rms, held_mm, held_rad)


@dataclass(frozen=True, slots=True, eq=False)
class FlangeTurns:
    """Rotations of the flange since the first pose. largest_rad : largest angle. spread : of the axes, second
    singular value over the first; 0: a single axis. axis (3,) : main axis, unit, in the first pose's frame.
    """

    largest_rad: float
    spread: float
    axis: FloatArray

    @property
    def are_enough(self) -> bool:
        """Whether they determine a hand-eye calibration."""
        return self.largest_rad >= MIN_TURN_RAD and self.spread >= MIN_AXES_SPREAD


def turns_of(poses: Sequence[FloatArray]) -> FlangeTurns:
    """Rotations of two or more poses (4, 4) since the first."""
    vectors = np.array([rotation_vector(poses[0][:3, :3].T @ pose[:3, :3]) for pose in poses[1:]])
    angles = np.linalg.norm(vectors, axis=1)
    turned = vectors[angles > 0.3 * MIN_TURN_RAD]
    if not len(turned):
        return FlangeTurns(float(angles.max()), 0.0, np.array([0.0, 0.0, 1.0]))
    _, spread, axes = np.linalg.svd(turned)
    return FlangeTurns(float(angles.max()), float(spread[1] / spread[0]) if len(spread) > 1 else 0.0, axes[0])


def _check_motion(A: FloatArray) -> None:
    """Raise `Undetermined` unless the flange turned about two axes: shifts leave the board's place open."""
    turns = turns_of(list(A))
    if turns.largest_rad < MIN_TURN_RAD:
        raise Undetermined(
            f"the flange turned by at most {np.degrees(turns.largest_rad):.1f}°: poses that only shift leave "
            "the board's place open; turn the wrist by 20° or more",
            "turns_missing",
        )
    if not turns.are_enough:
        raise Undetermined(
            "all rotations of the flange are about one axis: the place along it stays open; turn about "
            "another axis too",
            "turns_missing",
        )


def _start(A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Closed form from the motions between poses: M Y = Y N (F. Park and B. Martin, 1994)."""
    first, second = np.triu_indices(len(A), 1)
    M = np.array([invert(A[j]) @ A[i] for i, j in zip(first, second, strict=True)])
    N = np.array([invert(B[j]) @ B[i] for i, j in zip(first, second, strict=True)])
    alpha = np.array([rotation_vector(motion[:3, :3]) for motion in M])
    beta = np.array([rotation_vector(motion[:3, :3]) for motion in N])
    R = nearest_rotation(alpha.T @ beta)
    system = (M[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    shifts = (N[:, :3, 3] @ R.T - M[:, :3, 3]).ravel()
    t, *_ = np.linalg.lstsq(system, shifts, rcond=None)
    Y = transform(R, np.asarray(t, np.float64))
    each = np.array([shown @ Y @ invert(seen) for shown, seen in zip(A, B, strict=True)])
    X = transform(nearest_rotation(each[:, :3, :3].mean(axis=0)), each[:, :3, 3].mean(axis=0))
    return X, Y


def _hull(points: FloatArray) -> FloatArray:
    """Indices of the marks farthest out in eight directions: they hold all information of a flat board."""
    directions = np.array([[np.cos(t), np.sin(t), 0.0] for t in np.arange(8) * np.pi / 4])
    return np.unique(np.argmax(points @ directions.T, axis=0))


def _mismatch(
    A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray, marks: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals (N, M, 3) A Y m - X B m, and their Jacobian (N, M, 3, 12) for small motions after X and Y."""
    on_flange, seen = apply(Y, marks), np.stack([apply(pose, marks) for pose in B])
    expected = np.stack([apply(pose, on_flange) for pose in A])
    measured = apply(X, seen)
    jacobian = np.zeros((*expected.shape, 12))
    jacobian[..., :3] = -np.eye(3)
    jacobian[..., 3:6] = skew(measured)
    jacobian[..., 6:9] = A[:, None, :3, :3]
    jacobian[..., 9:12] = -A[:, None, :3, :3] @ skew(on_flange)
    return expected - measured, jacobian


def _refine(
    A: FloatArray,
    B: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    marks: FloatArray,
    weights: FloatArray | None = None,
    steps: int = 15,
) -> tuple[FloatArray, FloatArray]:
    """Refine X and Y by Gauss-Newton; weights (N,) : of the poses."""
    root = np.sqrt(np.ones(len(A)) if weights is None else weights)[:, None, None]
    for _ in range(steps):
        residuals, jacobian = _mismatch(A, B, X, Y, marks)
        weighted = (root[..., None] * jacobian).reshape(-1, 12)
        solved, *_ = np.linalg.lstsq(weighted, -(root * residuals).ravel(), rcond=None)
        step = np.asarray(solved, np.float64)
        X, Y = _nudged(X, step[:6]), _nudged(Y, step[6:])
        if np.abs(step).max() < 1e-12 * max(1.0, float(np.abs(X[:3, 3]).max())):
            break
    return X, Y


def _without_outliers(
    A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray, marks: FloatArray
) -> tuple[FloatArray, FloatArray, B8]:
    """Robust fit (Cauchy weights), then a fit without the outliers."""
    errors = _errors_mm(A, B, X, Y, marks)
    for _ in range(REWEIGHTED):
        weights = 1 / (1 + (errors / max(2.0 * float(np.median(errors)), 1e-9)) ** 2)
        X, Y = _refine(A, B, X, Y, marks, weights, steps=2)
        errors = _errors_mm(A, B, X, Y, marks)
    used = errors < OUTLIER * max(float(np.median(errors)), 1e-6)
    if used.sum() < max(MIN_POSES, MIN_KEPT * len(A)):
        used = np.ones(len(A), bool)
    return *_refine(A[used], B[used], X, Y, marks), used


def _nudged(pose: FloatArray, step: FloatArray) -> FloatArray:
    """Apply a small step on the left. step (6,) : shift, then rotation vector about the frame's origin."""
    turn = rotation_matrix(step[3:])
    return transform(nearest_rotation(turn @ pose[:3, :3]), turn @ pose[:3, 3] + step[:3])


def _errors_mm(A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray, marks: FloatArray) -> FloatArray:
    residuals, _ = _mismatch(A, B, X, Y, marks)
    return np.asarray(np.sqrt(np.mean(np.sum(residuals**2, axis=2), axis=1)))


def _covariance(A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray, marks: FloatArray) -> FloatArray:
    """Covariance (6, 6) of X from the scatter between poses (cluster-robust sandwich).

    The marks of one pose share its error. Each pose pulls the fit towards itself, the more so the fewer there
    are: its residuals are enlarged to make up for it, or sigma would be too small, by a factor of 2 for six
    poses.
    Source: R. Bell and D. McCaffrey, "Bias reduction in standard errors for linear regression with
    multi-stage samples", Survey Methodology 28, 2002.
    """
    residuals, jacobian = _mismatch(A, B, X, Y, marks)
    n = len(A)
    J, r = jacobian.reshape(n, -1, 12), residuals.reshape(n, -1)
    bread = np.linalg.inv(np.einsum("nki,nkj->ij", J, J))
    kept, axes = np.linalg.eigh(np.eye(J.shape[1]) - J @ bread @ J.transpose(0, 2, 1))
    along = np.einsum("nki,nk->ni", axes, r) / np.sqrt(np.maximum(kept, LEAST_KEPT))
    gradients = np.einsum("nki,nkj,nj->ni", J, axes, along)
    # estimated from few poses: errors follow Student's t, which is that much wider
    wider = (n - 2) / max(n - 4, 0.5)
    return np.asarray((bread @ (gradients.T @ gradients) @ bread)[:6, :6] * wider)


def _held_out(
    A: FloatArray, B: FloatArray, X: FloatArray, Y: FloatArray, marks: FloatArray, used: B8
) -> tuple[FloatArray, FloatArray]:
    mm, rad = np.full(len(A), np.nan), np.full(len(A), np.nan)
    for k in range(len(A)):
        others = used & (np.arange(len(A)) != k)
        if others.sum() < MIN_POSES - 1:
            continue
        x, y = _refine(A[others], B[others], X, Y, marks)
        mm[k] = _errors_mm(A[k : k + 1], B[k : k + 1], x, y, marks)[0]
        rad[k] = np.linalg.norm(rotation_vector((A[k] @ y)[:3, :3].T @ (x @ B[k])[:3, :3]))
    return mm, rad
