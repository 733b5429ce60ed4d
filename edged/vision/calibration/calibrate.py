"""Stereo calibration from views of known boards (paper, 3.1).

Initial values: Zhang's method for each camera (Z. Zhang, PAMI 2000, doi:10.1109/34.888718). Then one
bundle adjustment over everything (`edged.vision.calibration.bundle`). Each mark is weighted by its own
measured precision combined with a common model error, estimated from the residuals, for what lens
model, board and detector leave unexplained. Parameters that are often unnecessary (fx different from
fy, k3) are released only if the data demand it, and the lens model itself can be chosen by the views
(`edged.vision.calibration.lenschoice`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import I64, SIDES, FloatArray
from edged.vision.boards.board import ShapedBoard, StereoView
from edged.vision.boards.deformation import deviation_mm, plate_basis, shaped
from edged.vision.boards.params import DETECTION
from edged.vision.calibration.bundle import BundleState, Observations
from edged.vision.calibration.estimation import (
    CalibrationProblem,
    CalibrationSolution,
    CameraMovement,
    estimate,
    estimate_cleaned,
)
from edged.vision.calibration.initial import check_sides, resolve_orientation, usable_views, zhang
from edged.vision.calibration.lenschoice import (
    Choice,
    LensWeight,
    LensWish,
    basic_freedoms,
    check_determined,
    choose,
    release,
    rig_of,
    with_averaged_covariance,
)
from edged.vision.calibration.params import CALIBRATION
from edged.vision.geometry.camera import LensModel, StereoRig, calibration_identity
from edged.vision.geometry.rectification import row_difference_px
from edged.vision.geometry.rigid import apply


@dataclass(frozen=True, slots=True, eq=False)
class ViewFit:
    """How one view agrees with the calibration.

    view : the marks as measured, numbered as used in the adjustment.
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
    """A calibrated rig and its quality figures.

    Residuals are root mean squares over the marks of the 2D distance, as in OpenCV.
    epipolar_rms_px : row difference of rectified marks.
    model_error_px : (left, right), noise of one coordinate not explained by the marks' own precision.
    excluded : view name and reason.  notes : messages for the user.
    lenses : the models tried, best first; empty if one was stated.
    movements : camera movements between views; the views used are the longest run without one.
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
    lenses: tuple[LensWeight, ...] = ()
    movements: tuple[CameraMovement, ...] = ()


def calibrate_stereo(
    views: Sequence[StereoView],
    left_size: tuple[int, int],
    right_size: tuple[int, int],
    model: LensWish = "division",
    *,
    plate_shape: bool = False,
) -> Calibration:
    """Calibrate both cameras and right_from_left.

    left_size, right_size : (width, height) of the images.
    model : "auto" chooses the lens model from the views.
    plate_shape : also estimate the boards' shape (see `edged.vision.boards.deformation`).
    Unusable views are left out and named. Raises `CalibrationError` if no trustworthy
    calibration is possible: fewer than three usable pairs, parallel boards, swapped images, or
    a camera that moved so often that no run of views is left.
    """
    usable, excluded = usable_views(views)
    lens: LensModel = "brown" if model == "auto" else model
    left_camera, left_poses = zhang(usable, "left", left_size, lens)
    right_camera, right_poses = zhang(usable, "right", right_size, lens)
    usable, right_from_left, scatter = resolve_orientation(usable, left_poses, right_poses)
    check_sides(right_from_left, left_poses, scatter)
    state = BundleState(left_camera, right_camera, right_from_left, np.array(left_poses))
    if model == "auto":
        choice = choose(usable, state, excluded)
    else:
        solution = estimate_cleaned(usable, state, basic_freedoms(model), excluded)
        choice = Choice(release(solution), (), ())
    check_determined(choice.solution.result)
    if plate_shape:
        choice = replace(choice, solution=_with_shapes(choice.solution))
    return _summarise(choice, excluded)


def _with_shapes(solution: CalibrationSolution) -> CalibrationSolution:
    """Estimate again with the boards' shapes free; the resulting views hold the shaped boards."""
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

    prior_mm = DETECTION.prior_share * min(board.pitch_mm for board in boards)
    state = replace(state, shape=np.zeros(int(starts[-1])), shape_sigma=prior_mm)
    free = CalibrationProblem(problem.views, with_shape(problem.left), with_shape(problem.right))
    found = estimate(free, state, solution.freedoms)
    coefficients = found.result.state.shape
    new = [
        shaped(board, basis, coefficients[start:end])
        for board, basis, start, end in zip(boards, bases, starts, starts[1:], strict=False)
    ]
    views = [replace(view, board=new[number]) for view, number in zip(problem.views, which, strict=True)]
    return replace(found, problem=replace(problem, views=views))


# --- result -------------------------------------------------------------------------------------


def _rms(*residuals: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.concatenate(residuals) ** 2, axis=1))))


def _summarise(choice: Choice, excluded: list[tuple[str, str]]) -> Calibration:
    solution = choice.solution
    problem, result = solution.problem, solution.result
    rig = rig_of(result)
    identity = calibration_identity(rig.left, rig.right, rig.right_from_left)
    rig = with_averaged_covariance(
        replace(rig, calibration_id=identity), choice, _places(problem, result.state)
    )
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
        notes=_notes(problem.views) + _movement_notes(problem),
        lenses=choice.weights,
        movements=problem.movements,
    )


def _places(problem: CalibrationProblem, state: BundleState) -> FloatArray:
    """Positions of marks (N, 3) spread over the calibrated volume."""
    poses = zip(problem.views, state.left_from_board, strict=True)
    marks = np.concatenate([apply(pose, view.board.points_mm) for view, pose in poses])
    return np.asarray(
        marks[np.linspace(0, len(marks) - 1, min(len(marks), CALIBRATION.places)).astype(np.int64)]
    )


def _notes(views: Sequence[StereoView]) -> tuple[str, ...]:
    notes = []
    for side in SIDES:
        blur = np.array([view.found(side).blur_px for view in views])
        notes += [
            f"{view.name}: the {side} image is blurred (edges of {b:.1f} px, else {np.median(blur):.1f})"
            for view, b in zip(views, blur, strict=True)
            if b > CALIBRATION.blurred * np.median(blur)
        ]
    for board in dict.fromkeys(view.board for view in views):
        if isinstance(board, ShapedBoard):
            height, plane = deviation_mm(board)
            notes.append(
                f"{board.stated}: shape measured: {1000 * height:.1f} µm from lowest to highest mark, "
                f"{1000 * plane:.1f} µm rms in its plane (the size is as stated)"
            )
    return tuple(notes)


def _movement_notes(problem: CalibrationProblem) -> tuple[str, ...]:
    if not problem.movements:
        return ()
    run = f"calibrated from {problem.views[0].name} to {problem.views[-1].name} alone"
    stale = "; the rig is that of cameras which have moved since: take fresh views"
    return tuple(f"{movement}; {run}{stale if movement.since else ''}" for movement in problem.movements)


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


def marks_in_both(view: StereoView) -> tuple[I64, FloatArray, FloatArray]:
    """Ids (M,), left pixels (M, 2) and right pixels (M, 2) of the marks seen in both images."""
    left, right = view.found("left"), view.found("right")
    ids, in_left, in_right = np.intersect1d(left.ids, right.ids, return_indices=True)
    return ids, left.pixels[in_left], right.pixels[in_right]
