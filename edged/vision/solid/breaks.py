"""A body laid on the pair that a part was taught from, and the edge breaks that its file does not know.

Which width is right cannot be told by the share of edges that are found: with no breaks a model of a broken
part agreed by 0.93, half a millimetre off. It is told by the profiles, which see both edges of a break apart
or together: the pose and the widths of all curves are fitted from several common widths, and those that leave
the profiles least misfit are taken. Breaks are believed where they lessen it by a share, of the whole part
and of each curve.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.part.job import Job
from edged.vision.solid.curvemodel import curve_model, has_enough_curves
from edged.vision.solid.edgemodel import EdgeModel, with_open_forms
from edged.vision.solid.evidence import PoseEvidence, evidence_of, margin_over, sigmas_of
from edged.vision.solid.lock import Pyramids, lay, scale_at
from edged.vision.solid.params import BREAKS, DECISION, PROFILE
from edged.vision.solid.profiles import ProfileFit, best_fit, fit_profiles, profiles_of


@dataclass(frozen=True, slots=True, eq=False)
class LaidBody:
    """A body on a pair: the model with its breaks, and its fit.

    sigma_break_mm : of the widths.  merged_mm : of narrower ones the pair does not show the form.
    evidence : what the pair says for it.
    """

    model: EdgeModel
    fit: ProfileFit
    sigma_break_mm: float
    merged_mm: float
    evidence: PoseEvidence


def lay_with_breaks(images: StereoImages, model: EdgeModel, pose: FloatArray) -> LaidBody | None:
    """Lay a model on a pair from rig_from_part (4, 4), good to a millimetre, and find its edge breaks.

    None where the pair does not show it there.
    """
    pyramids = Pyramids(images.rig, images.raw, BREAKS.levels)
    best: tuple[float, _Refined] | None = None
    for width in BREAKS.tried_mm:
        broken = with_breaks(model, np.full(len(model.start), width))
        laid = lay(broken, pyramids, pose, BREAKS.steps)
        found = None if laid is None else _refined(broken, pyramids, images, laid.pose)
        if found is None:
            continue
        # a model with breaks can take the form of one without: it has to be better to be believed
        cost = found.misfit_px * (1.0 if width == 0 else 1.0 + BREAKS.better)
        if best is None or cost < best[0]:
            best = cost, found
    if best is None:
        return None
    found = best[1]
    if found.model.breaks_mm.any():
        found = _each_by_itself(found, pyramids, images)
    merged_mm = BREAKS.form_px / scale_at(images.rig, found.pose, model)
    laid_model = with_open_forms(found.model, merged_mm)
    fit = best_fit(laid_model, pyramids, images, found.pose)
    if fit is None:
        return None
    evidence = evidence_of(laid_model, pyramids, fit.pose)
    # another light moves the seen ends of a break against each other
    by_light_mm = PROFILE.light_px / scale_at(images.rig, fit.pose, model) if found.sigma_break_mm else 0.0
    sigma_break_mm = math.hypot(found.sigma_break_mm, 2 * by_light_mm)
    return LaidBody(laid_model, fit, sigma_break_mm, merged_mm, evidence)


def shown_break(images: StereoImages, job: Job) -> float | None:
    """Width of the edge breaks of a job's part, mm, by the pair that it was taught from alone.

    Face-on, a break shows both of its edges here and there. None where it does not, or there is none.
    """
    if not has_enough_curves(job):
        return None
    pyramids = Pyramids(images.rig, images.raw, 1)
    px_per_mm = images.rig.left.fx / float(job.rig_from_part[2, 3])
    widths = np.arange(BREAKS.apart_px, BREAKS.widest_mm * px_per_mm, 0.5) / px_per_mm
    gains = np.zeros(len(widths))
    for k, width in enumerate(widths):
        seen = evidence_of(curve_model(job, float(width)), pyramids, job.rig_from_part)
        beside = seen.curve % 3 == 2
        # where the wall is seen its foot is as good an edge: where it is not, there must be some, too
        if float(seen.log_ratio(beside & ~seen.walled, BREAKS.shown_far).sum()) <= 0:
            continue
        for shown in BREAKS.shown:
            ratios = seen.log_ratio(beside, shown)
            if sigmas_of(ratios) > DECISION.certain:
                gains[k] = max(gains[k], float(ratios.sum()))
    if not gains.any():
        return None
    best = int(gains.argmax())
    near = slice(max(best - 2, 0), best + 3)
    width = float(np.average(widths[near], weights=gains[near]))
    model = curve_model(job, width)
    for _ in range(BREAKS.rounds):
        own, _ = _widths(model, pyramids, images, job.rig_from_part)
        width = float(np.median(own))
        model = curve_model(job, width)
    return float(round(width, 4))


@dataclass(frozen=True, slots=True, eq=False)
class _Refined:
    """A model with its own breaks at a pose.  misfit_px : rms of all profiles, each at most a pixel."""

    model: EdgeModel
    pose: FloatArray
    sigma_break_mm: float
    misfit_px: float


def _refined(model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray) -> _Refined | None:
    """The pose and the breaks in turn, from breaks of one width."""
    sigma = 0.0
    for _ in range(BREAKS.rounds if model.breaks_mm.any() else 1):
        fit = fit_profiles(model, pyramids, images, pose, BREAKS.blur_px, alike=True)
        if fit is None:
            return None
        pose = fit.pose
        if model.breaks_mm.any():
            widths, sigma = _widths(model, pyramids, images, pose)
            model = with_breaks(model, widths)
    if model.breaks_mm.any():
        model = _without_needless(model, pyramids, images, pose)
    misfit = _misfits(model, pyramids, images, pose)
    if not len(misfit[0]):
        return None
    return _Refined(model, pose, sigma, float(np.sqrt(np.mean(misfit[1]))))


def _each_by_itself(found: _Refined, pyramids: Pyramids, images: StereoImages) -> _Refined:
    """The breaks anew, each curve's width from a grid and by itself, in turn with the pose.

    No rounded or glinting one pulls the others off any more: a fit weighs each by its own scatter.
    """
    model, pose, sigma = found.model, found.pose, found.sigma_break_mm
    for _ in range(BREAKS.rounds):
        fit = fit_profiles(model, pyramids, images, pose, BREAKS.blur_px)
        if fit is None:
            return found
        pose = fit.pose
        widths = _likeliest_widths(model, pyramids, images, pose)
        widths, sigma = _widths(with_breaks(model, widths), pyramids, images, pose)
        model = with_breaks(model, widths)
    return replace(found, model=model, pose=pose, sigma_break_mm=sigma)


def _likeliest_widths(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray
) -> FloatArray:
    """(E,) the width of a grid that each curve's profiles fit best; 0 where none explains them as well."""
    count = int(model.chain.max()) + 1
    costs = np.ones((len(BREAKS.grid_mm), count))
    for k, width in enumerate(BREAKS.grid_mm):
        costs[k] = _mean_misfits(with_breaks(model, np.full(len(model.start), width)), pyramids, images, pose)
    best = np.where(_are_needed(costs.min(axis=0), costs[0]), costs.argmin(axis=0), 0)
    return np.array(BREAKS.grid_mm)[best][model.chain]


def _misfits(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Of each profile its curve (M,), and its square misfit (M,) px², at most 1."""
    profiles = profiles_of(model, pyramids, images, pose, BREAKS.blur_px)
    good = profiles.weight > BREAKS.min_weight
    return profiles.seen.curve // 3, np.where(good, np.minimum(profiles.shift_px**2, 1.0), 1.0)


def _without_needless(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray
) -> EdgeModel:
    """The model without the breaks of curves that a sharp edge explains as well."""
    sharp = with_breaks(model, np.zeros(len(model.start)))
    with_own, without = (_mean_misfits(variant, pyramids, images, pose) for variant in (model, sharp))
    return with_breaks(model, np.where(_are_needed(with_own, without)[model.chain], model.breaks_mm, 0.0))


def _are_needed(with_own: FloatArray, without: FloatArray) -> npt.NDArray[np.bool_]:
    """(C,) of which curves the breaks must be believed: two edges can take the form of one."""
    return np.asarray(with_own < without * (1 - BREAKS.better))


def _mean_misfits(model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray) -> FloatArray:
    """(C,) mean square misfit of each curve's profiles, px²; 1 of one without any."""
    curve, square = _misfits(model, pyramids, images, pose)
    count = int(model.chain.max()) + 1
    many = np.bincount(curve, minlength=count)
    return np.where(many > 0, np.bincount(curve, square, minlength=count) / np.maximum(many, 1), 1.0)


def likeliest(images: StereoImages, model: EdgeModel, poses: Sequence[FloatArray]) -> int | None:
    """Which of several rig_from_part (4, 4), good to a millimetre, a pair shows; None: it does not tell."""
    pyramids = Pyramids(images.rig, images.raw, BREAKS.levels)
    model = with_breaks(model, np.full(len(model.start), BREAKS.usual_mm))
    laid = [lay(model, pyramids, pose, BREAKS.steps) for pose in poses]
    seen = {k: evidence_of(model, pyramids, trial.pose) for k, trial in enumerate(laid) if trial is not None}
    shapes = [image.shape for image in images.raw]
    for k, mine in seen.items():
        if all(margin_over(mine, other, shapes) > DECISION.certain for j, other in seen.items() if j != k):
            return k
    return None


def with_breaks(model: EdgeModel, widths_mm: FloatArray) -> EdgeModel:
    """The model with edge breaks of widths (E,) at its sharp outer edges."""
    widths = np.where(model.breakable, np.clip(widths_mm, 0.0, BREAKS.most_mm), 0.0)
    return replace(model, breaks_mm=np.where(widths < BREAKS.least_mm, 0.0, widths))


def _widths(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray
) -> tuple[FloatArray, float]:
    """Widths (E,) of the breaks by the profiles at a pose, each curve's own, and their sigma."""
    profiles = profiles_of(model, pyramids, images, pose, BREAKS.blur_px)
    curve, by_break = profiles.seen.curve // 3, profiles.seen.by_break
    shift, base = profiles.shift_px, profiles.weight
    weight = np.where(
        (np.abs(by_break) > 0) & (base > BREAKS.min_weight),
        1 / (1 / np.maximum(base, 1e-9) + BREAKS.model_px**2),
        0.0,
    )
    used = weight > 0
    if used.any():
        weight *= tukey_weights(shift, max(mad_sigma(shift[used]), BREAKS.min_sigma_px))
    widths = model.breaks_mm.copy()
    number = model.chain
    power = np.bincount(curve, weight * by_break**2, minlength=number.max() + 1) / BREAKS.correlated
    pull = np.bincount(curve, weight * by_break * shift, minlength=number.max() + 1) / BREAKS.correlated
    # those of a part are mostly alike
    common = float(pull.sum() / max(power.sum(), 1e-9))
    own = (pull + common * BREAKS.alike_mm**-2) / (power + BREAKS.alike_mm**-2)
    widths += np.where(widths > 0, own[number], 0.0)
    sigma = (
        float(np.median(1 / np.sqrt(power[power > 0] + BREAKS.alike_mm**-2)))
        if (power > 0).any()
        else BREAKS.alike_mm
    )
    return widths, sigma
