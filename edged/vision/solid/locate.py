"""Find and measure parts by all their edges, those of a body or those taught: tilted, stepped, broken.

No flat face is assumed: all edges of the part, including those of its edge breaks, are looked for in both
pictures, locked together, tested against chance and against every rival, and measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Match, NotMeasured, Reject, Target
from edged.domain.stopwatch import no_lap
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, skew, transform, turn_about_z, turn_between
from edged.vision.part import measured as parts
from edged.vision.part.consistency import apply_limits
from edged.vision.part.frames import circles_in_rig, measure_sizes, with_features
from edged.vision.part.job import Job
from edged.vision.part.measure import free_about_z, published, with_free_axis, with_separate_sizes
from edged.vision.part.solid import fitted
from edged.vision.solid.bestfit import ProfileFit, best_fit
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.evidence import evidence_of
from edged.vision.solid.forms import PosedPair, as_shown, contradiction
from edged.vision.solid.jobmodels import models_of, wanted_of
from edged.vision.solid.jobturns import held_axis, is_in_range, rivals_of
from edged.vision.solid.lock import FINE_STEPS, LockedPose, Pyramids, lay
from edged.vision.solid.modes import PartPlace, find_places, pyramids_of
from edged.vision.solid.params import BREAKS, DECISION, PROFILE
from edged.vision.solid.symmetry import equal_turns
from edged.vision.solid.weighing import (
    FoundPart,
    as_taught,
    certain_of,
    clear_of,
    is_whole,
    weighed,
    weighed_for,
    weighed_with_breaks_of,
    weighed_with_likeliest_form,
    weighed_with_own_breaks,
)


def locate_solid(
    images: StereoImages, job: Job, lap: Callable[[str], None] = no_lap
) -> tuple[list[parts.MeasuredPart], list[NotMeasured], list[Match]]:
    """Find all parts of a job in a pair; also those that could not be measured, and near misses.

    A job without a body is looked for by its taught curves alone. Where no part is found, or its turn is in
    doubt, it is looked for again by the views between those of the first look, beside what that found; a part
    whose breaks are not known then with wide ones, after narrow ones.

    lap : called with "find" and "measure" as these end at each place.
    """
    wanted = wanted_of(job)
    pyramids = pyramids_of(images, wanted)
    places = find_places(wanted, pyramids)
    first = _measured_at(places, images, job, pyramids, lap)
    if _is_sure(*first[:2]):
        return first
    if job.has_open_breaks:
        wanted = wanted_of(job, BREAKS.looked_wide_mm)
    again = _measured_at(find_places(wanted, pyramids, places), images, job, pyramids, lap)
    measured, dismissed, _ = again if _is_sure(*again[:2]) else first
    return measured, dismissed, [*first[2], *again[2]]


def _is_sure(measured: Sequence[parts.MeasuredPart], dismissed: Sequence[NotMeasured]) -> bool:
    """Whether a part was found, and the turn of one is not in doubt."""
    turned = [part for part in measured if not part.target.reject & Reject.AMBIGUOUS_ROTATION]
    return bool(turned or (dismissed and not measured))


def _measured_at(
    places: Sequence[PartPlace],
    images: StereoImages,
    job: Job,
    pyramids: Pyramids,
    lap: Callable[[str], None],
) -> tuple[list[parts.MeasuredPart], list[NotMeasured], list[Match]]:
    """`locate_solid` at some places."""
    measured: list[parts.MeasuredPart] = []
    dismissed: list[NotMeasured] = []
    missed: list[Match] = []
    taken: list[FoundPart] = []
    for place in places:
        if len(measured) + len(dismissed) == job.search.max_matches:
            break
        found = weighed_for(job, pyramids, place)
        if found.certain > DECISION.worth_forms:
            if job.body is None:
                found = weighed_with_likeliest_form(images, job, found, place, pyramids)
            elif job.has_open_breaks:
                alike = weighed_with_breaks_of(taken[0], images, job, place, pyramids) if taken else None
                found = alike or weighed_with_own_breaks(images, job, found, place, pyramids)
        lap("find")
        found = as_taught(job, found, pyramids)
        match = _match(images, job, found.laid)
        alone = certain_of(found.seen, clear_of(found, taken))  # without the edges of other parts
        if min(found.certain, alone) < DECISION.certain or not is_whole(job, found):
            missed.append(match)
            continue
        taken.append(found)
        result = measure_found(images, job, found, pyramids, match)
        if job.body is not None and not job.has_open_breaks and _contradicts(result):
            found = as_taught(job, weighed_with_own_breaks(images, job, found, place, pyramids), pyramids)
            result = measure_found(images, job, found, pyramids, match)
        lap("measure")
        if isinstance(result, parts.MeasuredPart):
            measured.append(result)
        else:
            dismissed.append(NotMeasured(match, result))
    lap("find")
    return measured, dismissed, missed


def _contradicts(result: parts.MeasuredPart | Reject) -> bool:
    """Whether a part was refused because its breaks are not as its teaching pair showed them."""
    return isinstance(result, parts.MeasuredPart) and bool(result.target.reject & Reject.RESIDUAL)


def all_edges_agree(images: StereoImages, job: Job, targets: Sequence[Target]) -> bool:
    """Whether all taught curves of a job agree with targets that were measured by some of them."""
    models = models_of(job)
    sharpest_first = sorted(models, key=lambda model: bool(model.breaks_mm.any()))
    pyramids = Pyramids(images.rig, images.raw, 1)
    return all(_agrees(job, sharpest_first, pyramids, target) for target in targets)


def _agrees(job: Job, models: Sequence[EdgeModel], pyramids: Pyramids, target: Target) -> bool:
    """Whether a part lies where a target is, and turned so: by the first of some models, or all of them.

    It stays there, enough of it is shown, and no turn of it and no other model is as likely.
    """
    pose = target.rig_from_part @ job.reference_from_part
    laid = lay(models[0], pyramids, pose, FINE_STEPS)
    if laid is None or not _stays(models[0], pyramids, pose, laid.pose):
        return False

    def rivals(model: EdgeModel) -> Sequence[FloatArray]:
        if len(job.shape.equal_motions):  # declared at teaching, which warned of it
            return ()
        return [motion for motion in rivals_of(job, model) if is_in_range(job, laid.pose @ motion)]

    found = weighed(pyramids, PartPlace((laid,)), rivals)
    if found.laid is not laid or found.margin <= DECISION.certain or not is_whole(job, found):
        return False
    if laid.agreeing.min() > DECISION.plain:
        return True
    if found.certain < DECISION.certain:
        return False
    others = [
        other for model in models[1:] if (other := lay(model, pyramids, laid.pose, FINE_STEPS)) is not None
    ]
    rival = max((certain_of(evidence_of(other.model, pyramids, other.pose)) for other in others), default=0.0)
    return rival - found.certain < DECISION.certain


def _stays(model: EdgeModel, pyramids: Pyramids, pose: FloatArray, other: FloatArray) -> bool:
    """Whether a part at another pose is turned alike, and in both pictures where a profile still finds it."""
    rig, centres = pyramids.rig, np.stack([apply(each, model.centre) for each in (pose, other)])
    seen = rig.left.project(centres), rig.right.project(apply(rig.right_from_left, centres))
    shifted_px = max(float(np.linalg.norm(places[1] - places[0])) for places in seen)
    return turn_between(pose, other) < DECISION.same_turn_rad and shifted_px < PROFILE.widest_px


def _match(images: StereoImages, job: Job, laid: LockedPose) -> Match:
    """A pose as a match of the left picture: where its reference is, its turn against the taught one."""
    reference = apply(laid.pose, job.place_of(job.reference))
    x, y = images.rig.left.project(reference[None])[0]
    angle = turn_about_z(laid.pose[:3, :3] @ job.rig_from_part[:3, :3].T)
    scale = float(apply(job.rig_from_part, job.place_of(job.reference))[2] / reference[2])
    return Match(float(x), float(y), angle, scale, scale, laid.mean)


def measure_found(
    images: StereoImages, job: Job, found: FoundPart, pyramids: Pyramids, match: Match
) -> parts.MeasuredPart | Reject:
    """Measure a found part; the reason if that is not possible."""
    model, pose = found.laid.model, found.laid.pose
    held = held_axis(job, model)
    if job.body is not None:
        model, view = as_shown(model, PosedPair(images, pyramids, pose), held)
        pose = view.pose
    fit = best_fit(model, pyramids, images, pose, held)
    if fit is None:
        return Reject.FEW_EDGES
    if found.between is not None:
        fit = replace(fit, edges=fit.edges + found.between)
    target = _target(job, model, fit, match)
    reject = Reject.NONE if found.margin > DECISION.certain else Reject.AMBIGUOUS_ROTATION
    contradicts = found.contradicts
    if job.body is not None and not job.has_open_breaks:  # edges taught sharp, and shown broken here
        contradicts = contradiction(model, PosedPair(images, pyramids, fit.pose))
    if contradicts > BREAKS.most_misfit:
        reject |= Reject.RESIDUAL
    # fit each curve freely, as far as no other is near: sizes come from these fits
    whole = fitted(images, job, fit.pose)
    alone = None if whole is None else whole.alone(images)
    if alone is not None:
        target = replace(target, circles=tuple(placed.circle for placed in circles_in_rig(alone)))
        target = with_features(target, job, alone)
    target = replace(target, reject=reject, measurements=measure_sizes(job, alone, target.circles))
    # rms_px is 0: the scatter of the profiles is in the sigma, by blocks; another break makes no other part
    evidence = parts.Evidence(
        float(found.laid.agreeing.min()),
        0.0,
        fit.row_shift_px,
        fit.row_sigma_px,
        fit.growth,
        fit.growth_sigma,
        break_mm=float(model.breaks_mm.max()) if job.body is None or job.has_open_breaks else 0.0,
    )
    result = parts.MeasuredPart(target, evidence, () if whole is None else whole.fit.fits)
    result = with_separate_sizes(result, images, job)
    target = apply_limits(job, images.rectification, _with_free_axis(job, result.target), evidence)
    sigma_mm = math.hypot(job.sigma_mm, BREAKS.hidden_mm) if found.hides else job.sigma_mm
    return replace(result, target=published(replace(job, sigma_mm=sigma_mm), target))


def _with_free_axis(job: Job, target: Target) -> Target:
    """`with_free_axis` by the surface of a part, if it is known."""
    return free_about_z(target) if equal_turns(job.body).is_round else with_free_axis(job, target)


def _target(job: Job, model: EdgeModel, fit: ProfileFit, match: Match) -> Target:
    """Target of a part at the pose of a fit."""
    rotation, reference = fit.pose[:3, :3], job.place_of(job.reference)
    lift = np.zeros((6, 6))  # derivative of (position, rotation vector) in rig axes by the twist
    lift[:3, :3], lift[:3, 3:] = -rotation @ skew(reference - model.centre), rotation
    lift[3:, :3] = rotation
    return Target(
        job=job.name,
        match=match,
        rig_from_part=transform(rotation, apply(fit.pose, reference)),
        covariance=lift @ (fit.edges + fit.calibration) @ lift.T,
        by_edges=lift @ fit.edges @ lift.T,
        circles=(),
        epipolar_rms_px=math.nan,
    )
