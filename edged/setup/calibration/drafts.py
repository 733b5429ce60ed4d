"""Drafts of calibrations, saved to disc after each step, so that a killed process loses nothing.

ID/state.json             written last, so that all files it names exist
ID/pictures/              NAME_left.png, NAME_right.png: a folder as `edged calibrate` takes it
ID/small/                 the same as small JPEGs
ID/rig-DIGEST.json        the solved rig; its report is beside it
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from pydantic import JsonValue

from edged.domain.arrays import SIDES, Image
from edged.errors import CalibrationError
from edged.files.atomic import read_bytes
from edged.files.pairs import ImagePair
from edged.setup.calibration.model import DraftState, Operation, PictureState, SolvedCalibration, ViewState
from edged.setup.calibration.shown import Seen, seen_in
from edged.setup.calibration.views import Looked, Views, look_at
from edged.setup.history import DraftFile, DraftFolders, beginning, solved_file, solved_rig, write_solved
from edged.setup.pairs import Pair, Progress, silent, write_pair
from edged.vision.boards.board import NominalBoard, parse_boards
from edged.vision.calibration.lenschoice import LensWish

KEPT = 10
"""Number of drafts kept; the oldest is deleted when there is one more. Twenty pairs of 1280x960 are 40 MB."""
RIG, REPORT = "rig-*.json", "report-*.html"
Looks = tuple[Looked, Looked]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A rig as a file, its report, and its figures as JSON."""

    calibration_id: str
    rig: bytes
    report: bytes
    figures: dict[str, JsonValue]


class Draft(DraftFile[DraftState]):
    """A draft of a calibration."""

    @property
    def next_view(self) -> str:
        """Name for the next view, never used before."""
        return f"view_{max((int(name[-3:]) for name in self.state.views), default=0) + 1:03}"

    def add(self, name: str, left: Seen, right: Seen) -> None:
        """Record a view whose pictures are in the folder."""
        view = ViewState(left=_kept(left), right=_kept(right))
        views = {**self.state.views, name: view}
        self.write(self.state.operated(Operation(what="add", view=name), views=views))

    def remove(self, name: str) -> None:
        """Exclude a view. Raises `KeyError` for one that is not in use."""
        if name not in self.state.used:
            raise KeyError(name)
        self.write(self.state.operated(Operation(what="remove", view=name)))

    def set_boards(self, boards: Sequence[str]) -> None:
        """Set the boards. Raises `CalibrationError` for an invalid one, or if there are views already."""
        parse_boards(",".join(boards))
        if self.state.taken:
            raise CalibrationError("there are views already: begin another draft for another board")
        self.write(self.state.changed(boards=tuple(boards)))

    def set_goal(self, goal_um: float | None) -> None:
        """Set the sigma to reach."""
        self.write(self.state.changed(goal_um=goal_um))

    def solve(self, solution: Solution) -> None:
        """Keep the rig that the views were solved to."""
        digest = hashlib.sha256(solution.rig).hexdigest()
        solved = SolvedCalibration(
            calibration_id=solution.calibration_id, digest=digest, figures=solution.figures
        )
        files = {RIG: solution.rig, REPORT: solution.report}
        write_solved(self, self.state.changed(solved=solved), digest, files)

    def rig(self) -> bytes:
        """Content of the rig file that the draft was solved to. Raises as `solved_rig`."""
        solved = self.state.solved
        return solved_rig(self.folder, None if solved is None else solved.digest, "views")

    def report(self) -> bytes:
        """Content of the report's page. Raises as `rig`."""
        digest = hashlib.sha256(self.rig()).hexdigest()
        return read_bytes(solved_file(self.folder, REPORT, digest), "a report")


class Drafts(DraftFolders[DraftState, Draft]):
    """All drafts of a cell, in a folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, DraftState, Draft, ("pictures", "small"), KEPT, _pictures)

    def create(
        self,
        author: str,
        boards: Sequence[str],
        goal_um: float | None,
        lens: LensWish,
        now: datetime,
        **more: Any,
    ) -> Draft:
        """Create a draft, and delete any beyond `KEPT`. Raises `CalibrationError` for a bad board, `OSError`.

        more : other fields of the state.
        """
        if boards:
            parse_boards(",".join(boards))
        about = {"boards": tuple(boards), "goal_um": goal_um, "lens": lens, "views": {}, **more}
        return self.add(DraftState.model_validate({**beginning(author, now), **about}))


def _pictures(state: DraftState) -> list[str]:
    return [f"{name}_{side}.png" for name in state.taken for side in SIDES]


# --- pictures ---------------------------------------------------------------------------------


def pair_of(pictures: Path, name: str) -> Pair:
    """A stored pair, as the command line reads it."""
    left, right = (pictures / f"{name}_{side}.png" for side in SIDES)
    return Pair.of_files(ImagePair(name, left, right))


def keep_pair(
    folder: Path, name: str, left: Image, right: Image, boards: Sequence[NominalBoard]
) -> tuple[Looks, Seen, Seen]:
    """Store a new pair of a draft, and find the boards in it. Raises `CalibrationError` if not writable."""
    (looks,) = look_at([Pair.of_images(name, left, right)], boards)
    write_pair(folder, name, (left, right), (looks[0].small, looks[1].small))
    seen_left, seen_right = (
        seen_in(image, boards, looked.results) for image, looked in zip((left, right), looks, strict=True)
    )
    return looks, seen_left, seen_right


def views_of(
    pictures: Path, names: Sequence[str], boards: Sequence[NominalBoard], looks: Mapping[str, Looks]
) -> Views:
    """The pairs of a draft, in their order, with the known findings in each."""
    views = Views(boards)
    for name in names:
        views.put(pair_of(pictures, name), *looks[name])
    return views


def look_again(
    pictures: Path, names: Sequence[str], boards: Sequence[NominalBoard], progress: Progress = silent
) -> dict[str, Looks]:
    """Find the boards in stored pairs again, after a restart."""
    looked = look_at([pair_of(pictures, name) for name in names], boards, progress)
    return dict(zip(names, looked, strict=True))


def _kept(seen: Seen) -> PictureState:
    if seen.outline is None:
        return PictureState(outline=None, reason=seen.reason)
    a, b, c, d = ((round(float(x), 2), round(float(y), 2)) for x, y in seen.outline)
    return PictureState(outline=(a, b, c, d), clipped=seen.clipped)
