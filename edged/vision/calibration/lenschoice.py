"""Choice of the lens model from the views, and the effect of its uncertainty on the covariance.

The division model (one parameter), and Brown-Conrady with and without its tangential part, are adjusted to
the same marks with the same weights. They are compared by Akaike's criterion: a parameter must lower chi² by
more than noise would. The Akaike weights tell how certain the choice is. The covariance is the model-averaged
one about the chosen model, so that a model simpler than the lens does not make sigma too small.
The Bayesian criterion neglects small tangential parts, with errors of several sigma, as `tools/bench lens`
shows.

Sources: H. Akaike, IEEE TAC 1974, doi:10.1109/TAC.1974.1100705; K. P. Burnham and D. R. Anderson, "Model
Selection and Multimodel Inference", 2002, eq. 4.9.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.errors import Undetermined
from edged.vision.boards.board import StereoView
from edged.vision.calibration.bundle import BundleResult, BundleState, LensFreedom, adjust
from edged.vision.calibration.estimation import (
    CalibrationSolution,
    Freedoms,
    estimate,
    estimate_cleaned,
    with_model_error,
    without_outliers,
)
from edged.vision.calibration.params import CALIBRATION
from edged.vision.geometry.camera import DISTORTION_NAMES, CameraModel, LensModel, StereoRig
from edged.vision.geometry.rectification import can_be_rectified
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.geometry.uncertainty import shift_by_parameters

LensWish = Literal["auto", "division", "brown"]
"""A lens model, or "auto" to choose it from the views."""

_TANGENTIAL = ("p1", "p2")
_RELEASED = (*_TANGENTIAL, "k3")  # coefficients that are not always estimated


@dataclass(frozen=True, slots=True)
class LensWeight:
    """A model that was tried. name : "division", "brown" or "brown without p1, p2".

    aic : Akaike's criterion minus that of the best.  weight : its Akaike weight; they add up to 1.
    """

    name: str
    aic: float
    weight: float


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The solution with the chosen model. weights : of all models tried, best first.

    others : weight and result of the models not chosen.
    """

    solution: CalibrationSolution
    weights: tuple[LensWeight, ...]
    others: tuple[tuple[float, BundleResult], ...]


def choice_in_words(weights: Sequence[LensWeight]) -> str:
    """Sentence that states the chosen model and the weights of the others."""
    best, *others = weights
    against = ", ".join(f"{other.name} {100 * other.weight:.0f} %" for other in others)
    also = f" ({100 * best.weight:.0f} %; {against})" if others else ""
    return f"lens model chosen by the views: {best.name}{also}"


def basic_freedoms(model: LensModel) -> Freedoms:
    """Parameters of both lenses that are always estimated for a model."""
    basic = LensFreedom(True, tuple(name for name in DISTORTION_NAMES[model] if name != "k3"))
    return basic, basic


def freedom_of(camera: CameraModel) -> LensFreedom:
    """Parameters that were estimated for a camera, inferred from its values."""
    free = tuple(
        name
        for name, value in zip(DISTORTION_NAMES[camera.model], camera.distortion, strict=True)
        if name not in _RELEASED or value != 0.0
    )
    return LensFreedom(camera.fx == camera.fy, free)


def choose(views: list[StereoView], state: BundleState, excluded: list[tuple[str, str]]) -> Choice:
    """Choose the lens model from the views. state : with Brown-Conrady lenses.

    excluded : name and reason of each view left out are appended. Raises as `estimate_cleaned`.
    """
    richest = _richest(views, state, excluded)
    errors = richest.model_error_px
    left = with_model_error(richest.problem.left, errors[0])
    right = with_model_error(richest.problem.right, errors[1])
    begun, tried = richest.result.state, list[tuple[str, Freedoms, BundleResult]]()
    for name, freedoms in _candidates(richest):
        with contextlib.suppress(np.linalg.LinAlgError):
            result = adjust(_bound(begun, freedoms), left, right, *freedoms)
            tried.append((name, freedoms, result))
    # a polynomial may fold the image where no mark was seen: that is no lens, however well it fits
    tried = [attempt for attempt in tried if can_be_rectified(rig_of(attempt[2]))] or tried
    aic = _criteria([result for _, _, result in tried], [freedoms for _, freedoms, _ in tried])
    weights = np.exp(-0.5 * aic) / np.exp(-0.5 * aic).sum()
    best = int(np.argmin(aic))
    name, freedoms, result = tried[best]
    solution = richest
    if freedoms != richest.freedoms:
        solution = without_outliers(estimate(richest.problem, result.state, freedoms))
    choices = [
        LensWeight(name, float(a), float(w)) for (name, *_), a, w in zip(tried, aic, weights, strict=True)
    ]
    others = [(float(weight), attempt[2]) for weight, attempt in zip(weights, tried, strict=True)]
    del others[best]
    return Choice(
        solution,
        tuple(sorted(choices, key=lambda weight: weight.aic)),
        tuple(other for other in others if other[0] > CALIBRATION.min_weight),
    )


def _richest(
    views: list[StereoView], state: BundleState, excluded: list[tuple[str, str]]
) -> CalibrationSolution:
    """Solution with as many free parameters as the views determine."""
    full, division = basic_freedoms("brown"), basic_freedoms("division")
    for freedoms in (full, _without_tangential(full)):
        left_out = list[tuple[str, str]]()
        with contextlib.suppress(Undetermined):
            solution = release(estimate_cleaned(views, state, freedoms, left_out))
            check_determined(solution.result)
            excluded.extend(left_out)
            return solution
    return release(estimate_cleaned(views, _bound(state, division), division, excluded))


def _candidates(richest: CalibrationSolution) -> list[tuple[str, Freedoms]]:
    """Name and freedoms of the richest solution and of the simpler models."""
    left, right = richest.freedoms
    names = DISTORTION_NAMES["division"]
    if left.distortion == names:
        return [("division", richest.freedoms)]
    simpler = _without_tangential(richest.freedoms)
    return [
        *([] if simpler == richest.freedoms else [("brown", richest.freedoms)]),
        ("brown without p1, p2", simpler),
        ("division", (replace(left, distortion=names), replace(right, distortion=names))),
    ]


def _without_tangential(freedoms: Freedoms) -> Freedoms:
    left, right = (
        replace(freedom, distortion=tuple(name for name in freedom.distortion if name not in _TANGENTIAL))
        for freedom in freedoms
    )
    return left, right


def _bound(state: BundleState, freedoms: Freedoms) -> BundleState:
    """The state with lenses restricted to these freedoms, and all other coefficients zero."""
    left, right = (
        _of_freedom(camera, freedom)
        for camera, freedom in zip((state.left, state.right), freedoms, strict=True)
    )
    return replace(state, left=left, right=right)


def _of_freedom(camera: CameraModel, freedom: LensFreedom) -> CameraModel:
    if camera.model == "brown" and freedom.distortion == DISTORTION_NAMES["division"]:
        # to first order both models are the same: r (1 + k1 r²) and r (1 + kappa r²)
        return replace(camera, model="division", distortion=camera.distortion[:1])
    pairs = zip(DISTORTION_NAMES[camera.model], camera.distortion, strict=True)
    return replace(camera, distortion=tuple(v if n in freedom.distortion else 0.0 for n, v in pairs))


def _criteria(results: Sequence[BundleResult], freedoms: Sequence[Freedoms]) -> FloatArray:
    """Akaike's criterion of each, minus the least. The noise is estimated from the best fit."""
    least, freedom = min((result.chi2, result.freedom) for result in results)
    floor = CALIBRATION.no_noise * freedom
    aic = [
        freedom * np.log((result.chi2 + floor) / (least + floor)) + 2 * (left.count + right.count)
        for result, (left, right) in zip(results, freedoms, strict=True)
    ]
    return np.asarray(np.array(aic) - min(aic))


# --- model-averaged covariance -------------------------------------------------------------------


def with_averaged_covariance(rig: StereoRig, choice: Choice, points_mm: FloatArray) -> StereoRig:
    """The rig with the model-averaged covariance about the chosen model.

    points_mm (N, 3) : points spread over the volume. As models have different parameters, another model's
    positions of these points and their covariance are expressed by the changes of the chosen model's
    parameters that move the points most nearly alike.
    """
    if rig.covariance is None or not choice.others:
        return rig
    selection = selection_of(rig)
    shift = (shift_by_parameters(rig, points_mm) @ selection).reshape(-1, selection.shape[1])
    scale = 1 / np.linalg.norm(shift, axis=0)
    as_parameters = selection @ (scale[:, None] * np.linalg.pinv(shift * scale, rcond=CALIBRATION.blind))
    pixels = rig.left.project(points_mm), rig.right.project(apply(rig.right_from_left, points_mm))
    covariance = (1 - sum(weight for weight, _ in choice.others)) * rig.covariance
    for weight, result in choice.others:
        other = rig_of(result)
        moved = as_parameters @ (triangulate_raw(other, *pixels) - points_mm).ravel()
        carried = as_parameters @ shift_by_parameters(other, points_mm).reshape(shift.shape[0], -1)
        covariance = covariance + weight * (np.outer(moved, moved) + carried @ result.covariance @ carried.T)
    return replace(rig, covariance=covariance)


def selection_of(rig: StereoRig) -> FloatArray:
    """(P, F) matrix from the estimated parameters of a rig to `rig.parameter_names`."""
    left, right = (freedom_of(camera).selection(camera) for camera in (rig.left, rig.right))
    selection = np.zeros((len(rig.parameter_names), left.shape[1] + right.shape[1] + 6))
    selection[: left.shape[0], : left.shape[1]] = left
    selection[left.shape[0] : -6, left.shape[1] : -6] = right
    selection[-6:, -6:] = np.eye(6)
    return selection


# --- release of further parameters ---------------------------------------------------------------


def release(solution: CalibrationSolution) -> CalibrationSolution:
    """Estimate fx and fy separately, and k3, where the data contradict the simpler lens."""
    for index, side in enumerate(SIDES):
        freedom = solution.freedoms[index]
        trials = [replace(freedom, square_pixels=False)]
        if "k1" in freedom.distortion:
            trials.append(replace(freedom, distortion=(*freedom.distortion, "k3")))
        for trial in trials:
            freedoms = (trial, solution.freedoms[1]) if index == 0 else (solution.freedoms[0], trial)
            freer = estimate(solution.problem, solution.result.state, freedoms)
            if _significance(freer.result, side, trial, freedom) > CALIBRATION.release_t:
                solution, freedom = freer, trial
                trials[-1] = replace(trials[-1], square_pixels=freedom.square_pixels)
    return solution


def _significance(result: BundleResult, side: Side, trial: LensFreedom, before: LensFreedom) -> float:
    """|value| / sigma of the parameter released in `trial`."""
    rig = rig_of(result)
    names = list(rig.parameter_names)
    camera = rig.camera(side)
    weights = np.zeros(len(names))
    if trial.square_pixels != before.square_pixels:
        value = camera.fx - camera.fy
        weights[names.index(f"{side}.fx")], weights[names.index(f"{side}.fy")] = 1, -1
    else:
        value = camera.distortion[4]
        weights[names.index(f"{side}.k3")] = 1
    return abs(value) / float(np.sqrt(weights @ result.covariance @ weights))


def check_determined(result: BundleResult) -> None:
    """Raise `Undetermined` if a focal length is not determined."""
    rig = rig_of(result)
    sigma = np.sqrt(np.diag(result.covariance))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        relative = sigma[rig.parameter_names.index(f"{side}.fx")] / camera.fx
        if not relative < CALIBRATION.max_focal_sigma or camera.fx <= 0 or camera.fy <= 0:
            raise Undetermined(
                f"{side} camera: these views do not determine its focal length (sigma "
                f"{100 * relative:.1f} %); tilt the board by 20° to 40° in different directions and fill the "
                "image",
                "undetermined",
            )


def rig_of(result: BundleResult) -> StereoRig:
    """The rig of a result, without a calibration id."""
    state = result.state
    return StereoRig(state.left, state.right, state.right_from_left, "", covariance=result.covariance)
