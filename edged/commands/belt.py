"""`edged belt`: direction and scale of a conveyor belt, measured with a board that it carries."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError, UserError
from edged.files.images import load_image
from edged.files.rig import load_rig
from edged.robot.belt import step_between
from edged.robot.picking import frame_of
from edged.setup.pairs import Pair, Picture
from edged.setup.registration.registering import rig_from_board
from edged.vision.boards.board import NotDetected, parse_boards
from edged.vision.geometry.camera import StereoRig


@dataclass(frozen=True, slots=True)
class CountedPair:
    """Pictures of the board taken while the belt stood, and the encoder count then."""

    count: int
    left: Path
    right: Path


def belt(rig: Path, board: str, first: CountedPair, second: CountedPair, console: Console) -> int:
    """Print `[belt]` for cell.toml. Raises `UserError`."""
    loaded = load_rig(rig)
    if frame_of(loaded).robot_from_rig is None:
        raise UserError(f"--rig {rig}: not registered to a robot that stands beside it (edged register)")
    start, end = (_board_at(loaded, board, pair) for pair in (first, second))
    try:
        step_mm = step_between(start, end, second.count - first.count)
    except CalibrationError as error:
        raise UserError(str(error)) from error
    moved_mm = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    console.print(
        f"# the board moved by {moved_mm:.3f} mm in {second.count - first.count} counts", markup=False
    )
    console.print("[belt]", markup=False, highlight=False)
    for name, numbers in (("mm_per_count", step_mm), ("first_mm", start[:3, 3].tolist())):
        digits = 9 if name == "mm_per_count" else 3
        text = ", ".join(f"{number:.{digits}f}" for number in numbers)
        console.print(f"{name} = [{text}]", markup=False, highlight=False)
    console.print("speed_mm_s = 200.0   # yours, the highest", markup=False, highlight=False)
    return 0


def _board_at(rig: StereoRig, board: str, pair: CountedPair) -> FloatArray:
    """Return robot_from_board (4, 4)."""
    try:
        pattern, *others = parse_boards(board)
    except CalibrationError as error:
        raise UserError(f"--board {board}: {error}") from error
    if others:
        raise UserError(f"--board {board}: expected one board")
    pictures = (Picture(str(path), partial(load_image, path)) for path in (pair.left, pair.right))
    seen = rig_from_board(rig, Pair(pair.left.stem, *pictures), pattern)
    if isinstance(seen, NotDetected):
        raise UserError(f"{pair.left}, {pair.right}: {seen.reason}")
    assert rig.robot_from_rig is not None
    return np.asarray(rig.robot_from_rig @ seen)
