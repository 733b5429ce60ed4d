"""Estimation of a rig with given free parameters, and rejection of bad marks, bad views and camera movements.

Each mark is weighted by its own measured precision combined with a common model error, estimated from the
residuals, for what lens model, board and detector leave unexplained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, FloatArray, Side
from edged.errors import CalibrationError, Undetermined
from edged.vision.boards.board import StereoView
from edged.vision.calibration.bundle import (
    BundleResult,
    BundleState,
    LensFreedom,
    Observations,
    adjust,
    relation_information,
)
from edged.vision.calibration.initial import MIN_VIEWS
from edged.vision.calibration.params import CALIBRATION

Freedoms = tuple[LensFreedom, LensFreedom]


@dataclass(frozen=True, slots=True)
class CameraMovement:
    """Movement of one camera relative to the other between two views. since : the views used are older."""

    before: str
    after: str
    turn_deg: float
    shift_mm: float
    since: bool = False

    def __str__(self) -> str:
        return (
            f"a camera was moved between {self.before} and {self.after}: by about {self.turn_deg:.3f}° and "
            f"{self.shift_mm:.3f} mm against the other"
        )


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationProblem:
    """Views with the observations of their marks, without the outliers removed so far.

    movements : camera movements that bound the run of these views.
    """

    views: Sequence[StereoView]
    left: Observations
    right: Observations
    movements: tuple[CameraMovement, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationSolution:
    """Best estimate with these freedoms. model_error_px : of the left and the right camera."""

    problem: CalibrationProblem
    result: BundleResult
    model_error_px: tuple[float, float]
    freedoms: Freedoms


def estimate_cleaned(
    views: list[StereoView], state: BundleState, freedoms: Freedoms, excluded: list[tuple[str, str]]
) -> CalibrationSolution:
    """Estimate, removing views that contradict the others, one at a time, and outlying marks.

    If a camera moved, the views before or after the movement are used, whichever are more.
    excluded : name and reason of each view left out are appended.
    Raises `Undetermined`, and `CalibrationError` if views contradict each other, or a camera moved and no run
    of views suffices for a calibration.
    """
    while True:
        solution = estimate(problem_of(views), state, freedoms)
        cut = _movement(solution)
        if cut is not None:
            return _of_longest_run(solution, *cut, excluded)
        worst = _worst_view(solution)
        if worst is None:
            break
        index, residual, usual = worst
        excluded.append((views[index].name, f"residuals of {residual:.2f} px, usually {usual:.3f} px"))
        views = [view for i, view in enumerate(views) if i != index]
        if len(views) < MIN_VIEWS:
            raise CalibrationError(f"the views contradict each other: {excluded[-1][1]}", "contradiction")
        state = solution.result.state
        state = replace(state, left_from_board=np.delete(state.left_from_board, index, axis=0))
    return without_outliers(solution)


def problem_of(views: list[StereoView]) -> CalibrationProblem:
    """The problem with all marks of these views."""
    return CalibrationProblem(views, observations(views, "left"), observations(views, "right"))


def observations(views: Sequence[StereoView], side: Side) -> Observations:
    """All marks of the "left" or "right" images, with the sigmas from their own fits."""
    found = [view.found(side) for view in views]
    return Observations(
        np.concatenate([np.full(len(seen.ids), i, dtype=np.int64) for i, seen in enumerate(found)]),
        np.concatenate([v.board.points_mm[seen.ids] for v, seen in zip(views, found, strict=True)]),
        np.concatenate([seen.pixels for seen in found]),
        np.concatenate([seen.sigma_px for seen in found]),
    )


def estimate(problem: CalibrationProblem, state: BundleState, freedoms: Freedoms) -> CalibrationSolution:
    """Alternate between adjustment and estimation of the model error until the error converges."""
    errors = CALIBRATION.start_error_px, CALIBRATION.start_error_px
    try:
        for _ in range(CALIBRATION.estimate_rounds):
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
        raise Undetermined(
            "these views do not determine the cameras: the equations are singular", "undetermined"
        ) from error
    if not result.converged:
        raise Undetermined(
            "the bundle adjustment does not converge: these views contradict each other", "contradiction"
        )
    return CalibrationSolution(problem, result, errors, freedoms)


def without_outliers(solution: CalibrationSolution) -> CalibrationSolution:
    """Remove outlying marks and estimate again, repeatedly: without the worst, others stand out."""
    for _ in range(CALIBRATION.estimate_rounds):
        problem, result = solution.problem, solution.result
        kept_left = _inliers(problem.left, result.residuals_left_px, solution.model_error_px[0])
        kept_right = _inliers(problem.right, result.residuals_right_px, solution.model_error_px[1])
        if kept_left.all() and kept_right.all():
            break
        kept = replace(problem, left=_pick(problem.left, kept_left), right=_pick(problem.right, kept_right))
        solution = estimate(kept, result.state, solution.freedoms)
    return solution


def with_model_error(seen: Observations, error_px: float) -> Observations:
    """The marks with the common model error added to their own sigmas (root sum of squares)."""
    return replace(seen, sigma_px=np.hypot(seen.sigma_px, error_px))


def _pick(seen: Observations, kept: B8) -> Observations:
    shape = None if seen.shape is None else seen.shape[kept]
    return Observations(seen.view[kept], seen.points_mm[kept], seen.pixels[kept], seen.sigma_px[kept], shape)


def _inliers(seen: Observations, residuals: FloatArray, error_px: float) -> B8:
    return np.asarray(
        np.linalg.norm(residuals, axis=1) < CALIBRATION.outlier * np.hypot(seen.sigma_px, error_px)
    )


def _model_error(seen: Observations, residuals: FloatArray, share: float) -> float:
    """Error of one coordinate which, added to each mark's own sigma, gives chi² its expected value.

    share : degrees of freedom per measured value. Returns 0 if the marks' own sigmas explain everything.
    """
    squares = np.sum(residuals**2, axis=1)

    # clipped as in the robust loss, so that a few outliers do not set the scale
    def chi2(error: float) -> float:
        return float(np.minimum(squares / (seen.sigma_px**2 + error**2), 9.0).sum())

    target = 2 * len(squares) * share * 0.989  # E[min(r², 9)] / 2 of a two-dimensional normal distribution
    low, high = 0.0, float(np.sqrt(squares.max())) + 1e-9
    if chi2(0.0) <= target:
        return 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if chi2(middle) > target else (low, middle)
    return high


def _movement(solution: CalibrationSolution) -> tuple[int, CameraMovement] | None:
    """Detect a change of right_from_left that explains the residuals: number of views before it, and change.

    A likelihood ratio test over all positions at which the sequence of views can be cut.
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
    if not inner.size or inner.max() < CALIBRATION.moved_share * result.chi2:
        return None
    cut = 1 + int(np.argmax(inner))
    change = step_after[cut] - step_before[cut]
    turn, shift = np.degrees(np.linalg.norm(change[:3])), np.linalg.norm(change[3:])
    names = problem.views[cut].name, problem.views[cut + 1].name
    return cut + 1, CameraMovement(*names, float(turn), float(shift))


def _of_longest_run(
    solution: CalibrationSolution, cut: int, movement: CameraMovement, excluded: list[tuple[str, str]]
) -> CalibrationSolution:
    """Estimate from the views before or after a camera movement, whichever leaves more views.

    If both leave as many, the later ones: they show the cameras in their present position.
    """
    views, state = list(solution.problem.views), solution.result.state
    runs = list[tuple[int, CalibrationSolution, list[tuple[str, str]]]]()
    problems = list[CalibrationError]()
    for some, others, where in (
        (slice(cut, None), slice(cut), "before"),
        (slice(cut), slice(cut, None), "after"),
    ):
        left_out = [(view.name, f"taken {where} {movement}") for view in views[others]]
        begun = replace(state, left_from_board=state.left_from_board[some])
        try:
            if len(views[some]) < CALIBRATION.min_run:
                continue
            found = estimate_cleaned(views[some], begun, solution.freedoms, left_out)
        except CalibrationError as error:
            problems.append(error)
            continue
        movements = (*found.problem.movements, replace(movement, since=where == "after"))
        found = replace(found, problem=replace(found.problem, movements=movements))
        runs.append((len(found.problem.views), found, left_out))
    if not runs:
        for problem in problems:
            if isinstance(problem, Undetermined):
                raise problem
        raise CalibrationError(
            f"{movement}; take the views again without touching the cameras",
            "camera_moved",
            before=movement.before,
            after=movement.after,
        )
    _, found, left_out = max(runs, key=lambda run: run[0])  # the first, that is the later run, of equal ones
    excluded.extend(left_out)
    return found


def _worst_view(solution: CalibrationSolution) -> tuple[int, float, float] | None:
    """Index, residual and typical residual of the worst outlying view, if there is one.

    Views are judged by the median over their marks, so that a few wrong marks do not reject a view. Nor do
    residuals within `bad_view` times the marks' own precision, even if those of other views are smaller.
    """
    result, problem = solution.result, solution.problem
    view = np.concatenate([problem.left.view, problem.right.view])
    own = np.concatenate([problem.left.sigma_px, problem.right.sigma_px])
    length = np.linalg.norm(np.concatenate([result.residuals_left_px, result.residuals_right_px]), axis=1)
    members = [view == index for index in range(len(problem.views))]
    medians = np.array([np.median(length[member]) for member in members])
    explained = np.array([CALIBRATION.bad_view * np.median(own[member]) for member in members])
    typical = float(np.median(medians))
    excess = np.where(medians > explained, medians, 0.0)
    index = int(np.argmax(excess))
    return (index, float(medians[index]), typical) if excess[index] > CALIBRATION.bad_view * typical else None
