"""Functions that the worker process runs for registrations.

They store pictures and find the places that a tip can touch, or the pose of the board that the flange holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Reject, Target
from edged.pictures.encoding import shrunk
from edged.pipeline import locate, prepare
from edged.setup.inuse import RigInUse
from edged.setup.outlines import seen_at
from edged.setup.pairs import Pair, write_pair
from edged.setup.registration import verdict
from edged.setup.registration.model import LookState, Place, SampleState
from edged.setup.registration.sampling import SeenBoard, see_board
from edged.setup.registration.verdict import Judged, judge_points
from edged.vision.boards.board import NominalBoard, NotDetected
from edged.vision.calibration.calibrate import marks_in_both
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.part.job import Job

Images = tuple[Image, Image]
ACROSS = 3
"""Marks of a board that are offered along each side: both corners and the middle."""
LENGTH_PERCENT = 0.3
"""If a board is longer or shorter by more, its stated length or that of the calibration's board is wrong."""
SAME_MM = 0.05
"""A reference point nearer than this to a feature is not offered separately."""
WIDEST_PX = 640
"""Width of the small pictures."""


def marks_to_touch(folder: Path, name: str, images: Images, rig: RigInUse, board: NominalBoard) -> LookState:
    """Store a pair, and find marks of a board in it. Raises `CalibrationError` as `_keep`, `UserError`."""
    seen = _see_board(folder, name, images, rig, board)
    if not isinstance(seen, SeenBoard):
        return LookState(name=name, **seen)
    ids, _, _ = marks_in_both(seen.view)
    return LookState(name=name, places=marks_at(rig.stereo(), board, seen.rig_from_board, ids.tolist()))


def features_to_touch(folder: Path, name: str, images: Images, rig: RigInUse, job: Job) -> LookState:
    """Store a pair, and find the only part in it. Raises as `marks_to_touch`."""
    _keep(folder, name, images)
    outcome = locate(FramePair.of_images(*images), job, prepare(rig.stereo()))
    good = [target for target in outcome.targets if target.reject == Reject.NONE]
    if len(good) != 1:
        what = f"{len(good)} parts: leave one of them there" if good else f"no good part: {outcome.status}"
        return LookState(name=name, reason=what)
    return LookState(name=name, places=tuple(_features(rig.stereo(), good[0])))


def pose_with_board(
    folder: Path, name: str, images: Images, rig: RigInUse, board: NominalBoard
) -> SampleState:
    """Store a pair of the board at one pose of the flange. Raises as `marks_to_touch`."""
    seen = _see_board(folder, name, images, rig, board)
    if not isinstance(seen, SeenBoard):
        return SampleState(**seen)
    return SampleState.model_validate({"view": tuple(map(tuple, seen.rig_from_board.tolist()))})


def judge_touch(rig: RigInUse, *samples: Any) -> Judged:
    """`judge_points` with the rig in use."""
    return judge_points(rig.stereo(), *samples)


def judge_poses(rig: RigInUse, *samples: Any) -> Judged:
    """`verdict.judge_poses` with the rig in use."""
    return verdict.judge_poses(rig.stereo(), *samples)


def _see_board(
    folder: Path, name: str, images: Images, rig: RigInUse, board: NominalBoard
) -> SeenBoard | dict[str, Any]:
    """Store a pair; return the board in it, or the fields that say why it is not used."""
    _keep(folder, name, images)
    seen = see_board(rig.stereo(), Pair.of_images(name, *images), board)
    if isinstance(seen, NotDetected):
        return {"reason": seen.reason}
    size = seen.check.size
    if size.verdict(LENGTH_PERCENT) != "NOT_OK":
        return seen
    reason = (
        f"by the calibration the board measures {size.measured_mm:.2f} mm from corner to corner, its mm say "
        f"{size.true_mm:.2f}: one of them is wrong"
    )
    return {"reason": reason, "length_percent": size.error_percent}


def marks_at(
    rig: StereoRig, board: NominalBoard, rig_from_board: FloatArray, seen: Sequence[int] | None = None
) -> tuple[Place, ...]:
    """Marks of a board that are offered as places to touch. seen : indices of visible marks; None for all."""
    ids = range(len(board.points_mm)) if seen is None else seen
    places = []
    for (row, column), index in _spread(board.points_mm, ids).items():
        at = apply(rig_from_board, board.points_mm[index][None])[0]
        places.append(_place(rig, f"mark-{row}-{column}", "mark", f"{column}/{row}", at))
    return tuple(places)


def _keep(folder: Path, name: str, images: Images) -> None:
    """Write a pair to a draft. Raises as `write_pair`."""
    left, right = (shrunk(image, WIDEST_PX) for image in images)
    write_pair(folder, name, images, (left, right))


def _features(rig: StereoRig, target: Target) -> list[Place]:
    found = [("circle", circle.name, circle.centre_mm) for circle in target.circles]
    found += [("slot", slot.name, slot.centre_mm) for slot in target.slots]
    found += [("corner", corner.name, corner.position_mm) for corner in target.corners]
    places = [_place(rig, f"{kind}-{name}", kind, name, at) for kind, name, at in found]
    reference = target.position_mm
    if all(np.linalg.norm(reference - at) > SAME_MM for _, _, at in found):
        places.append(_place(rig, "reference", "reference", "", reference))
    return places


def _place(rig: StereoRig, key: str, kind: str, name: str, at_mm: FloatArray) -> Place:
    left, right = seen_at(at_mm, rig)
    rig_mm = tuple(at_mm.tolist())
    return Place.model_validate(
        {"key": key, "kind": kind, "name": name, "rig_mm": rig_mm, "left": left, "right": right}
    )


def _spread(points_mm: FloatArray, seen: Sequence[int]) -> dict[tuple[int, int], int]:
    """The marks nearest to an even grid over all that are seen: index by row and column, from 1."""
    marks = points_mm[list(seen), :2]
    low, high = marks.min(axis=0), marks.max(axis=0)
    found: dict[tuple[int, int], int] = {}
    for row in range(ACROSS):
        for column in range(ACROSS):
            wanted = low + (high - low) * np.array([column, row]) / (ACROSS - 1)
            index = int(seen[int(np.argmin(np.linalg.norm(marks - wanted, axis=1)))])
            if index not in found.values():
                found[row + 1, column + 1] = index
    return found
