"""Drafts of a robot's registration: touched points or flange poses, saved to disc after each step.

ID/state.json             written last, so that all files it names exist
ID/pictures/              NAME_left.png, NAME_right.png: a folder as `edged register` takes it
ID/small/                 the same as JPEGs
ID/rig-DIGEST.json        the registered rig
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from edged.domain.arrays import SIDES
from edged.errors import CalibrationError
from edged.robot.orientations import Brand
from edged.setup.history import DraftFile, DraftFolders, beginning, solved_rig, write_solved
from edged.setup.registration.model import (
    MOST,
    Confirmed,
    Kind,
    LookState,
    Mount,
    RegistrationOperation,
    RegistrationState,
    SampleState,
    SolvedState,
    check_kind,
)
from edged.vision.boards.board import parse_boards

KEPT = 10
"""Number of drafts kept; the oldest is deleted when there is one more."""


class RobotDraft(DraftFile[RegistrationState]):
    """A draft of a registration."""

    @property
    def next_sample(self) -> str:
        """Name for the next sample, never used before. Raises `CalibrationError` for too many samples."""
        stem = "point" if self.state.kind == "touch" else "pose"
        return _numbered(stem, len(self.state.samples))

    @property
    def next_look(self) -> str:
        """Name for the next picture of places, never used before. Raises `CalibrationError` for too many."""
        return _numbered("look", self.state.looks)

    def look(self, look: LookState) -> None:
        """Record a pair in which places were searched; its pictures are in the folder."""
        self.write(self.state.changed(looked=look, looks=self.state.looks + 1))

    def add(self, name: str, sample: SampleState, numbers: tuple[float, ...] | None) -> None:
        """Record a sample whose pictures are in the folder."""
        operation = RegistrationOperation(what="add", sample=name, numbers=numbers)
        self.write(self.state.operated(operation, samples={**self.state.samples, name: sample}))

    def write_numbers(self, name: str, numbers: tuple[float, ...]) -> None:
        """Record the numbers that the robot showed. Raises `KeyError` for an unknown sample."""
        self._operate("write", name, self.state.taken, numbers)

    def remove(self, name: str) -> None:
        """Exclude a sample. Raises `KeyError` for one that is not in use."""
        self._operate("remove", name, self.state.used)

    def restore(self, name: str) -> None:
        """Use an excluded sample again. Raises `KeyError` for one that was not excluded."""
        self._operate("restore", name, set(self.state.taken) - set(self.state.used))

    def _operate(
        self,
        what: Literal["write", "remove", "restore"],
        name: str,
        among: Collection[str],
        numbers: tuple[float, ...] | None = None,
    ) -> None:
        if name not in among:
            raise KeyError(name)
        self.write(self.state.operated(RegistrationOperation(what=what, sample=name, numbers=numbers)))

    def restate(self, **changes: Any) -> None:
        """Change brand, mount or limit. Raises `CalibrationError` for a mount that does not fit."""
        state = self.state.without_outcome(**changes)
        check_kind(state.mount, state.kind)
        self.write(state)

    def solve(self, rig: bytes) -> None:
        """Keep the rig that the samples were solved to."""
        digest = hashlib.sha256(rig).hexdigest()
        state = self.state.changed(solved=SolvedState(digest=digest), confirmed=None)
        write_solved(self, state, digest, {"rig-*.json": rig})

    def confirm(self, confirmed: Confirmed) -> None:
        """Keep how far a touch was from where it was expected."""
        self.write(self.state.changed(confirmed=confirmed))

    def rig(self) -> bytes:
        """Content of the rig file that the draft was solved to. Raises as `solved_rig`."""
        solved = self.state.solved
        return solved_rig(self.folder, None if solved is None else solved.digest, "samples")


class RobotDrafts(DraftFolders[RegistrationState, RobotDraft]):
    """All drafts of a cell, in a folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, RegistrationState, RobotDraft, ("pictures", "small"), KEPT, _pictures)

    def create(
        self,
        author: str,
        calibration_id: str,
        now: datetime,
        mount: Mount,
        kind: Kind,
        brand: Brand | None,
        board: str,
        limit_mm: float,
    ) -> RobotDraft:
        """Create a draft. Raises `CalibrationError` for settings that do not fit together, and `OSError`."""
        check_kind(mount, kind)
        if kind == "poses" and len(parse_boards(board)) != 1:
            raise CalibrationError("poses need one board")
        return self.add(
            RegistrationState(
                **beginning(author, now),
                mount=mount,
                kind=kind,
                brand=brand,
                board=board,
                limit_mm=limit_mm,
                calibration_id=calibration_id,
                samples={},
            )
        )


def _pictures(state: RegistrationState) -> list[str]:
    """Names of the pictures to keep: only those of poses, as touched places are kept as numbers."""
    return [f"{name}_{side}.png" for name in state.taken for side in SIDES] if state.kind == "poses" else []


def _numbered(stem: str, there: int) -> str:
    if there >= MOST:
        raise CalibrationError(f"more than {MOST}: begin another draft")
    return f"{stem}_{there + 1:03}"
