"""What the worker process can do for registrations: by name, with a `Progress` before the arguments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from edged.domain.arrays import FloatArray, Image
from edged.files.rig import rig_of
from edged.robot.handeye import Mount
from edged.robot.orientations import Brand
from edged.setup.pairs import Progress
from edged.setup.registration import pictures as robotpictures
from edged.setup.registration import verdict as robotverdict
from edged.setup.registration.drafts import LookState, SampleState
from edged.setup.registration.verdict import Judged
from edged.vision.boards.board import NominalBoard
from edged.vision.part.job import Job


def marks_to_touch(
    _progress: Progress,
    folder: Path,
    name: str,
    left: Image,
    right: Image,
    rig: bytes,
    path: Path,
    board: NominalBoard,
) -> LookState:
    """Marks of a board, for a registration's draft. rig, path : the file of the one in use."""
    return robotpictures.marks_to_touch(folder, name, left, right, rig_of(rig, path), board)


def features_to_touch(
    _progress: Progress, folder: Path, name: str, left: Image, right: Image, rig: bytes, path: Path, job: Job
) -> LookState:
    """The same of a part."""
    return robotpictures.features_to_touch(folder, name, left, right, rig_of(rig, path), job)


def pose_with_board(
    _progress: Progress,
    folder: Path,
    name: str,
    left: Image,
    right: Image,
    rig: bytes,
    path: Path,
    board: NominalBoard,
) -> SampleState:
    """A pose of the flange, for a registration's draft."""
    return robotpictures.pose_with_board(folder, name, left, right, rig_of(rig, path), board)


def judge_touch(
    _progress: Progress,
    rig: bytes,
    path: Path,
    touched: Mapping[str, tuple[FloatArray, tuple[float, ...]]],
    brand: Brand | None,
    limit_mm: float,
) -> Judged:
    """What touched points say."""
    return robotverdict.judge_points(rig_of(rig, path), touched, brand, limit_mm)


def judge_poses(
    _progress: Progress,
    rig: bytes,
    path: Path,
    posed: Mapping[str, tuple[FloatArray, tuple[float, ...]]],
    board: NominalBoard,
    brand: Brand | None,
    mount: Mount,
    limit_mm: float,
) -> Judged:
    """What poses say."""
    return robotverdict.judge_poses(rig_of(rig, path), posed, board, brand, mount, limit_mm)
