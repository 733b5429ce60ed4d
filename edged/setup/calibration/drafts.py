"""Drafts of calibrations: what people are at, on disc after each step, so that a kill loses nothing.

ID/state.json             written last: what it names is there
ID/pictures/              NAME_left.png, NAME_right.png: a folder as `edged calibrate` takes it
ID/small/                 the same as small JPEGs
ID/rig-DIGEST.json        what came of them, and its report
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import cv2
from pydantic import JsonValue

from edged.domain.arrays import SIDES, Image
from edged.errors import CalibrationError, FileFormatError
from edged.files.atomic import read_bytes, write_atomically
from edged.files.pairs import ImagePair
from edged.files.rig import read_rig
from edged.setup.calibration.model import DraftState, Operation, PictureState, Solved, ViewState
from edged.setup.calibration.shown import Seen, seen_in
from edged.setup.calibration.views import Looked, Views, look_at
from edged.setup.history import DraftFolders, StateFile, new_identity
from edged.setup.pairs import Pair, Progress, silent
from edged.vision.boards.board import NominalBoard, parse_boards
from edged.vision.calibration.lenschoice import LensWish

KEPT = 10
"""Drafts; with one more the oldest goes. Twenty pairs of 1280x960 are 40 MB."""
_QUICK = (cv2.IMWRITE_PNG_COMPRESSION, 1)
Looks = tuple[Looked, Looked]


class Draft:
    """One draft. Each change is on disc when its method returns; it raises `OSError` where that refuses."""

    def __init__(self, file: StateFile[DraftState]) -> None:
        self._file = file

    @property
    def state(self) -> DraftState:
        """As it is on disc."""
        return self._file.state

    @property
    def folder(self) -> Path:
        """Where all of it is."""
        return self._file.folder

    @property
    def pictures(self) -> Path:
        """The folder of its pairs."""
        return self.folder / "pictures"

    @property
    def next_view(self) -> str:
        """A name that no view ever had."""
        return f"view_{max((int(name[-3:]) for name in self.state.views), default=0) + 1:03}"

    def thumbnail(self, name: str, side: str) -> Path:
        """The small picture of a view."""
        return self.folder / "small" / f"{name}_{side}.jpg"

    def add(self, name: str, left: Seen, right: Seen) -> None:
        """Take note of a view whose pictures are in the folder."""
        view = ViewState(left=_kept(left), right=_kept(right))
        self._operate(Operation(what="add", view=name), views={**self.state.views, name: view})

    def remove(self, name: str) -> None:
        """Leave a view out. Raises `KeyError` for one that is not in use."""
        if name not in self.state.used:
            raise KeyError(name)
        self._operate(Operation(what="remove", view=name))

    def undo(self) -> None:
        """Take the last operation back. Raises `CalibrationError` when there is none."""
        self._file.step(-1, solved=None)

    def redo(self) -> None:
        """Do again what was taken back last. Raises `CalibrationError` when there is nothing."""
        self._file.step(1, solved=None)

    def _operate(self, operation: Operation, **changes: Any) -> None:
        """A solution is one of other views from now on."""
        self._file.write(self.state.operated(operation, solved=None, **changes))

    def set_boards(self, boards: Sequence[str]) -> None:
        """State what the pictures show. Raises `CalibrationError` for no board, or once there are views."""
        parse_boards(",".join(boards))
        if self.state.taken:
            raise CalibrationError("there are views already: begin another draft for another board")
        self._file.write(self.state.changed(boards=tuple(boards)))

    def set_goal(self, goal_um: float | None) -> None:
        """Up to which sigma people want to go."""
        self._file.write(self.state.changed(goal_um=goal_um))

    def solve(self, solution: Solution) -> None:
        """Keep what the views were solved to."""
        digest = hashlib.sha256(solution.rig).hexdigest()
        write_atomically(self._solved("rig", digest), solution.rig)
        write_atomically(self._solved("report", digest), solution.report)
        solved = Solved(calibration_id=solution.calibration_id, digest=digest, figures=solution.figures)
        self._file.write(self.state.changed(solved=solved))
        for stem in ("rig", "report"):
            for file in self.folder.glob(f"{stem}-*"):
                if file != self._solved(stem, digest):
                    file.unlink()

    def rig(self) -> bytes:
        """What it was solved to. Raises `CalibrationError` if to nothing, `FileFormatError` if changed."""
        solved = self.state.solved
        if solved is None:
            raise CalibrationError("it is not solved, or views came or went since then: solve it first")
        file = self._solved("rig", solved.digest)
        data = read_rig(file)
        if hashlib.sha256(data).hexdigest() != solved.digest:
            raise FileFormatError(f"{file}: is not what it was solved to: solve it again")
        return data

    def report(self) -> bytes:
        """The report's page. Raises as `rig`."""
        self.rig()
        assert self.state.solved is not None
        return read_bytes(self._solved("report", self.state.solved.digest), "a report")

    def _solved(self, stem: Literal["rig", "report"], digest: str) -> Path:
        return self.folder / f"{stem}-{digest[:16]}.{'json' if stem == 'rig' else 'html'}"


class Drafts:
    """All drafts of a cell, in a folder."""

    def __init__(self, folder: Path) -> None:
        places = ("pictures", "small")
        self._folders = DraftFolders(folder, DraftState, CalibrationError, places, KEPT, _pictures)

    def create(
        self,
        author: str,
        boards: Sequence[str],
        goal_um: float | None,
        lens: LensWish,
        now: datetime,
        mm: float | None = None,
    ) -> Draft:
        """Begin one; the oldest beyond `KEPT` go. Raises `CalibrationError` for no board, and `OSError`."""
        if boards:
            parse_boards(",".join(boards))
        state = DraftState(
            id=new_identity(now),
            created=now.isoformat(timespec="seconds"),
            author=author,
            boards=tuple(boards),
            mm=mm,
            goal_um=goal_um,
            lens=lens,
            views={},
        )
        return Draft(self._folders.add(state))

    def names(self) -> list[str]:
        """Of all drafts, the youngest first."""
        return self._folders.names()

    def states(self) -> list[tuple[str, DraftState | FileFormatError]]:
        """Of all drafts, the youngest first: the identity, and the state or what is wrong with it."""
        return self._folders.states()

    def remove(self, identity: str) -> None:
        """Forget one. Raises `KeyError` when there is none."""
        self._folders.remove(identity)

    def load(self, identity: str) -> Draft:
        """Read one. Raises `KeyError` when there is none, `FileFormatError` that says what is wrong."""
        return Draft(self._folders.load(identity))


def _pictures(state: DraftState) -> list[str]:
    return [f"{name}_{side}.png" for name in state.taken for side in SIDES]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A rig as a file, its report, and what there is to say about it, as JSON."""

    calibration_id: str
    rig: bytes
    report: bytes
    figures: dict[str, JsonValue]


# --- pictures ---------------------------------------------------------------------------------


def pair_of(pictures: Path, name: str) -> Pair:
    """A kept pair, as the command line reads it."""
    left, right = (pictures / f"{name}_{side}.png" for side in SIDES)
    return Pair.of_files(ImagePair(name, left, right))


def keep_pair(
    folder: Path, name: str, left: Image, right: Image, boards: Sequence[NominalBoard]
) -> tuple[Looked, Looked, Seen, Seen]:
    """Write a draft's new pair, and look at it in full. Raises `CalibrationError` for a disc that refuses."""
    ((looked_left, looked_right),) = look_at([Pair.of_images(name, left, right)], boards)
    try:
        for side, image, looked in zip(SIDES, (left, right), (looked_left, looked_right), strict=True):
            write_atomically(folder / "pictures" / f"{name}_{side}.png", _encoded(".png", image, _QUICK))
            write_atomically(folder / "small" / f"{name}_{side}.jpg", _encoded(".jpg", looked.small, ()))
    except OSError as error:
        raise CalibrationError(f"{folder}: the pair cannot be kept: {error.strerror or error}") from error
    seen = [
        seen_in(image, boards, looked.results)
        for image, looked in ((left, looked_left), (right, looked_right))
    ]
    return looked_left, looked_right, seen[0], seen[1]


def views_of(
    pictures: Path, names: Sequence[str], boards: Sequence[NominalBoard], looks: Mapping[str, Looks]
) -> Views:
    """The pairs of a draft, in their order, by what is known of each."""
    views = Views(boards)
    for name in names:
        views.put(pair_of(pictures, name), *looks[name])
    return views


def look_again(
    pictures: Path, names: Sequence[str], boards: Sequence[NominalBoard], progress: Progress = silent
) -> dict[str, Looks]:
    """What kept pairs show, after a restart."""
    looked = look_at([pair_of(pictures, name) for name in names], boards, progress)
    return dict(zip(names, looked, strict=True))


def _encoded(suffix: str, image: Image, options: Sequence[int]) -> bytes:
    _, data = cv2.imencode(suffix, image, list(options))
    return data.tobytes()


def _kept(seen: Seen) -> PictureState:
    if seen.outline is None:
        return PictureState(outline=None, reason=seen.reason)
    a, b, c, d = ((round(float(x), 2), round(float(y), 2)) for x, y in seen.outline)
    return PictureState(outline=(a, b, c, d), clipped=seen.clipped)
