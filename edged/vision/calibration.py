"""Stereo calibration from views of known boards (paper, 3.1).

Start: Zhang's method for each camera (Z. Zhang, PAMI 2000, doi:10.1109/34.888718). Then one
bundle adjustment over everything (`edged.vision.bundle`). Each mark counts by its own
measured precision, joined by a common model error that is estimated from the residuals: what
lens model, board and detector leave unexplained. Parameters that lens models often carry
without need (fx apart from fy, k3) are only released where the data demand it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray
from edged.errors import CalibrationError
from edged.vision.boards import Board, Detection, IntArray, Missed
from edged.vision.bundle import BundleResult, BundleState, LensFreedom, Observations, adjust
from edged.vision.camera import DISTORTION_NAMES, CameraModel, LensModel, StereoRig
from edged.vision.geometry import apply, invert, rotation_matrix, rotation_vector, transform
from edged.vision.rectification import row_difference_px

MIN_VIEWS = 3  # two give no redundancy at all for the distortion
_MIN_MARKS = 8  # in one image: a homography and as much redundancy again
_RELEASE_T = 4.0  # |value| / sigma from which a parameter is taken to be real
_OUTLIER = 6.0  # normalised residual length beyond which a mark is a mistake, not noise
_BAD_VIEW = 5.0  # times the median view rms beyond which a view is not of the same rig or board
_MAX_FOCAL_SIGMA = 0.02  # relative; beyond it the views do not determine the camera
_MIN_TILT_SPREAD_DEG = 3.0  # between board normals; Zhang's method is degenerate for parallel boards


@dataclass(frozen=True, slots=True, eq=False)
class StereoView:
    """One pair of images of one board."""

    name: str
    board: Board
    left: Detection | Missed
    right: Detection | Missed


@dataclass(frozen=True, slots=True, eq=False)
class ViewFit:
    """How one view agrees with the calibration.

    left_from_board (4, 4).  ids, pixels, residuals_px (measured - projected) of both images.
    """

    name: str
    board: Board
    left_from_board: FloatArray
    ids_left: IntArray
    ids_right: IntArray
    pixels_left: FloatArray
    pixels_right: FloatArray
    residuals_left_px: FloatArray
    residuals_right_px: FloatArray

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of both images."""
        return _rms(self.residuals_left_px, self.residuals_right_px)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibrated rig and what there is to say about it.

    Residual lengths are root mean squares over marks of the 2D distance, as OpenCV states them.
    epipolar_rms_px : row difference of rectified marks.
    model_error_px : (left, right), noise of one coordinate that the marks' own precision does not explain.
    excluded : view name and reason.  notes : what a person should know.
    """

    rig: StereoRig
    views: tuple[ViewFit, ...]
    rms_left_px: float
    rms_right_px: float
    rms_px: float
    epipolar_rms_px: float
    model_error_px: tuple[float, float]
    outliers: int
    excluded: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def calibrate_stereo(
    views: Sequence[StereoView],
    left_size: tuple[int, int],
    right_size: tuple[int, int],
    model: LensModel = "division",
) -> Calibration:
    """Calibrate both cameras and their relation.

    left_size, right_size : (width, height) of the images.
    Unusable views are left out and named. Raises `CalibrationError` where no trustworthy
    calibration is possible: fewer than three usable pairs, parallel boards, swapped images,
    a camera that moved between the views.
    """
    usable, excluded = _usable(views)
    left_camera, left_poses = _zhang(usable, "left", left_size, model)
    right_camera, right_poses = _zhang(usable, "right", right_size, model)
    usable, right_from_left = _agree(usable, left_poses, right_poses)
    _check_sides(right_from_left)
    state = BundleState(left_camera, right_camera, right_from_left, np.array(left_poses))
    solution = _solve_and_clean(usable, state, model, excluded)
    return _summarise(solution, excluded)


# --- start values -------------------------------------------------------------------------------


def _usable(views: Sequence[StereoView]) -> tuple[list[StereoView], list[tuple[str, str]]]:
    usable, excluded = [], []
    for view in views:
        problem = next(
            (
                f"{side}: {found.reason}"
                for side, found in (("left", view.left), ("right", view.right))
                if isinstance(found, Missed)
            ),
            None,
        )
        if problem is None and min(len(_detection(view, s).ids) for s in ("left", "right")) < _MIN_MARKS:
            problem = f"fewer than {_MIN_MARKS} marks in one image"
        if problem is None:
            usable.append(view)
        else:
            excluded.append((view.name, problem))
    if len(usable) < MIN_VIEWS:
        reasons = "".join(f"\n  {name}: {reason}" for name, reason in excluded)
        raise CalibrationError(
            f"{len(usable)} of {len(views)} pairs show the board in both images, "
            f"expected at least {MIN_VIEWS} (20 are good){reasons}"
        )
    return usable, excluded


def _detection(view: StereoView, side: str) -> Detection:
    found = view.left if side == "left" else view.right
    if isinstance(found, Missed):
        raise TypeError("a missed view was not sorted out")
    return found


def _zhang(
    views: Sequence[StereoView], side: str, size: tuple[int, int], model: LensModel
) -> tuple[CameraModel, list[FloatArray]]:
    """Camera and camera_from_board for each view."""
    found = [_detection(view, side) for view in views]
    boards = [
        view.board.points_mm[seen.ids].astype(np.float32) for view, seen in zip(views, found, strict=True)
    ]
    pixels = [seen.pixels.astype(np.float32).reshape(-1, 1, 2) for seen in found]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    try:
        _, K, distortion, rotations, translations = cv2.calibrateCamera(
            boards, pixels, size, np.eye(3), np.zeros(5), flags=flags
        )
    except cv2.error as error:
        raise CalibrationError(f"{side} camera: no start values from these views: {error.err}") from error
    poses = [
        transform(rotation_matrix(np.ravel(r)), np.ravel(t))
        for r, t in zip(rotations, translations, strict=True)
    ]
    _check_tilt(poses, side)
    # To first order both models bend alike: r (1 + k1 r²) and r (1 + kappa r²)
    k1 = float(np.ravel(distortion)[0])
    values = (k1,) if model == "division" else (k1, 0.0, 0.0, 0.0, 0.0)
    camera = CameraModel(model, *size, float(K[0, 0]), float(K[0, 0]), float(K[0, 2]), float(K[1, 2]), values)
    return camera, poses


def _check_tilt(poses: Sequence[FloatArray], side: str) -> None:
    normals = np.array([pose[:3, 2] for pose in poses])
    spread = float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))
    if spread < _MIN_TILT_SPREAD_DEG:
        raise CalibrationError(
            f"{side} camera: the board is parallel to itself in all views (normals within {spread:.1f}°): "
            "focal length and distance cannot be told apart; tilt it by 20° to 40° in different directions"
        )


def _agree(
    views: list[StereoView], left: list[FloatArray], right: list[FloatArray]
) -> tuple[list[StereoView], FloatArray]:
    """Which way round a symmetric board was seen, and the relation most views agree on.

    The relation of the cameras is the same in every view; a board that was numbered from the
    other end in one image gives another one in each.
    """
    candidates: list[list[FloatArray]] = []
    for view, left_pose, right_pose in zip(views, left, right, strict=True):
        relations = [right_pose @ invert(left_pose)]
        if view.board.is_symmetric:
            relations.append(right_pose @ _half_turn(view.board) @ invert(left_pose))
        candidates.append(relations)
    best: tuple[float, FloatArray, list[int]] | None = None
    for relation in (relation for relations in candidates for relation in relations):
        distances = [[_distance(relation, other) for other in relations] for relations in candidates]
        # the median, so that views that are wrong altogether have no say
        score = float(np.median([min(d) for d in distances]))
        if best is None or score < best[0]:
            best = score, relation, [int(np.argmin(d)) for d in distances]
    if best is None:
        raise CalibrationError("no view to calibrate from")
    turned = [
        replace(view, right=_renumbered(_detection(view, "right"), view.board)) if choice else view
        for view, choice in zip(views, best[2], strict=True)
    ]
    return turned, best[1]


def _half_turn(board: Board) -> FloatArray:
    """board_from_board (4, 4) that maps each mark to the mark with the number counted from the end."""
    return transform(np.diag([-1.0, -1.0, 1.0]), board.points_mm[-1])


def _renumbered(seen: Detection, board: Board) -> Detection:
    return replace(seen, ids=len(board.points_mm) - 1 - seen.ids)


def _distance(a: FloatArray, b: FloatArray) -> float:
    """How far two relations differ: angle plus shift relative to the baseline."""
    angle = float(np.linalg.norm(rotation_vector(a[:3, :3].T @ b[:3, :3])))
    shift = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
    return angle + shift / max(float(np.linalg.norm(a[:3, 3])), 1e-9)


def _check_sides(right_from_left: FloatArray) -> None:
    centre = invert(right_from_left)[:3, 3]
    if centre[0] < 0 and abs(centre[0]) > abs(centre[1]):
        raise CalibrationError(
            "left and right look swapped: the camera of the *_right images lies on the left of the other; "
            "rename the images (for cameras that hang upside down, too)"
        )


# --- estimation ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Views with their observations, and which marks are kept as no outliers."""

    views: list[StereoView]
    left: Observations
    right: Observations


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    problem: _Problem
    result: BundleResult
    model_error_px: tuple[float, float]
    outliers: int
    freedoms: tuple[LensFreedom, LensFreedom]


def _solve_and_clean(
    views: list[StereoView], state: BundleState, model: LensModel, excluded: list[tuple[str, str]]
) -> _Solution:
    """Estimate; leave out views that contradict the others, one at a time; estimate again."""
    basic = LensFreedom(True, tuple(n for n in DISTORTION_NAMES[model] if n != "k3"))
    while True:
        solution = _estimate(_problem(views), state, (basic, basic))
        worst = _worst_view(solution)
        if worst is None:
            break
        index, rms, typical = worst
        excluded.append((views[index].name, f"residuals of {rms:.2f} px, {typical:.3f} px in the others"))
        views = [view for i, view in enumerate(views) if i != index]
        if len(views) < MIN_VIEWS:
            raise CalibrationError(f"the views contradict each other: {excluded[-1][1]}")
        state = solution.result.state
        state = replace(state, left_from_board=np.delete(state.left_from_board, index, axis=0))
    solution = _release(solution)
    _check_determined(solution.result)
    return solution


def _problem(views: list[StereoView]) -> _Problem:
    return _Problem(views, _observations(views, "left"), _observations(views, "right"))


def _observations(views: Sequence[StereoView], side: str) -> Observations:
    found = [_detection(view, side) for view in views]
    return Observations(
        np.concatenate([np.full(len(seen.ids), i, dtype=np.int64) for i, seen in enumerate(found)]),
        np.concatenate([v.board.points_mm[seen.ids] for v, seen in zip(views, found, strict=True)]),
        np.concatenate([seen.pixels for seen in found]),
        np.concatenate([seen.sigma_px for seen in found]),
    )


def _estimate(problem: _Problem, state: BundleState, freedoms: tuple[LensFreedom, LensFreedom]) -> _Solution:
    """Adjust, estimate the model error, drop outliers, until nothing changes."""
    try:
        errors, outliers = (0.5, 0.5), 0
        for _ in range(8):
            left, right = _with_error(problem.left, errors[0]), _with_error(problem.right, errors[1])
            result = adjust(state, left, right, *freedoms)
            state, before = result.state, errors
            share = result.freedom / (2 * (len(left.view) + len(right.view)))
            errors = (
                _model_error(problem.left, result.residuals_left_px, share),
                _model_error(problem.right, result.residuals_right_px, share),
            )
            kept_left, kept_right = (
                _inliers(problem.left, result.residuals_left_px, errors[0]),
                _inliers(problem.right, result.residuals_right_px, errors[1]),
            )
            dropped = int((~kept_left).sum() + (~kept_right).sum())
            if dropped:
                problem = replace(
                    problem, left=_pick(problem.left, kept_left), right=_pick(problem.right, kept_right)
                )
                outliers += dropped
            elif np.allclose(errors, before, rtol=0.01, atol=1e-5):
                break
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            "these views do not determine the cameras: the equations are singular"
        ) from error
    if not result.converged:
        raise CalibrationError("the bundle adjustment does not converge: these views contradict each other")
    return _Solution(problem, result, errors, outliers, freedoms)


def _with_error(seen: Observations, error_px: float) -> Observations:
    return replace(seen, sigma_px=np.hypot(seen.sigma_px, error_px))


def _pick(seen: Observations, kept: npt.NDArray[np.bool_]) -> Observations:
    return Observations(seen.view[kept], seen.points_mm[kept], seen.pixels[kept], seen.sigma_px[kept])


def _inliers(seen: Observations, residuals: FloatArray, error_px: float) -> npt.NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(residuals, axis=1) < _OUTLIER * np.hypot(seen.sigma_px, error_px))


def _model_error(seen: Observations, residuals: FloatArray, share: float) -> float:
    """The error of one coordinate, added to each mark's own, that makes chi² what it should be.

    share : degrees of freedom per measured value. 0 where the marks' own sigmas explain everything.
    """
    squares = np.sum(residuals**2, axis=1)

    # clipped like the robust loss clips, so that a few mistakes do not set the scale
    def chi2(error: float) -> float:
        return float(np.minimum(squares / (seen.sigma_px**2 + error**2), 9.0).sum())

    target = 2 * len(squares) * share * 0.989  # E[min(r², 9)] / 2 of a two-dimensional normal
    low, high = 0.0, float(np.sqrt(squares.max())) + 1e-9
    if chi2(0.0) <= target:
        return 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if chi2(middle) > target else (low, middle)
    return high


def _worst_view(solution: _Solution) -> tuple[int, float, float] | None:
    """Index, rms and median rms of the view that does not belong, if there is one."""
    result, problem = solution.result, solution.problem
    squares = np.zeros(len(problem.views))
    counts = np.zeros(len(problem.views))
    for seen, residuals in (
        (problem.left, result.residuals_left_px),
        (problem.right, result.residuals_right_px),
    ):
        squares = squares + np.bincount(seen.view, np.sum(residuals**2, axis=1), len(squares))
        counts = counts + np.bincount(seen.view, minlength=len(counts))
    rms = np.asarray(np.sqrt(squares / np.maximum(counts, 1)), dtype=np.float64)
    index, typical = int(np.argmax(rms)), float(np.median(rms))
    return (index, float(rms[index]), typical) if rms[index] > _BAD_VIEW * typical else None


def _release(solution: _Solution) -> _Solution:
    """Free fx from fy, and k3, where the data contradict the simpler lens."""
    for index, side in enumerate(("left", "right")):
        freedom = solution.freedoms[index]
        trials = [replace(freedom, square_pixels=False)]
        if "k1" in freedom.distortion:
            trials.append(replace(freedom, distortion=DISTORTION_NAMES["brown"]))
        for trial in trials:
            freedoms = (trial, solution.freedoms[1]) if index == 0 else (solution.freedoms[0], trial)
            freer = _estimate(solution.problem, solution.result.state, freedoms)
            if _significance(freer.result, side, trial, freedom) > _RELEASE_T:
                solution, freedom = freer, trial
                trials[-1] = replace(trials[-1], square_pixels=freedom.square_pixels)
    return solution


def _significance(result: BundleResult, side: str, trial: LensFreedom, before: LensFreedom) -> float:
    """|value| / sigma of what `trial` frees."""
    rig = _rig(result, "")
    names = list(rig.parameter_names)
    camera = rig.left if side == "left" else rig.right
    weights = np.zeros(len(names))
    if trial.square_pixels != before.square_pixels:
        value = camera.fx - camera.fy
        weights[names.index(f"{side}.fx")], weights[names.index(f"{side}.fy")] = 1, -1
    else:
        value = camera.distortion[4]
        weights[names.index(f"{side}.k3")] = 1
    return abs(value) / float(np.sqrt(weights @ result.covariance @ weights))


def _check_determined(result: BundleResult) -> None:
    rig = _rig(result, "")
    sigma = np.sqrt(np.diag(result.covariance))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        relative = sigma[rig.parameter_names.index(f"{side}.fx")] / camera.fx
        if not relative < _MAX_FOCAL_SIGMA or camera.fx <= 0 or camera.fy <= 0:
            raise CalibrationError(
                f"{side} camera: these views leave its focal length open (sigma {100 * relative:.1f} %); "
                "tilt the board by 20° to 40° in different directions and fill the image"
            )


# --- result -------------------------------------------------------------------------------------


def _rig(result: BundleResult, identity: str) -> StereoRig:
    state = result.state
    return StereoRig(state.left, state.right, state.right_from_left, identity, covariance=result.covariance)


def _identity(rig: StereoRig) -> str:
    """A name that follows from the values: the same calibration has the same name anywhere."""
    cameras = [
        (c.model, c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.distortion) for c in (rig.left, rig.right)
    ]
    text = repr((cameras, rig.right_from_left.tolist()))
    return f"cal-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _rms(*residuals: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.concatenate(residuals) ** 2, axis=1))))


def _summarise(solution: _Solution, excluded: list[tuple[str, str]]) -> Calibration:
    problem, result = solution.problem, solution.result
    rig = _rig(result, "")
    rig = replace(rig, calibration_id=_identity(rig))
    fits = tuple(
        _view_fit(view, i, rig, result.state.left_from_board[i]) for i, view in enumerate(problem.views)
    )
    rows = np.concatenate([epipolar_errors_px(rig, fit) for fit in fits])
    return Calibration(
        rig=rig,
        views=fits,
        rms_left_px=_rms(result.residuals_left_px),
        rms_right_px=_rms(result.residuals_right_px),
        rms_px=_rms(result.residuals_left_px, result.residuals_right_px),
        epipolar_rms_px=float(np.sqrt(np.mean(rows**2))) if rows.size else float("nan"),
        model_error_px=solution.model_error_px,
        outliers=solution.outliers,
        excluded=tuple(excluded),
        notes=(),
    )


def _view_fit(view: StereoView, index: int, rig: StereoRig, left_from_board: FloatArray) -> ViewFit:
    del index
    left, right = _detection(view, "left"), _detection(view, "right")
    in_left = apply(left_from_board, view.board.points_mm)
    projected_left = rig.left.project(in_left)
    projected_right = rig.right.project(apply(rig.right_from_left, in_left))
    return ViewFit(
        view.name,
        view.board,
        left_from_board,
        left.ids,
        right.ids,
        left.pixels,
        right.pixels,
        left.pixels - projected_left[left.ids],
        right.pixels - projected_right[right.ids],
    )


def epipolar_errors_px(rig: StereoRig, fit: ViewFit) -> FloatArray:
    """Rectified row differences of the marks seen in both images of a view."""
    _, left, right = np.intersect1d(fit.ids_left, fit.ids_right, return_indices=True)
    return row_difference_px(rig, fit.pixels_left[left], fit.pixels_right[right])
