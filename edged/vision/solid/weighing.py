"""Weigh the poses of a part at a place against chance and against each other, by every form of its breaks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import turn_between
from edged.vision.kernels.jit import for_each
from edged.vision.part.job import Job
from edged.vision.part.params import MEASURING
from edged.vision.solid.breaks import lay_with_breaks
from edged.vision.solid.edgemodel import EdgeModel, chains_of
from edged.vision.solid.evidence import PoseEvidence, apart, evidence_of, margin_over, sigmas_of
from edged.vision.solid.forms import PosedPair, as_shown, contradiction, likeliest_form, with_breaks
from edged.vision.solid.jobmodels import models_of
from edged.vision.solid.jobturns import held_axis, is_in_range, pose_in_range, rivals_of, same_turns
from edged.vision.solid.lock import FINE_STEPS, LockedPose, Pyramids, lay, lay_all
from edged.vision.solid.modes import PartPlace
from edged.vision.solid.params import BREAKS, DECISION
from edged.vision.solid.symmetry import NO_TURN, EqualTurns
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


def weighed_for(job: Job, pyramids: Pyramids, place: PartPlace) -> FoundPart:
    """`weighed` with what a job knows of its part."""
    return weighed(
        pyramids,
        place,
        lambda model: rivals_of(job, model),
        same_turns(job),
        lambda pose: is_in_range(job, pose),
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
    seen = for_each(lambda mode: evidence_of(mode.model, pyramids, mode.pose), poses)
    model = poses[max(range(len(poses)), key=lambda k: certain_of(seen[k]))].model

    def likeliest() -> int:
        """Number of the pose that explains most by the best model."""
        mine = [k for k, mode in enumerate(poses) if mode.model is model]
        return max(mine, key=lambda k: float(seen[k].log_ratio().sum()))

    def is_known(pose: FloatArray) -> bool:
        """Whether a pose like it is among them."""
        return any(same.turn_between(pose, mode.pose) < DECISION.same_turn_rad for mode in poses)

    best = likeliest()
    if max(certain_of(view) for view in seen) > 0:  # otherwise no turn makes it a part
        turned = [np.asarray(poses[best].pose @ motion) for motion in turns_of(model)]
        starts = [pose for pose in turned if not is_known(pose)]
        for start, laid in zip(starts, lay_all(model, pyramids, starts, FINE_STEPS), strict=True):
            if laid is not None and laid.mean > DECISION.worth * poses[best].mean and not is_known(start):
                poses.append(laid)
                seen.append(evidence_of(model, pyramids, laid.pose))
    wanted = [k for k, mode in enumerate(poses) if is_wanted(mode.pose)]
    if not any(poses[k].model is model for k in wanted):
        return FoundPart(poses[best], seen[best], -math.inf, math.inf)
    poses, seen = [poses[k] for k in wanted], [seen[k] for k in wanted]
    best = likeliest()
    margin = math.inf
    for k, other in enumerate(seen):
        is_other = same.turn_between(poses[k].pose, poses[best].pose) > DECISION.same_turn_rad
        if k != best and is_other and certain_of(other) > 0:  # otherwise chance is likelier than that pose
            margin = min(margin, margin_over(seen[best], other))
    return FoundPart(poses[best], seen[best], certain_of(seen[best]), margin)


def weighed_with_likeliest_form(
    images: StereoImages, job: Job, found: FoundPart, place: PartPlace, pyramids: Pyramids
) -> FoundPart:
    """Weigh a part with unknown breaks again, with the form of breaks that the pair shows."""
    for _ in range(2):  # again if the right form moves the pose
        view = PosedPair(images, pyramids, found.laid.pose)
        choice = likeliest_form(models_of(job), [view], held_axis(job, found.laid.model))
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
    laid = lay_all(model, pyramids, poses, FINE_STEPS)
    modes = tuple(mode for mode in laid if mode is not None)
    if not modes:
        return None
    return weighed_for(job, pyramids, PartPlace(modes))


def _tilted_poses(model: EdgeModel, pose: FloatArray) -> list[FloatArray]:
    """Poses tilted a little to each side of one that may be caught askew between the edges of its breaks."""
    twists = 0.5 * DECISION.same_turn_rad * np.eye(6)[:2]  # about the part's x and y
    return [moved(model, pose, way * twist) for twist in twists for way in (1.0, -1.0)]


def certain_of(seen: PoseEvidence, chosen: B8 | None = None) -> float:
    """Sigmas by which the less certain camera shows the part, by all its samples or chosen ones (M,)."""
    some = np.ones(len(seen.hit), bool) if chosen is None else chosen
    return min(sigmas_of(seen.log_ratio(some & (seen.camera == k))) for k in (0, 1))


def is_whole(job: Job, found: FoundPart) -> bool:
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


def clear_of(found: FoundPart, others: Sequence[FoundPart]) -> B8:
    """(M,) which samples of a part are clear of the edges of parts that were found before it."""
    chosen = np.ones(len(found.seen.hit), bool)
    for other in others:
        chosen &= apart(found.seen, other.seen)
    return chosen


def as_taught(job: Job, found: FoundPart, pyramids: Pyramids) -> FoundPart:
    """A part that is the same after a turn at the pose that is turned least from the middle of its range."""
    pose = pose_in_range(job, found.laid.pose)
    if pose is found.laid.pose:
        return found
    # a pair shows the axis less exactly than a body has it
    laid = None if job.body is not None else lay(found.laid.model, pyramids, pose, FINE_STEPS)
    return replace(found, laid=laid or replace(found.laid, pose=pose))
