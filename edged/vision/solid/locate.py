"""Find and measure parts by all their edges, those of a body or those taught: tilted, stepped, broken.

No flat face is assumed: all edges of the part, including those of its edge breaks, are looked for in both
pictures, locked together, tested against chance and against every rival, and measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from edged.domain.arrays import B8, FloatArray
from edged.domain.measurement import Match, NotMeasured, Reject, Target
from edged.domain.stopwatch import no_lap
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import (
    apply,
    is_turn_within,
    middle_turn,
    skew,
    transform,
    turn_about_z,
    turn_between,
)
from edged.vision.part import measured as parts
from edged.vision.part.consistency import apply_limits
from edged.vision.part.frames import circles_in_rig, measure_sizes, with_features
from edged.vision.part.job import Job
from edged.vision.part.measure import free_about_z, published, with_free_axis, with_separate_sizes
from edged.vision.part.params import MEASURING
from edged.vision.part.solid import fitted
from edged.vision.solid.bestfit import ProfileFit, best_fit
from edged.vision.solid.breaks import lay_with_breaks
from edged.vision.solid.curvemodel import curve_model, sigmas_of_breaks
from edged.vision.solid.edgemodel import EdgeModel, chains_of, model_of
from edged.vision.solid.evidence import PoseEvidence, apart, evidence_of, margin_over, sigmas_of
from edged.vision.solid.forms import PosedPair, as_shown, contradiction, likeliest_form, with_breaks
from edged.vision.solid.lock import FINE_STEPS, LockedPose, Pyramids, lay
from edged.vision.solid.modes import PartPlace, SearchedPart, find_places, pyramids_of
from edged.vision.solid.params import BREAKS, DECISION, SYMMETRY
from edged.vision.solid.symmetry import NO_TURN, EqualTurns, equal_turns, is_round, like_turns, taught_turns
from edged.vision.solid.visible import moved


@dataclass(frozen=True, slots=True, eq=False)
class FoundPart:
    """A part at a place: its locked pose and model, and the evidence for it.

    certain : sigmas by which the less certain picture shows the part rather than chance.  margin : sigmas by
    which both show it rather than the nearest rival; inf without one.  between (6, 6) : covariance of the
    twist by other forms of its breaks; None where their form is known.  contradicts : as in `RefinedForm`.
    hides : whether breaks may be there that neither the job nor the pair shows.
    """

    laid: LockedPose
    seen: PoseEvidence
    certain: float
    margin: float
    between: FloatArray | None = None
    contradicts: float = 0.0
    hides: bool = False


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
    shapes = [grey.shape for grey in pyramids.grey[0]]
    for place in places:
        if len(measured) + len(dismissed) == job.search.max_matches:
            break
        found = _weighed(job, pyramids, place)
        if found.certain > DECISION.worth_forms:
            if job.body is None:
                found = _of_likeliest_form(images, job, found, place, pyramids)
            elif job.has_open_breaks:
                alike = weighed_with_breaks_of(taken[0], images, job, place, pyramids) if taken else None
                found = alike or weighed_with_own_breaks(images, job, found, place, pyramids)
        lap("find")
        found = _as_taught(job, found, pyramids)
        match = _match(images, job, found.laid)
        alone = _certain(found.seen, _not_of(found, taken, shapes))  # without the edges of other parts
        if min(found.certain, alone) < DECISION.certain or not _is_whole(job, found):
            missed.append(match)
            continue
        taken.append(found)
        result = measure_found(images, job, found, pyramids, match)
        if job.body is not None and not job.has_open_breaks and _contradicts(result):
            found = _as_taught(job, weighed_with_own_breaks(images, job, found, place, pyramids), pyramids)
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
    if laid is None or turn_between(laid.pose, pose) > DECISION.same_turn_rad:
        return False

    def rivals(model: EdgeModel) -> Sequence[FloatArray]:
        if len(job.shape.equal_motions):  # declared at teaching, which warned of it
            return ()
        return [motion for motion in _turns(job, model) if _is_in_range(job, laid.pose @ motion)]

    found = weighed(pyramids, PartPlace((laid,)), rivals)
    if found.laid is not laid or found.margin <= DECISION.certain or not _is_whole(job, found):
        return False
    if laid.agreeing.min() > DECISION.plain:
        return True
    if found.certain < DECISION.certain:
        return False
    others = [
        other for model in models[1:] if (other := lay(model, pyramids, laid.pose, FINE_STEPS)) is not None
    ]
    rival = max((_certain(evidence_of(other.model, pyramids, other.pose)) for other in others), default=0.0)
    return rival - found.certain < DECISION.certain


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


def _axis(job: Job) -> tuple[float, float]:
    x, y, _ = job.place_of(job.reference)
    return float(x), float(y)


def _turns(job: Job, model: EdgeModel) -> tuple[FloatArray, ...]:
    """Motions that leave the part like itself, about its reference or its middle; none for a round part."""
    axes = [_axis(job), (float(model.centre[0]), float(model.centre[1]))]
    if _is_round(job, model, axes):
        return ()
    if math.dist(*axes) < SYMMETRY.near * model.size_mm:
        axes.pop()
    return tuple(motion for axis in axes for motion in like_turns(model, axis))


def _same_turns(job: Job) -> EqualTurns:
    """Turns after which a job's part is the same, by its surface, or else as far as its pair showed it."""
    return taught_turns(job, models_of(job)[0]) if job.body is None else equal_turns(job.body)


def _is_round(job: Job, model: EdgeModel, axes: Iterable[tuple[float, float]]) -> bool:
    """Whether any turn about one of some axes leaves a part as it is, as far as is known."""
    if job.body is not None:
        return equal_turns(job.body).is_round
    return any(is_round(model, axis) for axis in axes)


def _as_taught(job: Job, found: FoundPart, pyramids: Pyramids) -> FoundPart:
    """A part that is the same after a turn at the pose that is turned least from the middle of its range."""
    pose = _in_range(job, found.laid.pose)
    if pose is found.laid.pose:
        return found
    # a pair shows the axis less exactly than a body has it
    laid = None if job.body is not None else lay(found.laid.model, pyramids, pose, FINE_STEPS)
    return replace(found, laid=laid or replace(found.laid, pose=pose))


def _in_range(job: Job, pose: FloatArray) -> FloatArray:
    """The pose (4, 4) at which a part is the same that is turned least from the middle of its range."""
    same = _same_turns(job)
    middle = middle_turn(job.search.angle_start_rad, job.search.angle_extent_rad)
    return same.nearest(pose, job.rig_from_part @ same.motion(_away(job) * middle))


def _is_in_range(job: Job, pose: FloatArray) -> bool:
    """Whether a part at a pose (4, 4), or where it is the same, is turned as its job allows."""
    turn = _away(job) * turn_about_z(job.rig_from_part[:3, :3].T @ _in_range(job, pose)[:3, :3])
    wanted = job.search
    return is_turn_within(turn, wanted.angle_start_rad, wanted.angle_extent_rad, DECISION.same_turn_rad)


def _away(job: Job) -> float:
    """1 where the part's z axis points away from the cameras, so that turns in the picture are about it."""
    return math.copysign(1.0, job.rig_from_part[2, 2])


def _weighed(job: Job, pyramids: Pyramids, place: PartPlace) -> FoundPart:
    """`weighed` with what a job knows of its part."""
    return weighed(
        pyramids,
        place,
        lambda model: _turns(job, model),
        _same_turns(job),
        lambda pose: _is_in_range(job, pose),
    )


def weighed(
    pyramids: Pyramids,
    place: PartPlace,
    turns_of: Callable[[EdgeModel], Sequence[FloatArray]],
    same: EqualTurns = NO_TURN,
    is_wanted: Callable[[FloatArray], bool] = lambda _: True,
) -> FoundPart:
    """Choose the best pose at a place, by the best of its models, and weigh it against chance and rivals.

    turns_of : motions that leave a model like itself. same : turns after which it is no rival.
    is_wanted : whether the part may lie so; with other poses, nothing is certain.
    """
    poses = list(place.modes)
    seen = [evidence_of(mode.model, pyramids, mode.pose) for mode in poses]
    model = poses[max(range(len(poses)), key=lambda k: _certain(seen[k]))].model

    def likeliest() -> int:
        """Number of the pose that explains most by the best model."""
        mine = [k for k, mode in enumerate(poses) if mode.model is model]
        return max(mine, key=lambda k: float(seen[k].log_ratio().sum()))

    best = likeliest()
    if max(_certain(view) for view in seen) > 0:  # otherwise no turn makes it a part
        for motion in turns_of(model):
            pose = np.asarray(poses[best].pose @ motion)
            if any(same.turn_between(pose, mode.pose) < DECISION.same_turn_rad for mode in poses):
                continue
            laid = lay(model, pyramids, pose, FINE_STEPS)
            if laid is not None and laid.mean > DECISION.worth * poses[best].mean:
                poses.append(laid)
                seen.append(evidence_of(model, pyramids, laid.pose))
    wanted = [k for k, mode in enumerate(poses) if is_wanted(mode.pose)]
    if not any(poses[k].model is model for k in wanted):
        return FoundPart(poses[best], seen[best], -math.inf, math.inf)
    poses, seen = [poses[k] for k in wanted], [seen[k] for k in wanted]
    best = likeliest()
    shapes = [grey.shape for grey in pyramids.grey[0]]
    margin = math.inf
    for k, other in enumerate(seen):
        is_other = same.turn_between(poses[k].pose, poses[best].pose) > DECISION.same_turn_rad
        if k != best and is_other and _certain(other) > 0:  # otherwise chance is likelier than that pose
            margin = min(margin, margin_over(seen[best], other, shapes))
    return FoundPart(poses[best], seen[best], _certain(seen[best]), margin)


def _of_likeliest_form(
    images: StereoImages, job: Job, found: FoundPart, place: PartPlace, pyramids: Pyramids
) -> FoundPart:
    """Weigh a part with unknown breaks again, with the form of breaks that the pair shows."""
    for _ in range(2):  # again if the right form moves the pose
        view = PosedPair(images, pyramids, found.laid.pose)
        choice = likeliest_form(models_of(job), [view], _held(job, found.laid.model))
        if choice is None:
            return found
        model, is_doubtful = choice.form.model, choice.form.contradicts > BREAKS.most_misfit
        poses = [choice.form.views[0].pose, *(mode.pose for mode in place.modes)]
        if is_doubtful:
            poses += _tilted_poses(model, poses[0])
        again = _weighed_from(job, model, poses, pyramids)
        if again is None:
            return found
        before = found.laid.pose
        found = replace(again, between=choice.between[0], contradicts=choice.form.contradicts)
        if not is_doubtful and turn_between(before, found.laid.pose) < DECISION.same_turn_rad:
            break
    return found


def weighed_with_own_breaks(
    images: StereoImages, job: Job, found: FoundPart, place: PartPlace, pyramids: Pyramids
) -> FoundPart:
    """Weigh a part with a body again, with the breaks that the pair shows at each of its edges."""
    fitted_body = lay_with_breaks(images, with_breaks(found.laid.model, 0.0), found.laid.pose)
    if fitted_body is None:
        return found
    model = replace(fitted_body.model, sigma_break_mm=fitted_body.sigma_break_mm, sigma_own_mm=0.0)
    poses = [fitted_body.fit.pose, *(mode.pose for mode in place.modes)]
    again = _weighed_from(job, model, poses, pyramids)
    if again is None:
        return found
    contradicts = contradiction(model, PosedPair(images, pyramids, again.laid.pose))
    unseen_mm = MEASURING.across * BREAKS.hidden_mm  # of a part that shows nothing of its breaks
    hides = not (fitted_body.is_certain or fitted_body.sigma_hidden_mm > unseen_mm)
    between = None if hides else fitted_body.hidden
    return replace(again, between=between, contradicts=contradicts, hides=hides)


def weighed_with_breaks_of(
    first: FoundPart, images: StereoImages, job: Job, place: PartPlace, pyramids: Pyramids
) -> FoundPart | None:
    """Weigh a part with the breaks of the first one in the picture; None where these do not explain it."""
    again = _weighed_from(job, first.laid.model, [mode.pose for mode in place.modes], pyramids)
    if again is None or again.certain < DECISION.certain:
        return None
    view = PosedPair(images, pyramids, again.laid.pose)
    contradicts = contradiction(*as_shown(first.laid.model, view))
    if contradicts > 0.5 * BREAKS.most_misfit:
        return None
    return replace(again, between=first.between, contradicts=contradicts, hides=first.hides)


def _weighed_from(
    job: Job, model: EdgeModel, poses: Sequence[FloatArray], pyramids: Pyramids
) -> FoundPart | None:
    """Lock a model anew from some poses of one place, and weigh the result; None if none holds."""
    laid = [lay(model, pyramids, pose, FINE_STEPS) for pose in poses]
    modes = tuple(mode for mode in laid if mode is not None)
    if not modes:
        return None
    return _weighed(job, pyramids, PartPlace(modes))


def _tilted_poses(model: EdgeModel, pose: FloatArray) -> list[FloatArray]:
    """Poses tilted a little to each side of one that may be caught askew between the edges of its breaks."""
    twists = 0.5 * DECISION.same_turn_rad * np.eye(6)[:2]  # about the part's x and y
    return [moved(model, pose, way * twist) for twist in twists for way in (1.0, -1.0)]


def _certain(seen: PoseEvidence, chosen: B8 | None = None) -> float:
    """Sigmas by which the less certain camera shows the part, by all its samples or chosen ones (M,)."""
    some = np.ones(len(seen.hit), bool) if chosen is None else chosen
    return min(sigmas_of(seen.log_ratio(some & (seen.camera == k))) for k in (0, 1))


def _is_whole(job: Job, found: FoundPart) -> bool:
    """Whether enough is seen of a part that is known by its curves alone; always true with a body.

    A short traced stretch, which is no feature, counts by its length over that of a usual feature. Each
    picture by itself must show its features, together, rather than not.
    """
    if job.body is not None:
        return True
    count = len(job.circles) + len(job.slots) + len(job.edges)
    of_features = chains_of(found.seen.curve) < count
    by_camera = [found.seen.log_ratio(of_features & (found.seen.camera == k)).sum() for k in (0, 1)]
    if min(by_camera) <= 0:
        return False
    numbers, shown = found.seen.shown()
    model = found.laid.model
    length = np.bincount(model.chain, np.linalg.norm(model.end - model.start, axis=1))[numbers]
    features = numbers < count
    usual = np.median(length[features] if features.any() else length)
    weight = np.where(features, 1.0, np.minimum(length / usual, 1.0))
    circles = shown[numbers < len(job.circles)]
    present = np.average(shown, weights=weight) >= DECISION.present
    return bool(present and (not len(circles) or circles.mean() >= DECISION.circles))


def _not_of(found: FoundPart, others: Sequence[FoundPart], shapes: list[tuple[int, int]]) -> B8:
    """(M,) which samples of a part are clear of the edges of parts that were found before it."""
    chosen = np.ones(len(found.seen.hit), bool)
    for other in others:
        chosen &= apart(found.seen, other.seen, shapes)
    return chosen


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
    held = _held(job, model)
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


def _held(job: Job, model: EdgeModel) -> FloatArray | None:
    """(3,) axis of a part that is round about its reference; None if it is not."""
    return np.array([0.0, 0.0, 1.0]) if _is_round(job, model, {_axis(job)}) else None


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
