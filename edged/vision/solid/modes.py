"""Find a part in a pair without a start: from many views to the few poses (modes) that survive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, turn_between
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.lock import FINE_STEPS, LockedPose, Pyramids, lay_all, schedule
from edged.vision.solid.params import DECISION, MODES, LockStep
from edged.vision.solid.scan import starts_of, top_level


@dataclass(frozen=True, slots=True, eq=False)
class PartPlace:
    """Poses that were locked at one place of the scene, by falling agreement."""

    modes: tuple[LockedPose, ...]

    @property
    def best(self) -> LockedPose:
        """The pose with the highest agreement."""
        return self.modes[0]


@dataclass(frozen=True, slots=True, eq=False)
class SearchedPart:
    """A part to look for, and where.

    models : its edges, one for each form that they may have; it is looked for by the first.
    tilt_rad : largest angle of the part's -z to the bisector of both cameras.  distances_mm : nearest and
    farthest of its centre from the left camera.  place (3,) : where it was taught, rig frame.
    """

    models: tuple[EdgeModel, ...]
    tilt_rad: float
    distances_mm: tuple[float, float]
    place: FloatArray


def pyramids_of(images: StereoImages, wanted: SearchedPart) -> Pyramids:
    """Both pictures down to the size at which the part is looked for."""
    top = top_level(images.rig, wanted.models[0], float(np.linalg.norm(wanted.place)))
    return Pyramids(images.rig, images.raw, top + 1)


def find_places(
    wanted: SearchedPart, pyramids: Pyramids, before: Sequence[PartPlace] | None = None
) -> list[PartPlace]:
    """Places where the part may lie, by falling agreement.

    before : those of a first look; they are weighed again beside what the views between that look's show.
    """
    model = wanted.models[0]
    # edges of thin parts run into each other at the size that is enough for most: look again at twice that
    pictures = pyramids.grey if before is None else pyramids.grey[:-1] or pyramids.grey
    starts = starts_of(
        model, pyramids.rig, pictures, wanted.tilt_rad, wanted.distances_mm, wanted.place, before is not None
    )
    coarse, between = schedule(len(pyramids.cameras) - 1)
    laid = _laid(model, pyramids, starts, coarse, wanted)
    laid = _unlike(model, laid, MODES.kept_fine, MODES.fine_at_place)
    if between:
        laid = _laid(model, pyramids, [candidate.pose for candidate in laid], between, wanted)
        laid = _unlike(model, laid, MODES.kept_fine, MODES.fine_at_place)
    poses = [mode.pose for place in before or () for mode in place.modes]
    poses += [candidate.pose for candidate in _worth(model, laid)]
    looks = 1 if before is None else 2  # no rival of the first look is lost to one of the second
    places: list[list[LockedPose]] = []
    for form in wanted.models:
        laid = _laid(form, pyramids, poses, FINE_STEPS, wanted)
        for candidate in _unlike(model, laid, looks * MODES.kept_fine, looks * MODES.fine_at_place):
            near = [
                place
                for place in places
                if _apart(model, place[0], candidate) < MODES.same_place * model.size_mm
            ]
            if near:
                near[0].append(candidate)
            else:
                places.append([candidate])
    ordered = [sorted(place, key=lambda candidate: -candidate.mean) for place in places]
    return sorted((PartPlace(tuple(place)) for place in ordered), key=lambda place: -place.best.mean)


def _laid(
    model: EdgeModel,
    pyramids: Pyramids,
    poses: Sequence[FloatArray],
    steps: Sequence[LockStep],
    wanted: SearchedPart,
) -> list[LockedPose]:
    """Lock poses by some steps; by falling agreement, without those that left the range of distances."""
    found = lay_all(model, pyramids, poses, steps)
    near, far = wanted.distances_mm
    kept = []
    for candidate in found:
        if candidate is None:
            continue
        distance = float(np.linalg.norm(apply(candidate.pose, model.centre)))
        if near * (1 - MODES.margin) <= distance <= far * (1 + MODES.margin):
            kept.append(candidate)
    return sorted(kept, key=lambda candidate: -candidate.mean)


def _unlike(model: EdgeModel, laid: Sequence[LockedPose], most: int, at_place: int) -> list[LockedPose]:
    """The first poses that differ from each other, with not too many at one place."""
    kept: list[LockedPose] = []
    for candidate in laid:
        near = [other for other in kept if _apart(model, candidate, other) < MODES.same_place * model.size_mm]
        alike = any(
            _apart(model, candidate, other) < MODES.alike_mm
            and turn_between(candidate.pose, other.pose) < MODES.alike_rad
            for other in near
        )
        if alike or len(near) >= at_place:
            continue
        kept.append(candidate)
        if len(kept) == most:
            break
    return kept


def _worth(model: EdgeModel, laid: Sequence[LockedPose]) -> list[LockedPose]:
    """Poses that are not far behind the best of their place: only these are worth a fine lock."""
    return [
        candidate
        for candidate in laid
        if all(
            candidate.mean > DECISION.worth * other.mean
            for other in laid
            if _apart(model, candidate, other) < MODES.same_place * model.size_mm
        )
    ]


def _apart(model: EdgeModel, candidate: LockedPose, other: LockedPose) -> float:
    return float(np.linalg.norm(apply(candidate.pose, model.centre) - apply(other.pose, model.centre)))
