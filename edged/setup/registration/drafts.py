"""Drafts of a robot's registration: what was touched, or where the flange was, on disc after each step.

ID/state.json             written last: what it names is there
ID/pictures/              NAME_left.png, NAME_right.png: a folder as `edged register` takes it
ID/small/                 the same as JPEGs
ID/rig-DIGEST.json        what came of them
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from edged.domain.arrays import SIDES
from edged.errors import CalibrationError, FileFormatError
from edged.files.atomic import write_atomically
from edged.files.rig import read_rig
from edged.robot.orientations import Brand
from edged.setup.history import (
    DraftFolders,
    History,
    Kept,
    StateFile,
    Text,
    new_identity,
)
from edged.vision.boards.board import parse_boards

KEPT = 10
"""Drafts; with one more the oldest goes."""
MOST = 200
"""Samples, and pictures of places to touch."""
Mount = Literal["fixed", "flange"]
Kind = Literal["touch", "poses"]
SampleName = Annotated[str, Field(pattern=r"^(point|pose)_[0-9]{3}$")]
LookName = Annotated[str, Field(pattern=r"^look_[0-9]{3}$")]
Numbers = Annotated[tuple[float, ...], Field(min_length=3, max_length=7)]
Pixel = tuple[float, float]
Point = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
Pose = tuple[Row4, Row4, Row4, Row4]


class Place(Kept):
    """Something that a tip can touch. key : "mark-0" of a board, "circle-c0" of a part. rig_mm : where it is;
    left, right : raw px."""

    key: Annotated[str, Field(max_length=100)]
    kind: Literal["mark", "circle", "slot", "corner", "reference"]
    name: Text
    rig_mm: Point
    left: Pixel
    right: Pixel


class LookState(Kept):
    """A pair in which places were looked for. reason : why there are none.

    length_percent : by so much the board is longer than was stated, where that is why.
    """

    name: LookName
    places: Annotated[tuple[Place, ...], Field(max_length=MOST)] = ()
    reason: Text = ""
    length_percent: float | None = None


class SampleState(Kept):
    """A point that was touched, in the pictures of a look; or a pose, with pictures of its own name.

    view : rig_from_board; None where the board was not seen, with the reason as in a look.
    """

    place: Place | None = None
    look: LookName | None = None
    view: Pose | None = None
    reason: Text = ""
    length_percent: float | None = None


class Operation(Kept):
    """Something that can be undone. numbers : as the robot shows them, of what is added or written."""

    what: Literal["add", "write", "remove", "restore"]
    sample: SampleName
    numbers: Numbers | None = None


class SolvedState(Kept):
    """A registered rig. digest : SHA-256 of its file."""

    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Confirmed(Kept):
    """A place that was touched to see whether the registration holds. off_mm : robot minus expected."""

    place: Place
    numbers: Numbers
    off_mm: Point


class RegistrationState(History[Operation]):
    """A draft. calibration_id : of the rig that it was begun with. board : as `parse_boards` takes it, or "".

    looked : the last pair of places. brand : None: not said.
    """

    format: Literal["edged-registration-draft"] = "edged-registration-draft"
    version: Literal[1] = 1
    mount: Mount
    kind: Kind
    brand: Brand | None = None
    board: Text = ""
    limit_mm: Annotated[float, Field(gt=0, le=100)] = 0.5
    calibration_id: Text
    samples: Annotated[dict[SampleName, SampleState], Field(max_length=MOST, default_factory=dict)]
    looked: LookState | None = None
    looks: Annotated[int, Field(ge=0, le=MOST)] = 0
    solved: SolvedState | None = None
    confirmed: Confirmed | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> RegistrationState:
        if unknown := {operation.sample for operation in self.operations} - self.samples.keys():
            raise ValueError(f"operations on samples that are not there: {', '.join(sorted(unknown))}")
        if self.board:
            try:
                parse_boards(self.board)
            except CalibrationError as error:
                raise ValueError(str(error)) from error
        return self

    @property
    def taken(self) -> tuple[str, ...]:
        """Samples there are, in the order they came; those that were undone are not."""
        return tuple(dict.fromkeys(one.sample for one in self.holding if one.what == "add"))

    @property
    def used(self) -> tuple[str, ...]:
        """Samples that nobody left out."""
        out: dict[str, bool] = {}
        for one in self.holding:
            out[one.sample] = one.what == "remove" or (one.what == "write" and out.get(one.sample, False))
        return tuple(name for name in self.taken if not out[name])

    @property
    def numbers(self) -> dict[str, tuple[float, ...]]:
        """Of each sample, as the robot showed them; without those that nobody has stated yet."""
        return {one.sample: one.numbers for one in self.holding if one.numbers is not None}


class RobotDraft:
    """One draft. Each change is on disc when its method returns; it raises `OSError` where that refuses."""

    def __init__(self, file: StateFile[RegistrationState]) -> None:
        self._file = file

    @property
    def state(self) -> RegistrationState:
        """As it is on disc."""
        return self._file.state

    @property
    def folder(self) -> Path:
        """Where all of it is."""
        return self._file.folder

    @property
    def next_sample(self) -> str:
        """A name that no sample ever had. Raises `CalibrationError` for one too many."""
        stem = "point" if self.state.kind == "touch" else "pose"
        return _numbered(stem, len(self.state.samples))

    @property
    def next_look(self) -> str:
        """A name that no picture of places ever had. Raises `CalibrationError` for one too many."""
        return _numbered("look", self.state.looks)

    def small(self, name: str, side: str) -> Path:
        """The JPEG of a pose's picture, or of that of a look."""
        return self.folder / "small" / f"{name}_{side}.jpg"

    def look(self, look: LookState) -> None:
        """Take note of a pair in which places were looked for; its pictures are in the folder."""
        self._file.write(self.state.changed(looked=look, looks=self.state.looks + 1))

    def add(self, name: str, sample: SampleState, numbers: tuple[float, ...] | None) -> None:
        """Take note of a sample whose pictures are in the folder."""
        samples = {**self.state.samples, name: sample}
        self._operate(Operation(what="add", sample=name, numbers=numbers), samples=samples)

    def write(self, name: str, numbers: tuple[float, ...]) -> None:
        """Say what the robot showed. Raises `KeyError` for no sample."""
        self._check(name, self.state.taken)
        self._operate(Operation(what="write", sample=name, numbers=numbers))

    def remove(self, name: str) -> None:
        """Leave a sample out. Raises `KeyError` for one that is not in use."""
        self._check(name, self.state.used)
        self._operate(Operation(what="remove", sample=name))

    def restore(self, name: str) -> None:
        """Use it again. Raises `KeyError` for one that was not left out."""
        self._check(name, tuple(set(self.state.taken) - set(self.state.used)))
        self._operate(Operation(what="restore", sample=name))

    def undo(self) -> None:
        """Take the last operation back. Raises `CalibrationError` when there is none."""
        self._file.step(-1, solved=None, confirmed=None)

    def redo(self) -> None:
        """Do again what was taken back last. Raises `CalibrationError` when there is nothing."""
        self._file.step(1, solved=None, confirmed=None)

    def state_otherwise(self, **changes: Any) -> None:
        """Brand, mount or limit are others. Raises `CalibrationError` for a mount that does not fit."""
        state = self.state.changed(**changes, solved=None, confirmed=None)
        check_kind(state.mount, state.kind)
        self._file.write(state)

    def solve(self, rig: bytes) -> None:
        """Keep what the samples were solved to."""
        digest = hashlib.sha256(rig).hexdigest()
        write_atomically(self._solved(digest), rig)
        self._file.write(self.state.changed(solved=SolvedState(digest=digest), confirmed=None))
        for file in self.folder.glob("rig-*"):
            if file != self._solved(digest):
                file.unlink()

    def confirm(self, confirmed: Confirmed) -> None:
        """Keep how far a touch was from where it was expected."""
        self._file.write(self.state.changed(confirmed=confirmed))

    def rig(self) -> bytes:
        """What it was solved to. Raises `CalibrationError` if to nothing, `FileFormatError` if changed."""
        solved = self.state.solved
        if solved is None:
            raise CalibrationError("it is not solved, or samples came or went since then: solve it first")
        file = self._solved(solved.digest)
        data = read_rig(file)
        if hashlib.sha256(data).hexdigest() != solved.digest:
            raise FileFormatError(f"{file}: is not what it was solved to: solve it again")
        return data

    def _operate(self, operation: Operation, **changes: Any) -> None:
        """A solution is one of other samples from now on."""
        self._file.write(self.state.operated(operation, solved=None, confirmed=None, **changes))

    def _solved(self, digest: str) -> Path:
        return self.folder / f"rig-{digest[:16]}.json"

    def _check(self, name: str, among: Sequence[str]) -> None:
        if name not in among:
            raise KeyError(name)


class RobotDrafts:
    """All drafts of a cell, in a folder."""

    def __init__(self, folder: Path) -> None:
        places = ("pictures", "small")
        self._folders = DraftFolders(folder, RegistrationState, CalibrationError, places, KEPT, _pictures)

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
        """Begin one. Raises `CalibrationError` for what does not fit together, and `OSError`."""
        check_kind(mount, kind)
        if kind == "poses" and len(parse_boards(board)) != 1:
            raise CalibrationError("poses need one board")
        state = RegistrationState(
            id=new_identity(now),
            created=now.isoformat(timespec="seconds"),
            author=author,
            mount=mount,
            kind=kind,
            brand=brand,
            board=board,
            limit_mm=limit_mm,
            calibration_id=calibration_id,
            samples={},
        )
        return RobotDraft(self._folders.add(state))

    def names(self) -> list[str]:
        """Of all drafts, the youngest first."""
        return self._folders.names()

    def states(self) -> list[tuple[str, RegistrationState | FileFormatError]]:
        """Of all drafts, the youngest first: the identity, and the state or what is wrong with it."""
        return self._folders.states()

    def remove(self, identity: str) -> None:
        """Forget one. Raises `KeyError` when there is none."""
        self._folders.remove(identity)

    def load(self, identity: str) -> RobotDraft:
        """Read one. Raises `KeyError` when there is none, `FileFormatError` that says what is wrong."""
        return RobotDraft(self._folders.load(identity))


def _pictures(state: RegistrationState) -> list[str]:
    """Of poses: a touched place is kept in numbers."""
    return [f"{name}_{side}.png" for name in state.taken for side in SIDES] if state.kind == "poses" else []


def check_kind(mount: Mount, kind: Kind) -> None:
    """Raises `CalibrationError` where they do not fit each other."""
    if mount == "flange" and kind == "touch":
        raise CalibrationError("touched points are for cameras that stand still")


def _numbered(stem: str, there: int) -> str:
    if there >= MOST:
        raise CalibrationError(f"more than {MOST}: begin another draft")
    return f"{stem}_{there + 1:03}"


Change = Callable[[RobotDraft], None]
