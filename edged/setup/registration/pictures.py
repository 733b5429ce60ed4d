"""Pictures of a robot's registration: what a tip can touch in them, or where the flange holds the board."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image, Side
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Reject, Target
from edged.errors import CalibrationError
from edged.files.atomic import write_atomically
from edged.pipeline import locate, prepare
from edged.setup.pairs import Pair
from edged.setup.registration.drafts import LookState, Pixel, Place, SampleState
from edged.setup.registration.sampling import SeenBoard, see_board
from edged.vision.boards.board import NominalBoard, NotDetected
from edged.vision.calibration.calibrate import marks_in_both
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.part.job import Job

ACROSS = 3
"""Marks of a board that are offered along each side: its corners, the middle, and between them."""
LENGTH_PERCENT = 0.3
"""A board that is longer or shorter by more is another one, or the calibration's board was."""
SAME_MM = 0.05
"""A reference point that is nearer to a feature is that feature."""
WIDEST_PX = 640
"""Of the small pictures."""
_QUICK = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def marks_to_touch(
    folder: Path, name: str, left: Image, right: Image, rig: StereoRig, board: NominalBoard
) -> LookState:
    """Keep a pair, and look for marks of a board in it. Raises `CalibrationError` as `keep`, `UserError`."""
    keep(folder, name, left, right)
    seen = see_board(rig, Pair.of_images(name, left, right), board)
    if isinstance(seen, NotDetected):
        return LookState(name=name, reason=seen.reason)
    if reason := _other_length(seen):
        return LookState(name=name, reason=reason, length_percent=seen.check.size.error_percent)
    ids, _, _ = marks_in_both(seen.view)
    return LookState(name=name, places=marks_at(rig, board, seen.rig_from_board, ids.tolist()))


def features_to_touch(
    folder: Path, name: str, left: Image, right: Image, rig: StereoRig, job: Job
) -> LookState:
    """Keep a pair, and look for the one part in it. Raises as `marks_to_touch`."""
    keep(folder, name, left, right)
    pair = FramePair(Frame("left", 0, left, 0, 0), Frame("right", 0, right, 0, 0))
    outcome = locate(pair, job, prepare(rig))
    good = [target for target in outcome.targets if target.reject == Reject.NONE]
    if len(good) != 1:
        what = f"{len(good)} parts: leave one of them there" if good else f"no good part: {outcome.status}"
        return LookState(name=name, reason=what)
    return LookState(name=name, places=tuple(_features(rig, good[0])))


def pose_with_board(
    folder: Path, name: str, left: Image, right: Image, rig: StereoRig, board: NominalBoard
) -> SampleState:
    """Keep a pair of the board at one pose of the flange. Raises as `marks_to_touch`."""
    keep(folder, name, left, right)
    seen = see_board(rig, Pair.of_images(name, left, right), board)
    if isinstance(seen, NotDetected):
        return SampleState(reason=seen.reason)
    if reason := _other_length(seen):
        return SampleState(reason=reason, length_percent=seen.check.size.error_percent)
    return SampleState.model_validate({"view": tuple(map(tuple, seen.rig_from_board.tolist()))})


def marks_at(
    rig: StereoRig, board: NominalBoard, rig_from_board: FloatArray, seen: Sequence[int] | None = None
) -> tuple[Place, ...]:
    """Marks of a board that are offered, of those that are seen, by index; None: all of them."""
    ids = range(len(board.points_mm)) if seen is None else seen
    places = []
    for (row, column), index in _spread(board.points_mm, ids).items():
        at = apply(rig_from_board, board.points_mm[index][None])[0]
        places.append(_place(rig, f"mark-{row}-{column}", "mark", f"{column}/{row}", at))
    return tuple(places)


def keep(folder: Path, name: str, left: Image, right: Image) -> None:
    """Write a pair to a draft. Raises `CalibrationError` for a disc that refuses."""
    try:
        for side, image in zip(SIDES, (left, right), strict=True):
            write_atomically(folder / "pictures" / f"{name}_{side}.png", _encoded(".png", image, _QUICK))
            write_atomically(folder / "small" / f"{name}_{side}.jpg", _encoded(".jpg", _small(image), ()))
    except OSError as error:
        raise CalibrationError(f"{folder}: the pair cannot be kept: {error.strerror or error}") from error


def _other_length(seen: SeenBoard) -> str:
    """Why nothing may stand on it: by the rig it has another size than was stated; "" where it has that."""
    size = seen.check.size
    if size.verdict(LENGTH_PERCENT) != "NOT_OK":
        return ""
    return (
        f"by the calibration the board measures {size.measured_mm:.2f} mm from corner to corner, its mm say "
        f"{size.true_mm:.2f}: one of them is wrong"
    )


def _features(rig: StereoRig, target: Target) -> list[Place]:
    found = [("circle", one.name, one.centre_mm) for one in target.circles]
    found += [("slot", one.name, one.centre_mm) for one in target.slots]
    found += [("corner", one.name, one.position_mm) for one in target.corners]
    places = [_place(rig, f"{kind}-{name}", kind, name, at) for kind, name, at in found]
    reference = target.position_mm
    if all(np.linalg.norm(reference - at) > SAME_MM for _, _, at in found):
        places.append(_place(rig, "reference", "reference", "", reference))
    return places


def _place(rig: StereoRig, key: str, kind: str, name: str, at_mm: FloatArray) -> Place:
    left, right = (_pixel(rig, side, at_mm) for side in SIDES)
    rig_mm = tuple(at_mm.tolist())
    return Place.model_validate(
        {"key": key, "kind": kind, "name": name, "rig_mm": rig_mm, "left": left, "right": right}
    )


def _pixel(rig: StereoRig, side: Side, at_mm: FloatArray) -> Pixel:
    if side == "left":
        u, v = rig.left.project(at_mm[None])[0]
    else:
        u, v = rig.right.project(apply(rig.right_from_left, at_mm[None]))[0]
    return round(float(u), 1), round(float(v), 1)


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


def _small(image: Image) -> Image:
    height, width = image.shape
    if width <= WIDEST_PX:
        return image
    size = WIDEST_PX, round(height * WIDEST_PX / width)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _encoded(suffix: str, image: Image, options: Sequence[int]) -> bytes:
    _, data = cv2.imencode(suffix, image, list(options))
    return data.tobytes()
