"""Stereo calibration from views of known boards (paper, 3.1).

Start: Zhang's method for each camera (Z. Zhang, PAMI 2000, doi:10.1109/34.888718). Then one
bundle adjustment over everything (`edged.vision.calibration.bundle`). Each mark counts by its own
measured precision, joined by a common model error that is estimated from the residuals: what
lens model, board and detector leave unexplained. Parameters that lens models often carry
without need (fx apart from fy, k3) are only released where the data demand it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.errors import CalibrationError
from edged.vision.boards.board import IntArray, ShapedBoard, StereoView
from edged.vision.boards.deformation import PRIOR_SHARE, deviation_mm, plate_basis, shaped
from edged.vision.calibration.bundle import (
    BundleResult,
    BundleState,
    LensFreedom,
    Observations,
    adjust,
    relation_information,
)
from edged.vision.calibration.initial import MIN_VIEWS, agree, check_sides, usable_views, zhang
from edged.vision.geometry.camera import (
    DISTORTION_NAMES,
    CameraModel,
    LensModel,
    StereoRig,
    calibration_identity,
)
from edged.vision.geometry.rectification import row_difference_px
from edged.vision.geometry.rigid import apply

# |value| / sigma from which a parameter is taken to be real. Not less: errors of neighbouring marks are
# alike (a bent board), which the sigma does not know; square pixels looked oblong by 4 sigma on real boards.
_RELEASE_T = 6.0
_OUTLIER = 6.0  # normalised residual length beyond which a mark is a mistake, not noise
_BAD_VIEW = 5.0  # times the usual residual beyond which a view is not of the same rig or board
_START_ERROR_PX = 0.5  # far above any real detector's, so that the first fit is a plain one
_ESTIMATE_ROUNDS = 8
_MOVED_SHARE = 0.3  # of chi² that one movement of a camera explains, from which it is not chance
_BLURRED = 2.0  # times the median edge spread
_MAX_FOCAL_SIGMA = 0.02  # relative; beyond it the views do not determine the camera


@dataclass(frozen=True, slots=True, eq=False)
class ViewFit:
    """How one view agrees with the calibration.

    view : with the marks as they were measured, numbered as they were used.
    left_from_board (4, 4).
    residuals_left_px, residuals_right_px (N, 2) : measured - projected.
    """

    view: StereoView
    left_from_board: FloatArray
    residuals_left_px: FloatArray
    residuals_right_px: FloatArray

    @property
    def name(self) -> str:
        """The view's name."""
        return self.view.name

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
    *,
    plate_shape: bool = False,
) -> Calibration:
    """Calibrate both cameras and their relation.

    left_size, right_size : (width, height) of the images.
    plate_shape : estimate the boards' own shape, too (see `edged.vision.boards.deformation`).
    Unusable views are left out and named. Raises `CalibrationError` where no trustworthy
    calibration is possible: fewer than three usable pairs, parallel boards, swapped images,
    a camera that moved between the views.
    """
    usable, excluded = usable_views(views)
    left_camera, left_poses = zhang(usable, "left", left_size, model)
    right_camera, right_poses = zhang(usable, "right", right_size, model)
    usable, right_from_left = agree(usable, left_poses, right_poses)
    check_sides(right_from_left, left_poses)
    state = BundleState(left_camera, right_camera, right_from_left, np.array(left_poses))
    solution = _solve_and_clean(usable, state, model, excluded)
    if plate_shape:
        solution = _with_shapes(solution)
    return _summarise(solution, excluded)


# --- estimation ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Views with their observations, and which marks are kept as no outliers."""

    views: Sequence[StereoView]
    left: Observations
    right: Observations


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    problem: _Problem
    result: BundleResult
    model_error_px: tuple[float, float]
    freedoms: tuple[LensFreedom, LensFreedom]


def _solve_and_clean(
    views: list[StereoView], state: BundleState, model: LensModel, excluded: list[tuple[str, str]]
) -> _Solution:
    """Estimate; leave out views that contradict the others, one at a time; estimate again."""
    basic = LensFreedom(True, tuple(n for n in DISTORTION_NAMES[model] if n != "k3"))
    while True:
        solution = _estimate(_problem(views), state, (basic, basic))
        _check_movement(solution)
        worst = _worst_view(solution)
        if worst is None:
            break
        index, residual, usual = worst
        excluded.append((views[index].name, f"residuals of {residual:.2f} px, usually {usual:.3f} px"))
        views = [view for i, view in enumerate(views) if i != index]
        if len(views) < MIN_VIEWS:
            raise CalibrationError(f"the views contradict each other: {excluded[-1][1]}")
        state = solution.result.state
        state = replace(state, left_from_board=np.delete(state.left_from_board, index, axis=0))
    solution = _release(_without_outliers(solution))
    _check_determined(solution.result)
    return solution


def _problem(views: list[StereoView]) -> _Problem:
    return _Problem(views, observations(views, "left"), observations(views, "right"))


def observations(views: Sequence[StereoView], side: Side) -> Observations:
    """All marks of the "left" or "right" images, with the precision their own fits state."""
    found = [view.found(side) for view in views]
    return Observations(
        np.concatenate([np.full(len(seen.ids), i, dtype=np.int64) for i, seen in enumerate(found)]),
        np.concatenate([v.board.points_mm[seen.ids] for v, seen in zip(views, found, strict=True)]),
        np.concatenate([seen.pixels for seen in found]),
        np.concatenate([seen.sigma_px for seen in found]),
    )


def _estimate(problem: _Problem, state: BundleState, freedoms: tuple[LensFreedom, LensFreedom]) -> _Solution:
    """Adjust and estimate the model error in turn until it settles."""
    errors = _START_ERROR_PX, _START_ERROR_PX
    try:
        for _ in range(_ESTIMATE_ROUNDS):
            left, right = (
                with_model_error(problem.left, errors[0]),
                with_model_error(problem.right, errors[1]),
            )
            result = adjust(state, left, right, *freedoms)
            state, before = result.state, errors
            share = result.freedom / (2 * (len(left.view) + len(right.view)))
            errors = (
                _model_error(problem.left, result.residuals_left_px, share),
                _model_error(problem.right, result.residuals_right_px, share),
            )
            if np.allclose(errors, before, rtol=0.01, atol=1e-5):
                break
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            "these views do not determine the cameras: the equations are singular"
        ) from error
    if not result.converged:
        raise CalibrationError("the bundle adjustment does not converge: these views contradict each other")
    return _Solution(problem, result, errors, freedoms)


def _without_outliers(solution: _Solution) -> _Solution:
    """Drop marks that are mistakes, a few times: without the worst ones the next stand out."""
    for _ in range(_ESTIMATE_ROUNDS):
        problem, result = solution.problem, solution.result
        kept_left = _inliers(problem.left, result.residuals_left_px, solution.model_error_px[0])
        kept_right = _inliers(problem.right, result.residuals_right_px, solution.model_error_px[1])
        if kept_left.all() and kept_right.all():
            break
        kept = replace(problem, left=_pick(problem.left, kept_left), right=_pick(problem.right, kept_right))
        solution = _estimate(kept, result.state, solution.freedoms)
    return solution


def _with_shapes(solution: _Solution) -> _Solution:
    """Estimate once more with the boards' shapes free; the views then hold boards of that shape."""
    problem, state = solution.problem, solution.result.state
    boards = list(dict.fromkeys(view.board for view in problem.views))
    bases = [plate_basis(board) for board in boards]
    starts = np.cumsum([0, *(basis.count for basis in bases)])
    which = np.array([boards.index(view.board) for view in problem.views])

    def with_shape(seen: Observations) -> Observations:
        shape = np.zeros((len(seen.view), 3, int(starts[-1])))
        for number, basis in enumerate(bases):
            members = which[seen.view] == number
            shape[members, :, starts[number] : starts[number + 1]] = basis.at(seen.points_mm[members])
        return replace(seen, shape=shape)

    prior_mm = PRIOR_SHARE * min(board.pitch_mm for board in boards)
    state = replace(state, shape=np.zeros(int(starts[-1])), shape_sigma=prior_mm)
    free = _Problem(problem.views, with_shape(problem.left), with_shape(problem.right))
    found = _estimate(free, state, solution.freedoms)
    coefficients = found.result.state.shape
    new = [
        shaped(board, basis, coefficients[start:end])
        for board, basis, start, end in zip(boards, bases, starts, starts[1:], strict=False)
    ]
    views = [replace(view, board=new[number]) for view, number in zip(problem.views, which, strict=True)]
    return replace(found, problem=replace(problem, views=views))


def with_model_error(seen: Observations, error_px: float) -> Observations:
    """The marks with the common model error joined to their own."""
    return replace(seen, sigma_px=np.hypot(seen.sigma_px, error_px))


def _pick(seen: Observations, kept: npt.NDArray[np.bool_]) -> Observations:
    shape = None if seen.shape is None else seen.shape[kept]
    return Observations(seen.view[kept], seen.points_mm[kept], seen.pixels[kept], seen.sigma_px[kept], shape)


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


def _check_movement(solution: _Solution) -> None:
    """Raise `CalibrationError` if one change of right_from_left between two views explains the residuals.

    A likelihood ratio test over all places where the sequence of views can be cut.
    """
    problem, result = solution.problem, solution.result
    errors = solution.model_error_px
    left, right = with_model_error(problem.left, errors[0]), with_model_error(problem.right, errors[1])
    information, gradient = relation_information(result.state, left, right)
    before, score = np.cumsum(information, axis=0)[:-1], np.cumsum(gradient, axis=0)[:-1]
    after, rest = information.sum(axis=0) - before, gradient.sum(axis=0) - score
    step_before = np.linalg.solve(before, score[..., None])[..., 0]
    step_after = np.linalg.solve(after, rest[..., None])[..., 0]
    gain = np.sum(step_before * score, axis=1) + np.sum(step_after * rest, axis=1)
    last = len(problem.views) - 2  # a single view at either end is a bad view, not a movement
    inner = gain[1:last]
    if not inner.size or inner.max() < _MOVED_SHARE * result.chi2:
        return
    cut = 1 + int(np.argmax(inner))
    change = step_after[cut] - step_before[cut]
    raise CalibrationError(
        f"a camera was moved between {problem.views[cut].name} and {problem.views[cut + 1].name}: by about "
        f"{np.degrees(np.linalg.norm(change[:3])):.3f}° and {np.linalg.norm(change[3:]):.3f} mm "
        "against the other; take the views again without touching the cameras"
    )


def _worst_view(solution: _Solution) -> tuple[int, float, float] | None:
    """Index, residual and usual residual of the view that does not belong, if there is one.

    By the median over a view's marks: a few wrong marks do not condemn a view.
    """
    result, problem = solution.result, solution.problem
    view = np.concatenate([problem.left.view, problem.right.view])
    length = np.linalg.norm(np.concatenate([result.residuals_left_px, result.residuals_right_px]), axis=1)
    medians = np.array([np.median(length[view == i]) for i in range(len(problem.views))])
    index, typical = int(np.argmax(medians)), float(np.median(medians))
    return (index, float(medians[index]), typical) if medians[index] > _BAD_VIEW * typical else None


def freedom_of(camera: CameraModel) -> LensFreedom:
    """What was estimated of a camera, read off its values."""
    names = DISTORTION_NAMES[camera.model]
    free = tuple(n for n, v in zip(names, camera.distortion, strict=True) if n != "k3" or v != 0.0)
    return LensFreedom(camera.fx == camera.fy, free)


def _release(solution: _Solution) -> _Solution:
    """Free fx from fy, and k3, where the data contradict the simpler lens."""
    for index, side in enumerate(SIDES):
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


def _significance(result: BundleResult, side: Side, trial: LensFreedom, before: LensFreedom) -> float:
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
                f"{side} camera: these views do not determine its focal length (sigma "
                f"{100 * relative:.1f} %); tilt the board by 20° to 40° in different directions and fill the "
                "image"
            )


# --- result -------------------------------------------------------------------------------------


def _rig(result: BundleResult, identity: str) -> StereoRig:
    state = result.state
    return StereoRig(state.left, state.right, state.right_from_left, identity, covariance=result.covariance)


def _rms(*residuals: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.concatenate(residuals) ** 2, axis=1))))


def _summarise(solution: _Solution, excluded: list[tuple[str, str]]) -> Calibration:
    problem, result = solution.problem, solution.result
    rig = _rig(result, "")
    identity = calibration_identity(rig.left, rig.right, rig.right_from_left)
    rig = replace(rig, calibration_id=identity)
    fits = tuple(
        fit_of_view(view, rig, pose)
        for view, pose in zip(problem.views, result.state.left_from_board, strict=True)
    )
    marks = sum(len(view.found(side).ids) for view in problem.views for side in SIDES)
    rows = np.concatenate([epipolar_errors_px(rig, fit.view) for fit in fits])
    return Calibration(
        rig=rig,
        views=fits,
        rms_left_px=_rms(result.residuals_left_px),
        rms_right_px=_rms(result.residuals_right_px),
        rms_px=_rms(result.residuals_left_px, result.residuals_right_px),
        epipolar_rms_px=float(np.sqrt(np.mean(rows**2))) if rows.size else float("nan"),
        model_error_px=solution.model_error_px,
        outliers=marks - len(problem.left.view) - len(problem.right.view),
        excluded=tuple(excluded),
        notes=_notes(problem.views),
    )


def _notes(views: Sequence[StereoView]) -> tuple[str, ...]:
    notes = []
    for side in SIDES:
        blur = np.array([view.found(side).blur_px for view in views])
        notes += [
            f"{view.name}: the {side} image is blurred (edges of {b:.1f} px, else {np.median(blur):.1f})"
            for view, b in zip(views, blur, strict=True)
            if b > _BLURRED * np.median(blur)
        ]
    for board in dict.fromkeys(view.board for view in views):
        if isinstance(board, ShapedBoard):
            height, plane = deviation_mm(board)
            notes.append(
                f"{board.stated}: shape measured: {1000 * height:.1f} µm from lowest to highest mark, "
                f"{1000 * plane:.1f} µm rms in its plane (the size is as stated)"
            )
    return tuple(notes)


def fit_of_view(view: StereoView, rig: StereoRig, left_from_board: FloatArray) -> ViewFit:
    """Residuals of a view whose board pose is known."""
    left, right = view.found("left"), view.found("right")
    in_left = apply(left_from_board, view.board.points_mm)
    in_right = apply(rig.right_from_left, in_left)
    return ViewFit(
        view,
        left_from_board,
        left.pixels - rig.left.project(in_left[left.ids]),
        right.pixels - rig.right.project(in_right[right.ids]),
    )


def epipolar_errors_px(rig: StereoRig, view: StereoView) -> FloatArray:
    """Rectified row differences (M,) of the marks seen in both images of a view."""
    _, left, right = marks_in_both(view)
    return row_difference_px(rig, left, right)


def marks_in_both(view: StereoView) -> tuple[IntArray, FloatArray, FloatArray]:
    """Ids (M,), left pixels (M, 2) and right pixels (M, 2) of the marks seen in both images."""
    left, right = view.found("left"), view.found("right")
    ids, in_left, in_right = np.intersect1d(left.ids, right.ids, return_indices=True)
    return ids, left.pixels[in_left], right.pixels[in_right]
