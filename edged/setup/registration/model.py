"""What a registration's draft keeps on disc: values, read with suspicion; pictures lie beside them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from edged.errors import CalibrationError
from edged.robot.orientations import Brand
from edged.setup.documents import Frozen
from edged.setup.history import Digest, History, Kept, Text
from edged.vision.boards.board import parse_boards

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


class RegistrationOperation(Kept):
    """Something that can be undone. numbers : as the robot shows them, of what is added or written."""

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

    looked : the last pair of places. brand : None: not said.
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
        """Samples there are, in the order they came; those that were undone are not."""
        return tuple(dict.fromkeys(step.sample for step in self.holding if step.what == "add"))

    @property
    def used(self) -> tuple[str, ...]:
        """Samples that nobody left out."""
        last = {step.sample: step.what for step in self.holding if step.what != "write"}
        return tuple(name for name in self.taken if last[name] != "remove")

    @property
    def numbers(self) -> dict[str, tuple[float, ...]]:
        """Numbers of each sample, as the robot showed them; without those that nobody has stated yet."""
        return {step.sample: step.numbers for step in self.holding if step.numbers is not None}


def check_kind(mount: Mount, kind: Kind) -> None:
    """Raises `CalibrationError` where they do not fit each other."""
    if mount == "flange" and kind == "touch":
        raise CalibrationError("touched points are for cameras that stand still")


class SkyDocument(Frozen):
    """Where the flange looked at a pose, from the first one."""

    name: str
    tilt_deg: float
    azimuth_deg: float
    turn_deg: float
