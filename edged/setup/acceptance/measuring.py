"""Measures the pictures of an acceptance or of a study: pairs in folders, one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.frames import FramePair
from edged.domain.measurement import Reject, Target
from edged.errors import UserError
from edged.files.pairs import ImagePair, find_pairs
from edged.files.tables import read_named
from edged.pipeline import PreparedRig, inspect, locate
from edged.robot.golden import motion_of_points, own_and_points
from edged.setup.acceptance.verdicts import PlacedPoses
from edged.setup.calibration.checking import length_of
from edged.setup.pairs import load_pair
from edged.setup.trials.stilltest import StillResult, StillSample
from edged.setup.trials.tried import stand_of, still_part
from edged.vision.geometry.rigid import apply, invert, skew
from edged.vision.part.job import Job

MOST_PAIRS = 1000
"""Most pairs in one folder."""
MOST_OF_A_KIND = 100
"""Most parts, or people, of a study."""


def pairs_of(folder: Path) -> list[ImagePair]:
    """Find the pairs in a folder. Raises `UserError`."""
    pairs = find_pairs(folder)
    if len(pairs) > MOST_PAIRS:
        raise UserError(f"{folder}: {len(pairs)} pairs: expected at most {MOST_PAIRS}")
    return pairs


def _frames(rig: PreparedRig, pair: ImagePair) -> FramePair:
    """Load a pair in the form that cameras deliver. Raises `ImageError`."""
    return FramePair.of_images(*load_pair(rig.rig, pair.left, pair.right))


def good_target(rig: PreparedRig, job: Job, frames: FramePair) -> Target | str:
    """The only good part in a pair, or why there is not exactly one."""
    outcome = locate(frames, job, rig)
    good = [target for target in outcome.targets if target.reject is Reject.NONE]
    if len(good) == 1 and np.isfinite(good[0].covariance).all():
        return good[0]
    return f"{len(good)} good parts, expected one" if good else f"no good part: {outcome.status}"


def _good_targets(
    rig: PreparedRig, job: Job, pairs: Sequence[ImagePair]
) -> tuple[dict[str, Target], dict[str, str]]:
    """The good part of each pair that shows one, and why other pairs do not count, by name."""
    looked = {pair.name: good_target(rig, job, _frames(rig, pair)) for pair in pairs}
    missing = {name: why for name, why in looked.items() if isinstance(why, str)}
    return {name: found for name, found in looked.items() if not isinstance(found, str)}, missing


def poses_in(rig: PreparedRig, job: Job, pairs: Sequence[ImagePair]) -> tuple[PlacedPoses, dict[str, str]]:
    """Poses of the part in the pairs that show it well, and why other pairs do not count, by name."""
    found, missing = _good_targets(rig, job, pairs)
    own, moved, circles = [], [], []
    names = [{circle.name for circle in target.circles} for target in found.values()]
    common = sorted(set.intersection(*names)) if names else []
    for target in found.values():
        alone, points_mm = own_and_points(target)
        place = target.rig_from_part[:3, 3]
        own.append(alone[:3, :3])
        lever = np.hstack([np.eye(3), -skew(place)])
        moved.append(lever @ motion_of_points(rig.rig, points_mm))
        seen = {circle.name: circle.centre_mm for circle in target.circles}
        centres = np.array([seen[name] for name in common]).reshape(-1, 3)
        circles.append(apply(invert(target.rig_from_part), centres))
    count, parameters = len(found), rig.rig.covariance
    width = len(rig.rig.parameter_names)
    return PlacedPoses(
        tuple(found),
        np.array([target.rig_from_part for target in found.values()]).reshape(count, 4, 4),
        np.array(own).reshape(count, 3, 3),
        np.array(moved).reshape(count, 3, width),
        np.zeros((width, width)) if parameters is None else parameters,
        np.array(circles).reshape(count, len(common), 3),
    ), missing


def read_truth(path: Path) -> dict[str, FloatArray]:
    """Read positions (3,) of a stage, mm, by pair name: lines of `NAME,x,y,z`. Raises `FileFormatError`."""
    rows = read_named(path, (3,), "NAME,x,y,z in mm")
    return {name: np.array(numbers) for name, numbers in rows.items()}


def sizes_in(
    rig: PreparedRig, job: Job, pairs: Sequence[ImagePair], size: str
) -> tuple[dict[str, tuple[float, float]], dict[str, str]]:
    """A size and its sigma, mm, in each pair that shows the part well, and why other pairs do not count.

    size : a measurement of the job, a circle (its diameter), or two circles as A-B. Raises `UserError`.
    """
    good, missing = _good_targets(rig, job, pairs)
    lengths = {name: length_of(target, size, 1.0) for name, target in good.items()}
    return {name: (length.measured_mm, length.sigma_mm) for name, length in lengths.items()}, missing


def still_in(rig: PreparedRig, job: Job, pairs: Sequence[ImagePair]) -> StillResult:
    """Result of a still test: many pictures of a part that is not moved."""
    stands: list[StillSample | None] = []
    for pair in pairs:
        inspection = inspect(_frames(rig, pair), job, rig)
        good = [part for part in inspection.measured if not part.target.reject]
        best = max(good, key=lambda part: part.target.match.score, default=None)
        stands.append(None if best is None else stand_of(best))
    return still_part(rig, job, stands)


def studied_folders(folder: Path) -> Iterator[tuple[str, str, list[ImagePair]]]:
    """Part, person and pairs of each `folder/PART/PERSON`. Raises `UserError` that names what is wrong."""
    for part in _folders(folder):
        for person in _folders(part):
            yield part.name, person.name, pairs_of(person)


def _folders(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder: expected {folder}/PART/PERSON with pairs of pictures")
    found = sorted(path for path in folder.iterdir() if path.is_dir())
    if not 1 <= len(found) <= MOST_OF_A_KIND:
        raise UserError(f"{folder}: {len(found)} folders: expected 1 to {MOST_OF_A_KIND}")
    return found


def crossed(values: Mapping[tuple[str, str], Sequence[float]], folder: Path) -> FloatArray:
    """Values by part and person as an array (parts, people, trials). Raises `UserError` if incomplete."""
    parts = sorted({part for part, _ in values})
    people = sorted({person for _, person in values})
    trials = {len(some) for some in values.values()}
    for part in parts:
        for person in people:
            if (part, person) not in values:
                raise UserError(
                    f"{folder}: {person} did not measure {part}: expected everybody at every part"
                )
    if len(trials) != 1:
        counts = ", ".join(f"{part}/{person} {len(some)}" for (part, person), some in values.items())
        raise UserError(f"{folder}: not as many good pairs of each: {counts}")
    return np.array([[values[part, person] for person in people] for part in parts])
