"""Determine the edge breaks of a job's part from the teaching pair and further pairs.

The teaching pair shows both edges of breaks that are wide and bright enough. If they are not, further pairs
help, in which the part is tilted by ten degrees or lit otherwise: all pairs together settle how wide the
breaks are, and which edge of each was taught.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Reject
from edged.errors import TeachError
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import invert, turn_between
from edged.vision.part.job import MAX_TILT_DEG, BreakEnd, Job
from edged.vision.solid.bestfit import best_fit
from edged.vision.solid.breaks import lay_with_breaks, starts_of_breaks
from edged.vision.solid.curvemodel import has_enough_curves
from edged.vision.solid.edgemodel import EdgeModel, model_of
from edged.vision.solid.forms import FormChoice, PosedPair, likeliest_form
from edged.vision.solid.jobmodels import forms_of, models_of
from edged.vision.solid.locate import locate_solid
from edged.vision.solid.lock import Pyramids, lay
from edged.vision.solid.params import BREAKS, DECISION
from edged.vision.teaching.brokenedges import broken_edges, with_edges
from edged.vision.teaching.cadsettling import with_own_breaks

Pair = tuple[Image, Image]


def with_breaks_shown(
    job: Job, pair: Pair, further: Sequence[Pair], rectification: Rectification
) -> tuple[Job, tuple[str, ...]]:
    """Add to a job the edge breaks that raw pairs of its part show; also remarks for the user.

    pair : the one it was taught from.  further : others.
    Raises `TeachError` naming a further pair that does not show the part, `ImageError` for pairs of other
    cameras.
    """
    if job.body is not None and job.has_open_breaks:
        return _with_body_shown(job, pair, further, rectification)
    if job.body is not None or not has_enough_curves(job):
        if not further:
            return job, ()
        what = "edge breaks that are settled" if job.body is not None else "that few curves"
        raise TeachError(
            f"further pairs: a part with {what} has nothing to learn from them", "further_needless"
        )
    views = [_view(StereoImages.of(rectification, *pair), job.rig_from_part)]
    settled, remarks = _by_both_edges(job, views, "this pair")
    if not further:
        return settled, remarks
    for k, raw in enumerate(further, 2):
        view = _found(settled, StereoImages.of(rectification, *raw), k)
        motion = view.pose @ invert(settled.rig_from_part)
        views.append(replace(view, pose=motion @ job.rig_from_part))
    settled, remarks = _by_both_edges(job, views, "all pairs")
    if remarks:
        turns = [math.degrees(turn_between(view.pose, job.rig_from_part)) for view in views[1:]]
        shown = [f"pair {k}: turned by {turn:.0f} degrees from pair 1" for k, turn in enumerate(turns, 2)]
        return settled, (*shown, *remarks)
    unknown = replace(job, break_mm=None, break_end=None)
    choice = likeliest_form(models_of(unknown), views)
    if choice is None:
        raise TeachError("further pairs: together they show too little of the part", "further_little")
    remarks = tuple(_pair_remark(choice, job, views, k) for k in range(1, len(views)))
    settled, what = _settled(job, choice, forms_of(unknown))
    return settled, (*remarks, what)


def _with_body_shown(
    job: Job, pair: Pair, further: Sequence[Pair], rectification: Rectification
) -> tuple[Job, tuple[str, ...]]:
    """The job of a body with the breaks that the first further pair certainly shows."""
    assert job.body is not None
    remarks: list[str] = []
    for k, raw in enumerate(further, 2):
        images = StereoImages.of(rectification, *raw)
        laid = lay_with_breaks(images, model_of(job.body), _found(job, images, k).pose)
        if laid is None or not laid.is_certain:
            remarks.append(f"pair {k}: its edge breaks may hide, too")
            continue
        taken, what = with_own_breaks(job, laid)
        first = StereoImages.of(rectification, *pair)
        pose = _laid_again(laid.model, first, job.rig_from_part)
        return replace(taken, rig_from_part=pose), (*remarks, f"pair {k}: shows them", *what)
    return job, tuple(remarks)


def _laid_again(model: EdgeModel, images: StereoImages, pose: FloatArray) -> FloatArray:
    """Pose of a model with breaks in a pair that hides them, from one that was found without them."""
    pyramids = Pyramids(images.rig, images.raw, BREAKS.levels)
    starts = starts_of_breaks(pose, float(model.breaks_mm.max(initial=0.0)))
    found = [lay(model, pyramids, start, BREAKS.steps) for start in starts]
    best = max((laid for laid in found if laid is not None), key=lambda laid: laid.mean, default=None)
    if best is None:
        return pose
    fit = best_fit(model, pyramids, images, best.pose)
    return best.pose if fit is None else fit.pose


def _by_both_edges(job: Job, views: Sequence[PosedPair], by: str) -> tuple[Job, tuple[str, ...]]:
    """The job with both edges of its breaks and a remark, if the pairs show them with certainty."""
    found = broken_edges(job, views)
    if found is None or not found.is_certain:
        return job, ()
    line = f"edge breaks of {found.width_mm:.2f} mm: both edges of each were found, by {by}"
    return with_edges(job, found), (line,)


def _view(images: StereoImages, pose: FloatArray) -> PosedPair:
    return PosedPair(images, Pyramids(images.rig, images.raw, 1), pose)


def _found(job: Job, images: StereoImages, number: int) -> PosedPair:
    """Locate the part in a further pair, at any tilt and distance."""
    anywhere = replace(
        job,
        tilt_rad=math.radians(MAX_TILT_DEG),
        limits=replace(job.limits, max_sigma_mm=math.inf, depth_mm=(0.0, math.inf)),
    )
    measured, _, missed = locate_solid(images, anywhere)
    good = [part for part in measured if part.target.reject is Reject.NONE]
    if len(good) != 1:
        why = f"shows {len(good)} of it" if good else "does not show it"
        if measured and not good:
            why = f"shows it as refused ({measured[0].target.reject.name})"
        elif missed and not good:
            why += ", or too little of it"
        raise TeachError(
            f"pair {number}: {why}: expected one part, the one that pair 1 shows, whole in both pictures",
            "further_none",
            pair=number,
        )
    target = good[0].target
    return _view(images, target.rig_from_part @ job.reference_from_part)


def _pair_remark(choice: FormChoice, job: Job, views: Sequence[PosedPair], k: int) -> str:
    """Remark on what one of the pairs contributes."""
    apart = math.degrees(turn_between(views[k].pose, job.rig_from_part))
    behind = [form.sigmas_behind(choice.form, k) for form in choice.others]
    what = f"tells the form of the breaks by {min(behind):.0f} sigmas" if behind else "shows it as taught"
    return f"pair {k + 1}: turned by {apart:.0f} degrees from pair 1; {what}"


def _settled(job: Job, choice: FormChoice, forms: Sequence[tuple[float, bool]]) -> tuple[Job, str]:
    """The job with the form of its breaks, if all likely forms agree; and a remark on it."""
    likely = [k for k, share in enumerate(choice.likely) if share > DECISION.likely]
    width = _width_mm(choice.form.model)
    widths = [width if form is None else _width_mm(form.model) for form in choice.forms]
    spread = math.sqrt(float(choice.likely @ (np.array(widths) - width) ** 2))
    widths = [widths[k] for k in likely]
    if spread > BREAKS.taught_sigma_mm:
        return job, f"edge breaks: {min(widths):.2f} to {max(widths):.2f} mm explain all pairs; tilt it more"
    if width == 0:
        return replace(job, break_mm=0.0, break_end=None), "edge breaks: none, by all pairs"
    ends = {forms[k][1] for k in likely}
    end: BreakEnd | None = None if len(ends) > 1 else ("wall" if ends.pop() else "face")
    taught = "either end" if end is None else f"the edge in the {end}"
    return (
        replace(job, break_mm=round(width, 4), break_end=end),
        f"edge breaks of {width:.2f} mm, of which {taught} was taught, by all pairs",
    )


def _width_mm(model: EdgeModel) -> float:
    """Median break width of a model's edges, weighted by their length."""
    length = np.linalg.norm(model.end - model.start, axis=1)
    order = np.argsort(model.breaks_mm)
    total = np.cumsum(length[order])
    return float(model.breaks_mm[order][np.searchsorted(total, 0.5 * total[-1])])
