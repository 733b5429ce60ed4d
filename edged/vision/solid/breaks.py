"""Fit a body to the pair that a part was taught from, and find the edge breaks that its file does not have.

The share of edges found does not show which width is right: without breaks, a model of a broken part agreed
by 0.93, half a millimetre off. The profiles do, since they show both edges of a break apart or together: the
pose and the widths of all curves are fitted from several common widths, and the fit with the smallest
residuals of the same profiles is taken. Breaks are accepted if they leave at most half of what sharp edges
do, or somewhat more with a smaller misfit. Breaks as bright as the faces hide: the part then lies higher than
its edges say, by up to their width, and the sigma contains by how much.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, transform, turn_between
from edged.vision.kernels.jit import for_each
from edged.vision.solid.bestfit import ProfileFit, best_fit
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.evidence import PoseEvidence, evidence_of, margin_over
from edged.vision.solid.forms import (
    PosedPair,
    RefinedForm,
    refined,
    twist_between,
    widths_by_profiles,
    with_breaks,
)
from edged.vision.solid.lock import Pyramids, lay, scale_at
from edged.vision.solid.params import BREAKS, DECISION, PROFILE, PROFILE_RESIDUALS
from edged.vision.solid.profileresiduals import Gain, ProfileResiduals


@dataclass(frozen=True, slots=True, eq=False)
class FittedBody:
    """A body fitted to a pair: the model with its breaks, and its fit.

    sigma_break_mm : of the widths.  merged_mm : width below which the pair does not show the form of a break.
    evidence : of the pair for it.  hidden (6, 6) : covariance of the twist, as in `ProfileFit`, by other
    breaks, or ones that the pair may hide.  is_certain : whether it shows breaks.  contradicts : as in
    `RefinedForm`.
    """

    model: EdgeModel
    fit: ProfileFit
    sigma_break_mm: float
    merged_mm: float
    evidence: PoseEvidence
    hidden: FloatArray
    is_certain: bool
    contradicts: float

    @property
    def sigma_hidden_mm(self) -> float:
        """Sigma of the place by breaks that the pair may hide."""
        return math.sqrt(float(np.trace(self.hidden[3:, 3:])))


def lay_with_breaks(images: StereoImages, model: EdgeModel, pose: FloatArray) -> FittedBody | None:
    """Fit a model to a pair from rig_from_part (4, 4), good to a millimetre, and find its edge breaks.

    None where the pair does not show it there.
    """
    pyramids = Pyramids(images.rig, images.raw, BREAKS.levels)

    def forms_of(width_mm: float) -> list[RefinedForm]:
        """The form from breaks of one width, at each pose that they are locked at."""
        broken = with_breaks(model, width_mm)
        starts = starts_of_breaks(pose, width_mm)
        tried = [refined(broken, [view]) for view in _laid_from(starts, broken, images, pyramids)]
        return [form for form in tried if form is not None]

    forms = list(itertools.chain(*for_each(forms_of, BREAKS.tried_mm)))
    if not forms:
        return None
    shown = _explaining_most(forms)
    found = shown.form
    pose = found.views[0].pose
    merged_mm = BREAKS.form_px / scale_at(images.rig, pose, model)
    laid_model = replace(found.model, merged_mm=merged_mm)
    fit = best_fit(laid_model, pyramids, images, pose)
    if fit is None:
        return None
    evidence = evidence_of(laid_model, pyramids, fit.pose)
    # other light moves the two visible ends of a break against each other
    by_light_mm = PROFILE.light_px / scale_at(images.rig, fit.pose, model) if found.sigma_mm else 0.0
    sigma_break_mm = math.hypot(found.sigma_mm, 2 * by_light_mm)
    return FittedBody(
        laid_model,
        fit,
        sigma_break_mm,
        merged_mm,
        evidence,
        shown.hidden,
        shown.is_certain,
        found.contradicts,
    )


def starts_of_breaks(pose: FloatArray, width_mm: float) -> list[FloatArray]:
    """Possible poses of a model with breaks of one width: as given, and higher by that width.

    The lower edges of breaks have the model's radii: curves that were taught by them lie a width below where
    the model has them, and nothing else shows it.
    """
    return [pose, pose @ transform(np.eye(3), np.array([0.0, 0.0, -width_mm]))]


def _laid_from(
    starts: Sequence[FloatArray], model: EdgeModel, images: StereoImages, pyramids: Pyramids
) -> list[PosedPair]:
    """The pair at each of the different poses that a model is locked at from several starts."""
    found: list[PosedPair] = []
    for start in starts:
        laid = lay(model, pyramids, start, BREAKS.steps)
        if laid is not None and not any(_is_same(model, laid.pose, other.pose) for other in found):
            found.append(PosedPair(images, pyramids, laid.pose))
    return found


def _is_same(model: EdgeModel, pose: FloatArray, other: FloatArray) -> bool:
    apart = float(np.linalg.norm(apply(pose, model.centre) - apply(other, model.centre)))
    return apart < BREAKS.least_mm and turn_between(pose, other) * model.size_mm < BREAKS.least_mm


def _cost(form: RefinedForm) -> float:
    """Cost of a form, px; raised for breaks, since a model with them can imitate one without."""
    share = 1.0 + BREAKS.better_whole if form.model.breaks_mm.any() else 1.0
    return share * math.sqrt(form.cost)


def _with_most(form: RefinedForm) -> RefinedForm:
    """Give all curves of a form the median width of its breaks, if that explains more.

    Breaks of a part are mostly alike; breaks at only half of the curves explain less, and the curves without
    them keep the pose from moving to the right one.
    """
    width = float(np.median(form.model.breaks_mm[form.model.breaks_mm > 0]))
    again = refined(with_breaks(form.model, width), form.views)
    return form if again is None else min(form, again, key=_cost)


@dataclass(frozen=True, slots=True, eq=False)
class _ShownBreaks:
    """The form that explains most; `hidden` and `is_certain` as in `FittedBody`."""

    form: RefinedForm
    hidden: FloatArray
    is_certain: bool


def _explaining_most(forms: Sequence[RefinedForm]) -> _ShownBreaks:
    """The form with the smallest residuals of the profiles, with each curve's own break width.

    A form without breaks fits one edge of each well, and its own profiles do not show the other edge: so all
    forms are compared on the same profiles. But two steps explain more of any profile than one, so breaks
    must halve the residual, or take a smaller part of it and also reduce the misfit. What else may be there
    is in `hidden`: other breaks that take about as much, and breaks or none where they take less than half.
    """
    sharp = min(forms, key=lambda form: (form.model.breaks_mm.any(), _cost(form)))
    leaves = ProfileResiduals.of(with_breaks(sharp.model, 0.0), sharp.views)
    found, best = sharp, Gain(0.0, 0.0, np.zeros(0))
    likely = sorted(forms, key=lambda form: -leaves.roughly(form.model, form.views))[: BREAKS.kept]
    broken = [form for form in likely if form.model.breaks_mm.any()]
    tried = for_each(lambda form: _with_gain(_each_by_itself(_with_most(form), leaves), leaves), broken)
    for form, (own, gain) in zip(broken, tried, strict=True):
        shifts_less = gain.mean > 0.5 * PROFILE_RESIDUALS.least_gain and _cost(form) < _cost(sharp)
        if (gain.is_certain or shifts_less) and gain.mean > best.mean:
            found, best = own, gain
    if found is sharp:
        others = [(form, _chance_of(gain)) for form, gain in tried]
    else:
        others = [(form, _as_likely(gain, best)) for form, gain in tried]
        others += [] if best.is_certain else [(sharp, _chance_of(best))]
    hidden = [np.zeros((6, 6))]
    for form, chance in others:
        twist = twist_between(found.model, found.views[0].pose, form.views[0].pose)
        hidden.append(chance * np.outer(twist, twist))
    return _ShownBreaks(found, max(hidden, key=np.trace), best.is_certain)


def _with_gain(form: RefinedForm, leaves: ProfileResiduals) -> tuple[RefinedForm, Gain]:
    return form, leaves.gain(form.model, form.views)


def _chance_of(gain: Gain) -> float:
    """Probability of breaks that are not believed: by how much they take, at most as likely as none."""
    if gain.sigmas < PROFILE_RESIDUALS.least_sigmas:
        return 0.0
    return 0.5 * min(max(gain.mean / PROFILE_RESIDUALS.least_gain, 0.0), 1.0)


def _as_likely(gain: Gain, best: Gain) -> float:
    """Probability that breaks of less gain are the right ones, by the scatter of the gain over curves."""
    return 0.5 * math.exp(-0.5 * (best.sigmas * (1.0 - gain.mean / best.mean)) ** 2)


def _each_by_itself(found: RefinedForm, leaves: ProfileResiduals) -> RefinedForm:
    """Fit the breaks again, each curve's width by itself from a grid, in turn with the poses.

    A rounded or glinting curve no longer pulls the others off: the fit weights each by its own scatter.
    """
    for _ in range(BREAKS.rounds):
        after = [view.fitted(found.model) for view in found.views]
        views = tuple(view for view in after if view is not None)
        if len(views) < len(found.views):
            return found
        model = with_breaks(found.model, _likeliest_widths(found.model, views, leaves))
        widths, sigma, _ = widths_by_profiles(model, views)
        found = replace(found, model=with_breaks(model, widths), views=views, sigma_mm=sigma)
    return found


def _likeliest_widths(model: EdgeModel, views: Sequence[PosedPair], leaves: ProfileResiduals) -> FloatArray:
    """(E,) width of the grid with the smallest residuals for each curve; 0 where none is clearly better."""
    gains = [leaves.gains(with_breaks(model, mm), views, PROFILE_RESIDUALS.blurs_px) for mm in BREAKS.grid_mm]
    by_curve = np.array([leaves.by_curve(np.nan_to_num(gain)) for gain in gains])
    needed = by_curve.max(axis=0) > by_curve[0] + PROFILE_RESIDUALS.doubt
    best = np.where(needed, by_curve.argmax(axis=0), 0)
    return np.array(BREAKS.grid_mm)[best][model.chain]


def likeliest(images: StereoImages, model: EdgeModel, poses: Sequence[FloatArray]) -> int | None:
    """Which of several rig_from_part (4, 4), good to a millimetre, a pair shows; None if it is not clear."""
    pyramids = Pyramids(images.rig, images.raw, BREAKS.levels)
    model = with_breaks(model, BREAKS.usual_mm)
    laid = [lay(model, pyramids, pose, BREAKS.steps) for pose in poses]
    seen = {k: evidence_of(model, pyramids, trial.pose) for k, trial in enumerate(laid) if trial is not None}
    for k, mine in seen.items():
        if all(margin_over(mine, other) > DECISION.certain for j, other in seen.items() if j != k):
            return k
    return None
