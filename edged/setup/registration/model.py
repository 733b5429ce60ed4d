"""State of a registration draft as kept on disc, validated on reading; pictures are stored beside it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from edged.errors import CalibrationError
from edged.robot.orientations import Brand
from edged.setup.documents import Frozen
from edged.setup.history import Digest, History, Kept, Text
from edged.vision.boards.board import parse_boards

MOST = 200
"""Limit on samples, and on pictures of places to touch."""
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
    """A place that a tip can touch. key : "mark-1-2" of a board, "circle-c0" of a part. rig_mm : position;
    left, right : raw px."""

    key: Annotated[str, Field(max_length=100)]
    kind: Literal["mark", "circle", "slot", "corner", "reference"]
    name: Text
    rig_mm: Point
    left: Pixel
    right: Pixel


class LookState(Kept):
    """A pair in which places were searched. reason : why there are none.

    length_percent : by how much the board is longer than stated, if that is the reason.
    """

    name: LookName
    places: Annotated[tuple[Place, ...], Field(max_length=MOST)] = ()
    reason: Text = ""
    length_percent: float | None = None


class SampleState(Kept):
    """A touched point in the pictures of a look, or a pose with pictures under its own name.

    view : rig_from_board; None where the board was not found, with the reason as in `LookState`.
    """

    place: Place | None = None
    look: LookName | None = None
    view: Pose | None = None
    reason: Text = ""
    length_percent: float | None = None


class RegistrationOperation(Kept):
    """An operation that can be undone. numbers : those added or written, as the robot shows them."""

    what: Literal["add", "write", "remove", "restore"]
    sample: SampleName
    numbers: Numbers | None = None


class SolvedState(Kept):
    """A registered rig. digest : SHA-256 of its file."""

    digest: Digest


class Confirmed(Kept):
    """A place that was touched to see whether the registration holds. off_mm : robot minus expected."""

    place: Place
    numbers: Numbers
    off_mm: Point


class RegistrationState(History[RegistrationOperation]):
    """A draft. calibration_id : of the rig that it was begun with. board : as `parse_boards` takes it, or "".

    looked : the last pair in which places were searched. brand : None if not stated.
    """

    outcome = ("solved", "confirmed")
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
        """Names of all samples in the order they were taken, without undone ones."""
        return tuple(dict.fromkeys(step.sample for step in self.holding if step.what == "add"))

    @property
    def used(self) -> tuple[str, ...]:
        """Names of the samples that are not excluded."""
        last = {step.sample: step.what for step in self.holding if step.what != "write"}
        return tuple(name for name in self.taken if last[name] != "remove")

    @property
    def numbers(self) -> dict[str, tuple[float, ...]]:
        """Numbers of each sample as the robot showed them; samples without numbers yet are missing."""
        return {step.sample: step.numbers for step in self.holding if step.numbers is not None}


def check_kind(mount: Mount, kind: Kind) -> None:
    """Check that mount and kind fit together. Raises `CalibrationError` if not."""
    if mount == "flange" and kind == "touch":
        raise CalibrationError("touched points are for cameras that stand still")


class SkyDocument(Frozen):
    """Direction and rotation of the flange at a pose, relative to the first pose."""

    name: str
    tilt_deg: float
    azimuth_deg: float
    turn_deg: float
