"""A body laid on the pair that a part was taught from, and the edge breaks that its file does not know.

Which width is right cannot be told by the share of edges that are found: with no breaks a model of a broken
part agreed by 0.93, half a millimetre off. It is told by the profiles, which see both edges of a break apart
or together: the pose and the widths of all curves are fitted from several common widths, and those are taken
that leave least of the same profiles. Breaks are believed where they leave half of what sharp edges do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, transform, turn_between
from edged.vision.solid.bestfit import ProfileFit, best_fit
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.evidence import PoseEvidence, evidence_of, margin_over
from edged.vision.solid.forms import (
    LaidPair,
    RefinedForm,
    refined,
    widths_by_profiles,
    with_breaks,
)
from edged.vision.solid.leavings import Leavings
from edged.vision.solid.lock import Pyramids, lay, scale_at
from edged.vision.solid.params import BREAKS, DECISION, LEAVINGS, PROFILE


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
    forms: list[RefinedForm] = []
    for width in BREAKS.tried_mm:
        broken = with_breaks(model, width)
        tried = [
            refined(broken, [view]) for view in _laid_from(_starts(pose, width), broken, images, pyramids)
        ]
        forms += [form for form in tried if form is not None]
    if not forms:
        return None
    found = _explaining_most(forms)
    pose = found.views[0].pose
    merged_mm = BREAKS.form_px / scale_at(images.rig, pose, model)
    laid_model = replace(found.model, merged_mm=merged_mm)
    fit = best_fit(laid_model, pyramids, images, pose)
    if fit is None:
        return None
    evidence = evidence_of(laid_model, pyramids, fit.pose)
    # another light moves the seen ends of a break against each other
    by_light_mm = PROFILE.light_px / scale_at(images.rig, fit.pose, model) if found.sigma_mm else 0.0
    sigma_break_mm = math.hypot(found.sigma_mm, 2 * by_light_mm)
    return LaidBody(laid_model, fit, sigma_break_mm, merged_mm, evidence)


def _starts(pose: FloatArray, width_mm: float) -> list[FloatArray]:
    """Where a model with breaks of one width may lie: as given, and higher by that width.

    The lower edges of breaks have the model's radii: where curves were taught by those, they lie a width
    below where the model has them, and nothing about them says so.
    """
    return [pose, pose @ transform(np.eye(3), np.array([0.0, 0.0, -width_mm]))]


def _laid_from(
    starts: Sequence[FloatArray], model: EdgeModel, images: StereoImages, pyramids: Pyramids
) -> list[LaidPair]:
    """The pair at the poses that a model comes to from several starts, each once."""
    found: list[LaidPair] = []
    for start in starts:
        laid = lay(model, pyramids, start, BREAKS.steps)
        if laid is not None and not any(_is_same(model, laid.pose, other.pose) for other in found):
            found.append(LaidPair(images, pyramids, laid.pose))
    return found


def _is_same(model: EdgeModel, pose: FloatArray, other: FloatArray) -> bool:
    apart = float(np.linalg.norm(apply(pose, model.centre) - apply(other, model.centre)))
    return apart < BREAKS.least_mm and turn_between(pose, other) * model.size_mm < BREAKS.least_mm


def _cost(form: RefinedForm) -> float:
    """What a form leaves, in px; with breaks a model can take the form of one without."""
    share = 1.0 + BREAKS.better_whole if form.model.breaks_mm.any() else 1.0
    return share * math.sqrt(form.cost)


def _with_most(form: RefinedForm) -> RefinedForm:
    """A form with the breaks of most of its curves at all of them, where they explain more.

    Those of a part are mostly alike: half of them explain less, and hold a pose where it is.
    """
    width = float(np.median(form.model.breaks_mm[form.model.breaks_mm > 0]))
    again = refined(with_breaks(form.model, width), form.views)
    return form if again is None else min(form, again, key=_cost)


def _explaining_most(forms: Sequence[RefinedForm]) -> RefinedForm:
    """The form that leaves least of the profiles, each curve's breaks by themselves.

    One without breaks lies well on one end of each, and no profile of its own tells of the other end: the
    same profiles are asked of all. But two steps take more of any profile than one does, so breaks must take
    half of what is left, or less of it and lessen the misfit.
    """
    sharp = min(forms, key=lambda form: (form.model.breaks_mm.any(), _cost(form)))
    leaves = Leavings.of(with_breaks(sharp.model, 0.0), sharp.views)
    found, gained = sharp, 0.0
    for form in sorted(forms, key=lambda form: -leaves.roughly(form.model, form.views))[: BREAKS.kept]:
        if form.model.breaks_mm.any():
            own = _each_by_itself(_with_most(form), leaves)
            gain = leaves.gain(own.model, own.views)
            shifts_less = gain.mean > 0.5 * LEAVINGS.least_gain and _cost(form) < _cost(sharp)
            if (gain.is_certain or shifts_less) and gain.mean > gained:
                found, gained = own, gain.mean
    return found


def _each_by_itself(found: RefinedForm, leaves: Leavings) -> RefinedForm:
    """The breaks anew, each curve's width from a grid and by itself, in turn with the poses.

    No rounded or glinting one pulls the others off any more: a fit weighs each by its own scatter.
    """
    for _ in range(BREAKS.rounds):
        after = [view.fitted(found.model, alike=False) for view in found.views]
        views = tuple(view for view in after if view is not None)
        if len(views) < len(found.views):
            return found
        model = with_breaks(found.model, _likeliest_widths(found.model, views, leaves))
        widths, sigma, _ = widths_by_profiles(model, views)
        found = replace(found, model=with_breaks(model, widths), views=views, sigma_mm=sigma)
    return found


def _likeliest_widths(model: EdgeModel, views: Sequence[LaidPair], leaves: Leavings) -> FloatArray:
    """(E,) the width of a grid that leaves least of each curve; 0 where none leaves less."""
    gains = [leaves.gains(with_breaks(model, mm), views, LEAVINGS.blurs_px) for mm in BREAKS.grid_mm]
    by_curve = np.array([leaves.by_curve(np.nan_to_num(gain)) for gain in gains])
    needed = by_curve.max(axis=0) > by_curve[0] + LEAVINGS.doubt
    best = np.where(needed, by_curve.argmax(axis=0), 0)
    return np.array(BREAKS.grid_mm)[best][model.chain]


def likeliest(images: StereoImages, model: EdgeModel, poses: Sequence[FloatArray]) -> int | None:
    """Which of several rig_from_part (4, 4), good to a millimetre, a pair shows; None: it does not tell."""
    pyramids = Pyramids(images.rig, images.raw, BREAKS.levels)
    model = with_breaks(model, BREAKS.usual_mm)
    laid = [lay(model, pyramids, pose, BREAKS.steps) for pose in poses]
    seen = {k: evidence_of(model, pyramids, trial.pose) for k, trial in enumerate(laid) if trial is not None}
    shapes = [image.shape for image in images.raw]
    for k, mine in seen.items():
        if all(margin_over(mine, other, shapes) > DECISION.certain for j, other in seen.items() if j != k):
            return k
    return None
