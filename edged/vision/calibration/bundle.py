"""Bundle adjustment of a stereo rig over views of flat boards.

A single least squares problem over both lenses, right_from_left and one board pose per view.
The normal matrix has arrow structure: each view involves only the rig's unknowns and its own six
pose unknowns, so the poses are eliminated (Schur complement) and a step costs little more than the
projections. Source: B. Triggs et al., "Bundle Adjustment - A Modern Synthesis", 2000.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.vision.calibration.params import CALIBRATION
from edged.vision.geometry.camera import DISTORTION_NAMES, CameraModel
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rigid import apply, rotation_matrix, skew, transform

_MAX_STEPS = 60  # limit for a fit that does not converge


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """All measured marks of one camera, in flat arrays.

    view (N,) : index of the view; points_mm (N, 3) in the board's frame; pixels (N, 2);
    sigma_px (N,) of one coordinate.
    shape (N, 3, Q) : derivative of each mark's position on its board with respect to the board's shape;
    None: the board is taken as stated.
    """

    view: I64
    points_mm: FloatArray
    pixels: FloatArray
    sigma_px: FloatArray
    shape: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class LensFreedom:
    """Which parameters of a lens are estimated.

    square_pixels : fx and fy are one unknown.  distortion : names of the free coefficients.
    """

    square_pixels: bool
    distortion: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return 3 + (not self.square_pixels) + len(self.distortion)

    def selection(self, camera: CameraModel) -> FloatArray:
        """(P, F) matrix from free unknowns to the camera's parameters fx, fy, cx, cy, distortion."""
        names = ("fx", "fy", "cx", "cy", *DISTORTION_NAMES[camera.model])
        columns = [["fx", "fy"]] if self.square_pixels else [["fx"], ["fy"]]
        columns += [["cx"], ["cy"], *([name] for name in self.distortion)]
        return np.array([[float(name in column) for column in columns] for name in names])


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    """The unknowns: both cameras, right_from_left (4, 4), left_from_board (V, 4, 4).

    shape (Q,) : coefficients of the boards' shapes, with a prior of zero +- shape_sigma; empty if the boards
    are taken as stated.
    """

    left: CameraModel
    right: CameraModel
    right_from_left: FloatArray
    left_from_board: FloatArray
    shape: FloatArray = field(default_factory=lambda: np.zeros(0))  # as stated
    shape_sigma: float = 1.0  # mm; unused while shape is empty


@dataclass(frozen=True, slots=True, eq=False)
class BundleResult:
    """The optimum of an adjustment.

    residuals_left_px, residuals_right_px (N, 2) : measured - projected.
    covariance : of StereoRig.parameter_names, for the observations' sigmas as given.
    pose_covariance (V, 6, 6) : of each left_from_board, (rotation vector on the left, translation mm).
    chi2, freedom : sum of (robustly weighted) normalised squares; number of values minus unknowns.
    converged : whether the last step was negligible.
    """

    state: BundleState
    residuals_left_px: FloatArray
    residuals_right_px: FloatArray
    covariance: FloatArray
    pose_covariance: FloatArray
    chi2: float
    freedom: int
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations: rig block (G, G), coupling (V, G, 6), pose blocks (V, 6, 6), right sides, cost."""

    rig: FloatArray
    coupling: FloatArray
    poses: FloatArray
    rig_right: FloatArray
    poses_right: FloatArray
    cost: float


def adjust(
    state: BundleState,
    left: Observations,
    right: Observations,
    freedom_left: LensFreedom,
    freedom_right: LensFreedom,
    *,
    robust: bool = True,
) -> BundleResult:
    """Minimise the weighted reprojection error of both cameras by Levenberg-Marquardt.

    Every view needs marks in at least one image, and at least one view needs them in both.
    Raises `np.linalg.LinAlgError` if the normal equations are singular.
    """
    selections = freedom_left.selection(state.left), freedom_right.selection(state.right)
    views = len(state.left_from_board)
    damping, converged = CALIBRATION.start_damping, False
    normal = _normal_equations(state, left, right, selections, robust=robust)
    for _ in range(_MAX_STEPS):
        rig_step, pose_steps = _solve(normal, damping)
        expected_gain = float(rig_step @ normal.rig_right + np.sum(pose_steps * normal.poses_right))
        if damping <= CALIBRATION.free_damping and expected_gain < CALIBRATION.negligible_gain:
            converged = True
            break
        trial = _moved(state, rig_step, pose_steps, selections)
        trial_normal = _normal_equations(trial, left, right, selections, robust=robust)
        if trial_normal.cost <= normal.cost + CALIBRATION.negligible_gain:  # False for NaN: a point behind
            state, normal, damping = trial, trial_normal, damping / 10
        else:
            damping *= 8
            if damping > 1e10:
                break

    rig_covariance, pose_covariance = _covariances(normal)
    shape = len(state.shape)
    full = np.zeros((sum(s.shape[0] for s in selections) + 6, normal.rig.shape[0] - shape))
    rows, columns = selections[0].shape
    full[:rows, :columns] = selections[0]
    full[rows : rows + selections[1].shape[0], columns : columns + selections[1].shape[1]] = selections[1]
    full[-6:, -6:] = np.eye(6)
    residuals_left, residuals_right = residuals(state, left, right)
    count = 2 * (len(left.view) + len(right.view))
    return BundleResult(
        state,
        residuals_left,
        residuals_right,
        full @ rig_covariance[shape:, shape:] @ full.T,
        pose_covariance,
        normal.cost,
        count - normal.rig.shape[0] - 6 * views,
        converged,
    )


def residuals(state: BundleState, left: Observations, right: Observations) -> tuple[FloatArray, FloatArray]:
    """Residuals measured - projected (N, 2) in px, of both cameras."""
    in_left = _in_left(state, left)[1]
    in_right = apply(state.right_from_left, _in_left(state, right)[1])
    return left.pixels - state.left.project(in_left), right.pixels - state.right.project(in_right)


def rig_information(
    state: BundleState,
    left: Observations,
    right: Observations,
    freedom_left: LensFreedom,
    freedom_right: LensFreedom,
) -> FloatArray:
    """Information (V, G, G) about the rig from each view alone, with its board pose free.

    The G unknowns are those that `adjust` would free, in its order.
    """
    selections = freedom_left.selection(state.left), freedom_right.selection(state.right)
    return _information(state, left, right, selections)[0]


def relation_information(
    state: BundleState, left: Observations, right: Observations
) -> tuple[FloatArray, FloatArray]:
    """Information about right_from_left from each view alone, with lenses fixed and its board pose free.

    Returns information (V, 6, 6) and gradient (V, 6) of (rotation vector on the left, translation):
    the change of right_from_left that fits the view best is information^-1 @ gradient.
    """
    nothing = np.zeros((4 + len(state.left.distortion), 0)), np.zeros((4 + len(state.right.distortion), 0))
    return _information(state, left, right, nothing)


def _information(
    state: BundleState, left: Observations, right: Observations, selections: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Information (V, G, G) and gradient (V, G) of each view, with its pose eliminated."""
    unknowns = selections[0].shape[1] + selections[1].shape[1] + 6
    views = len(state.left_from_board)
    information, gradient = np.empty((views, unknowns, unknowns)), np.empty((views, unknowns))
    for view in range(views):
        alone = replace(state, left_from_board=state.left_from_board[view : view + 1])
        seen = _of_view(left, view), _of_view(right, view)
        normal = _normal_equations(alone, *seen, selections, robust=True)
        gain = np.linalg.solve(normal.poses[0], normal.coupling[0].T)
        information[view] = normal.rig - normal.coupling[0] @ gain
        gradient[view] = normal.rig_right - gain.T @ normal.poses_right[0]
    return information, gradient


def adjust_poses(state: BundleState, left: Observations, right: Observations) -> BundleState:
    """Fit the board poses, with lenses and right_from_left fixed."""
    nothing = np.zeros((4 + len(state.left.distortion), 0)), np.zeros((4 + len(state.right.distortion), 0))
    for _ in range(_MAX_STEPS):
        normal = _normal_equations(state, left, right, nothing, robust=True)
        solved = np.linalg.solve(normal.poses, normal.poses_right[..., None])
        steps = np.asarray(solved[..., 0], dtype=np.float64)
        state = _moved(state, np.zeros(len(state.shape) + 6), steps, nothing)
        if float(np.sum(steps * normal.poses_right)) < CALIBRATION.negligible_gain:
            break
    return state


def _of_view(seen: Observations, view: int) -> Observations:
    """The marks of one view, renumbered as view 0."""
    kept = seen.view == view
    first = np.zeros(int(kept.sum()), dtype=np.int64)
    shape = None if seen.shape is None else seen.shape[kept]
    return Observations(first, seen.points_mm[kept], seen.pixels[kept], seen.sigma_px[kept], shape)


def _in_left(state: BundleState, seen: Observations) -> tuple[FloatArray, FloatArray]:
    """Rotated board points R x, and points R x + t in the left camera's frame; both (N, 3)."""
    poses = state.left_from_board[seen.view]
    marks = seen.points_mm if seen.shape is None else seen.points_mm + seen.shape @ state.shape
    turned = np.einsum("nij,nj->ni", poses[:, :3, :3], marks)
    return turned, turned + poses[:, :3, 3]


def _normal_equations(
    state: BundleState,
    left: Observations,
    right: Observations,
    selections: tuple[FloatArray, FloatArray],
    *,
    robust: bool,
) -> _Normal:
    views = len(state.left_from_board)
    shape = len(state.shape)  # order of unknowns: shape, left lens, right lens, right_from_left
    right_start = shape + selections[0].shape[1]
    unknowns = right_start + selections[1].shape[1] + 6
    rig, rig_right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    coupling, poses = np.zeros((views, unknowns, 6)), np.zeros((views, 6, 6))
    poses_right, cost = np.zeros((views, 6)), 0.0
    for is_right, seen in ((False, left), (True, right)):
        if not len(seen.view):
            continue
        turned, points = _in_left(state, seen)
        by_rig = np.zeros((len(seen.view), 2, unknowns))
        if is_right:
            rotated = points @ state.right_from_left[:3, :3].T
            points = rotated + state.right_from_left[:3, 3]
            pixels, by_point, by_lens = project_with_jacobians(state.right, points)
            by_rig[:, :, right_start:-6] = by_lens @ selections[1]
            by_rig[:, :, -6:-3] = -by_point @ skew(rotated)
            by_rig[:, :, -3:] = by_point
            by_point = by_point @ state.right_from_left[:3, :3]
        else:
            pixels, by_point, by_lens = project_with_jacobians(state.left, points)
            by_rig[:, :, shape:right_start] = by_lens @ selections[0]
        if seen.shape is not None:
            by_rig[:, :, :shape] = by_point @ state.left_from_board[seen.view, :3, :3] @ seen.shape
        by_pose = np.concatenate([-by_point @ skew(turned), by_point], axis=2)
        scaled = (seen.pixels - pixels) / seen.sigma_px[:, None]
        weight, loss = _huber(scaled) if robust else (np.ones(len(scaled)), np.sum(scaled**2, axis=1))
        if (points[:, 2] <= 0).any():
            loss = np.full(1, np.nan)
        by_rig *= (np.sqrt(weight) / seen.sigma_px)[:, None, None]
        by_pose *= (np.sqrt(weight) / seen.sigma_px)[:, None, None]
        scaled = scaled * np.sqrt(weight)[:, None]
        cost += float(loss.sum())
        flat = by_rig.reshape(-1, unknowns)
        rig += flat.T @ flat
        rig_right += flat.T @ scaled.ravel()
        np.add.at(coupling, seen.view, by_rig.transpose(0, 2, 1) @ by_pose)
        np.add.at(poses, seen.view, by_pose.transpose(0, 2, 1) @ by_pose)
        np.add.at(poses_right, seen.view, np.einsum("nij,ni->nj", by_pose, scaled))
    prior = state.shape / state.shape_sigma
    cost += float(prior @ prior)
    rig[:shape, :shape] += np.eye(shape) / state.shape_sigma**2
    rig_right[:shape] -= prior / state.shape_sigma
    return _Normal(rig, coupling, poses, rig_right, poses_right, cost)


def _huber(scaled: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Huber weight and loss (N,) of normalised residuals (N, 2), by their length."""
    length = np.linalg.norm(scaled, axis=1)
    weight = np.minimum(1.0, CALIBRATION.huber / np.maximum(length, 1e-300))
    loss = np.where(
        length <= CALIBRATION.huber, length**2, 2 * CALIBRATION.huber * length - CALIBRATION.huber**2
    )
    return weight, loss


def _solve(normal: _Normal, damping: float) -> tuple[FloatArray, FloatArray]:
    """Damped step of the rig's unknowns (G,) and of the poses (V, 6)."""
    rig = normal.rig + damping * np.diag(np.diag(normal.rig))
    diagonal = np.einsum("vii->vi", normal.poses)
    poses = normal.poses + damping * diagonal[:, :, None] * np.eye(6)
    eliminated = np.linalg.solve(
        poses, np.concatenate([normal.coupling.transpose(0, 2, 1), normal.poses_right[..., None]], axis=2)
    )
    reduced = rig - np.einsum("vgi,vih->gh", normal.coupling, eliminated[:, :, :-1])
    right = normal.rig_right - np.einsum("vgi,vi->g", normal.coupling, eliminated[:, :, -1])
    step = _scaled_solve(reduced, right)
    return step, eliminated[:, :, -1] - eliminated[:, :, :-1] @ step


def _scaled_solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a unit diagonal, as focal lengths and distortions differ by ten orders of magnitude."""
    scale = 1 / np.sqrt(np.diag(matrix))
    solution = np.linalg.solve(matrix * scale[:, None] * scale, (right.T * scale).T)
    return np.asarray((solution.T * scale).T)


def _covariances(normal: _Normal) -> tuple[FloatArray, FloatArray]:
    """Covariance of the rig's unknowns (G, G) and of each pose (V, 6, 6)."""
    eliminated = np.linalg.solve(normal.poses, normal.coupling.transpose(0, 2, 1))
    reduced = normal.rig - np.einsum("vgi,vih->gh", normal.coupling, eliminated)
    rig = _scaled_solve(reduced, np.eye(len(reduced)))
    rig = 0.5 * (rig + rig.T)
    poses = np.linalg.inv(normal.poses) + eliminated @ rig @ eliminated.transpose(0, 2, 1)
    return rig, np.asarray(poses, dtype=np.float64)


def _moved(
    state: BundleState,
    rig_step: FloatArray,
    pose_steps: FloatArray,
    selections: tuple[FloatArray, FloatArray],
) -> BundleState:
    shape = len(state.shape)
    split = shape + selections[0].shape[1]
    poses = state.left_from_board.copy()
    poses[:, :3, :3] = rotation_matrix(pose_steps[:, :3]) @ poses[:, :3, :3]
    poses[:, :3, 3] += pose_steps[:, 3:]
    return BundleState(
        moved_camera(state.left, selections[0] @ rig_step[shape:split]),
        moved_camera(state.right, selections[1] @ rig_step[split:-6]),
        transform(
            rotation_matrix(rig_step[-6:-3]) @ state.right_from_left[:3, :3],
            state.right_from_left[:3, 3] + rig_step[-3:],
        ),
        poses,
        state.shape + rig_step[:shape],
        state.shape_sigma,
    )


def moved_camera(camera: CameraModel, step: FloatArray) -> CameraModel:
    """The camera with a step added to its parameters fx, fy, cx, cy and distortion."""
    fx, fy, cx, cy = (float(v) for v in np.array([camera.fx, camera.fy, camera.cx, camera.cy]) + step[:4])
    distortion = tuple(float(v) for v in np.array(camera.distortion) + step[4:])
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion)
