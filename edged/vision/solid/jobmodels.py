"""The edge models that a job's part is looked for and measured by: one for each form of its breaks."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from edged.vision.geometry.rigid import (
    apply,
)
from edged.vision.part.job import Job
from edged.vision.solid.curvemodel import curve_model, sigmas_of_breaks
from edged.vision.solid.edgemodel import EdgeModel, model_of
from edged.vision.solid.forms import with_breaks
from edged.vision.solid.modes import SearchedPart
from edged.vision.solid.params import BREAKS, DECISION


def wanted_of(job: Job, looked_mm: float = BREAKS.looked_mm) -> SearchedPart:
    """The part of a job to look for; if its breaks are not known, sharp and with breaks of one width."""
    models = models_of(job)
    if job.has_open_breaks:  # to come near; its form is determined there
        widths = {0.0, looked_mm}
        models = tuple(model for model, form in zip(models, forms_of(job), strict=True) if form[0] in widths)
    model = models[0]
    place = apply(job.rig_from_part, model.centre)
    # by the scales of the search, within the limits, both of which are of the reference point
    taught = float(apply(job.rig_from_part, job.place_of(job.reference))[2])
    near, far = (taught / scale for scale in (job.search.scale_max, job.search.scale_min))
    near, far = max(near, job.limits.depth_mm[0]), min(far, job.limits.depth_mm[1])
    near, far = (float(np.linalg.norm(place)) * depth / taught for depth in (near, far))
    tilt = DECISION.lying_rad if job.tilt_rad is None else job.tilt_rad
    return SearchedPart(models, tilt + DECISION.tilt_margin_rad, (near, far), place)


@lru_cache(maxsize=16)
def models_of(job: Job) -> tuple[EdgeModel, ...]:
    """The edges of a job's part, made once: one model, or one for each width that its breaks may have."""
    if job.body is None:
        return tuple(curve_model(job, *form) for form in forms_of(job))
    model = model_of(job.body)
    if job.body.breaks_mm is not None:
        return (model,)
    common_mm, own_mm = sigmas_of_breaks(job)
    model = replace(model, sigma_break_mm=common_mm, sigma_own_mm=own_mm)
    return tuple(with_breaks(model, width) for width, _ in forms_of(job))


def forms_of(job: Job) -> list[tuple[float, bool]]:
    """Forms that unknown breaks of a job may have: width, and whether the lower edge was taught.

    Light and view of the teaching pair decided which end of a break was taught; a body has both.
    """
    widths = BREAKS.unknown_mm if job.break_mm is None else (job.break_mm,)
    ends = (False, True) if job.break_end is None else (job.break_end == "wall",)
    if job.body is not None:
        ends = (False,)
    forms = [(width, is_lower) for is_lower in ends for width in widths if width > 0 or not is_lower]
    if job.break_mm is None:
        forms.sort(key=lambda form: form != (BREAKS.looked_mm, False))
    return forms or [(0.0, False)]
