"""Teach a part from a pair and its CAD model together.

What the pair alone teaches is first registered with the model. If that fails because the pair shows few or
poor curves, the model is searched for in both pictures like the part of a job; the features are then the
model's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import TeachError
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, invert, transform
from edged.vision.part.job import usual_limits
from edged.vision.solid.edgemodel import model_of
from edged.vision.solid.forms import with_breaks
from edged.vision.solid.lock import Pyramids
from edged.vision.solid.modes import SearchedPart, find_places, pyramids_of
from edged.vision.solid.params import BREAKS, DECISION
from edged.vision.solid.symmetry import EqualTurns, equal_turns, like_turns
from edged.vision.solid.weighing import FoundPart, weighed
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.cadjob import teach_model
from edged.vision.teaching.cadmatch import levelled
from edged.vision.teaching.cadmodel import ModelCurves
from edged.vision.teaching.cadrevision import another_revision, moved_circle
from edged.vision.teaching.cadsettling import Settled, laid_on_pair, same_after_turns, settle
from edged.vision.teaching.features import TeachingView, where_axes_meet
from edged.vision.teaching.pair import WantedJob, taught
from edged.vision.teaching.params import CAD

RECOVERABLE_CODES = (
    "no_feature",
    "one_sided",
    "open_turn",
    "not_shown",
    "no_fit",
    "patterned_table",
    "revision",
)
"""Codes of errors of teaching from the pair alone after which the model may still be found in it."""


def teach_with_model(view: TeachingView, curves: ModelCurves, what: str, wanted: WantedJob) -> Settled:
    """Teach the part that a view shows, registered with its model.

    what : the model's name, for messages.
    Raises `TeachError` for a pair that shows no part of that model, its mirror image or another revision.
    """
    try:
        return settle(taught(view, wanted), curves, view.images, what)
    except TeachError as error:
        if error.code not in RECOVERABLE_CODES:
            raise
        pose = _looked_for(view.images, curves, view.mask)
        if pose is None:
            raise
        return _from_model(view.images, curves, pose, what, wanted)


def _looked_for(images: StereoImages, curves: ModelCurves, mask: Image) -> FloatArray | None:
    """Search for the model within a mask of the rectified left picture: rig_from_model (4, 4), or None."""
    level = transform(levelled(curves.up), np.zeros(3))
    body = body_of(curves.model, level)
    if body is None:
        return None
    sharp = model_of(body)
    place = where_axes_meet(images)
    distance = float(np.linalg.norm(place))
    wanted = SearchedPart((sharp,), CAD.taught_tilt_rad, (distance, distance), place)
    pyramids = pyramids_of(images, wanted)
    for reach in CAD.taught_ranges:
        within = replace(wanted, distances_mm=(distance / reach, distance * reach))
        found = _laid_with_breaks(images, within, pyramids, mask, equal_turns(body))
        if found is not None:
            return np.asarray(found.laid.pose @ level)
    return None


def _laid_with_breaks(
    images: StereoImages, wanted: SearchedPart, pyramids: Pyramids, mask: Image, same: EqualTurns
) -> FoundPart | None:
    """`_laid_by` with usual breaks; then with all widths, the most certain, each from a scan of its own.

    Of wide breaks either edge may show, and views of a model without them lead to a pose between the two.
    """

    def laid(width_mm: float) -> FoundPart | None:
        models = (with_breaks(wanted.models[0], width_mm),)
        return _laid_by(images, replace(wanted, models=models), pyramids, mask, same)

    usual = laid(BREAKS.usual_mm)
    if usual is not None:
        return usual
    shown = [part for width in BREAKS.unknown_mm if (part := laid(width)) is not None]
    return max(shown, key=lambda part: part.certain, default=None)


def _laid_by(
    images: StereoImages, wanted: SearchedPart, pyramids: Pyramids, mask: Image, same: EqualTurns
) -> FoundPart | None:
    """The part within a mask, by one model; None if it is not certain, or fits as well otherwise.

    same : turns after which it is no other pose.
    """
    model = wanted.models[0]
    turns = like_turns(model, (float(model.centre[0]), float(model.centre[1])))
    for place in find_places(wanted, pyramids):
        centre = images.rig.left.project(apply(place.best.pose, model.centre)[None])
        x, y = np.rint(images.rectification.rectify_points("left", centre)[0]).astype(int)
        if not (0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and mask[y, x] > 0):
            continue
        found = weighed(pyramids, place, lambda _: turns, same)
        # little certainty is needed here: `laid_on_pair` tests it again with the breaks of the part
        is_shown = found.certain >= DECISION.worth_forms and found.margin >= DECISION.certain
        return found if is_shown else None
    return None


def _from_model(
    images: StereoImages, curves: ModelCurves, rig_from_model: FloatArray, what: str, wanted: WantedJob
) -> Settled:
    """Job with the features of the model, and the pose and edge breaks that the pair shows."""
    centre = 0.5 * (curves.model.points_mm.min(axis=0) + curves.model.points_mm.max(axis=0))
    depth_mm = float(apply(rig_from_model, centre)[2])
    named = wanted.name, wanted.number, wanted.params
    job, _ = teach_model(curves.model, curves, images.rectification, depth_mm, *named)
    part_from_model = job.part_from_model
    assert part_from_model is not None
    pixel_mm = depth_mm / images.rectification.focal_px
    job = replace(
        job,
        rig_from_part=rig_from_model @ invert(part_from_model),
        sigma_mm=0.0,
        calibration_id=images.rig.calibration_id,
        limits=usual_limits(depth_mm, pixel_mm, job.shape, job.circles, job.reference),
    )
    taken, measured = laid_on_pair(job, images, what)
    if taken.body is not None:
        laid = model_of(taken.body)
        moved = moved_circle(images, laid, taken.rig_from_part, part_from_model, curves)
        if moved:
            raise another_revision(what, moved)
    found = f"{what}: looked for by all its edges, for the pair alone does not tell how it lies"
    return Settled(taken, (found, *measured, *same_after_turns(taken)))
