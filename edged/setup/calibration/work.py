"""What the worker process can do: by name, with a `Progress` before the arguments. Imported there alone."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from edged.domain.arrays import FloatArray, Image
from edged.errors import UserError
from edged.setup.calibration import checking, drafts, guidance, shown
from edged.setup.calibration.checking import Finding, Limits
from edged.setup.calibration.drafts import Looks, Solution, views_of
from edged.setup.calibration.guidance import Guided
from edged.setup.calibration.shown import Seen, Watched
from edged.setup.calibration.solving import solution_of
from edged.setup.inuse import RigInUse
from edged.setup.pairs import Progress
from edged.vision.boards.board import NominalBoard
from edged.vision.calibration.lenschoice import LensWish
from edged.vision.part.job import Job

Boards = Sequence[NominalBoard]


def watch(_progress: Progress, left: Image, right: Image, boards: Boards, others: bool) -> Watched:
    """A live pair. others : look for another board where it shows none of these."""
    return shown.watch(left, right, boards, others=others)


def keep(
    _progress: Progress, folder: Path, name: str, left: Image, right: Image, boards: Boards
) -> tuple[Looks, Seen, Seen]:
    """A pair for a draft."""
    *looks, seen_left, seen_right = drafts.keep_pair(folder, name, left, right, boards)
    return (looks[0], looks[1]), seen_left, seen_right


def look_again(progress: Progress, pictures: Path, names: Sequence[str], boards: Boards) -> dict[str, Looks]:
    """Kept pairs."""
    return drafts.look_again(pictures, names, boards, progress)


def guide(
    progress: Progress,
    pictures: Path,
    boards: Boards,
    looks: Mapping[str, Looks],
    lens: LensWish,
    goal_um: float | None,
    taken: Sequence[FloatArray],
    share: float,
) -> Guided:
    """What the views in use give, and what comes next."""
    views = views_of(pictures, list(looks), boards, looks)
    return guidance.guide(views, lens, goal_um, taken, progress, share=share)


def solve(
    progress: Progress,
    pictures: Path,
    boards: Boards,
    looks: Mapping[str, Looks],
    lens: LensWish,
    former: RigInUse | None,
    about: Mapping[str, str],
) -> Solution:
    """The rig. former : the one in use before."""
    before = None
    with contextlib.suppress(UserError):
        before = None if former is None else former.stereo()
    return solution_of(views_of(pictures, list(looks), boards, looks), lens, about, before, progress)


def check_board(
    _progress: Progress, rig: RigInUse, images: tuple[Image, Image], board: NominalBoard, limits: Limits
) -> Finding:
    """What a pair of a board says of a rig."""
    checking.check_sizes(rig.stereo(), images, ("the pair", "the pair"))
    return checking.by_board(rig.stereo(), images, [board], limits)


def check_part(
    _progress: Progress,
    rig: RigInUse,
    images: tuple[Image, Image],
    job: Job,
    known_mm: Mapping[str, float],
    limits: Limits,
) -> Finding:
    """What a pair of a part says of a rig."""
    checking.check_sizes(rig.stereo(), images, ("the pair", "the pair"))
    return checking.by_part(rig.stereo(), images, job, known_mm, limits)
