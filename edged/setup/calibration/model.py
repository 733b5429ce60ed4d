"""State of a calibration draft as kept on disc, validated on reading; pictures are stored beside it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, JsonValue, model_validator

from edged.errors import CalibrationError
from edged.setup.history import MOST_OPERATIONS, Digest, History, Kept, Text
from edged.vision.boards.board import NominalBoard, parse_boards
from edged.vision.calibration.lenschoice import LensWish

MOST_VIEWS = MOST_OPERATIONS // 4
ViewName = Annotated[str, Field(pattern=r"^view_[0-9]{3}$")]
Corner = tuple[float, float]


class PictureState(Kept):
    """A board in a stored picture. outline : four corners, px; None if not found, with the reason."""

    outline: tuple[Corner, Corner, Corner, Corner] | None
    reason: Text = ""
    clipped: bool = False


class ViewState(Kept):
    """A stored pair."""

    left: PictureState
    right: PictureState


class Operation(Kept):
    """An operation that can be undone."""

    what: Literal["add", "remove"]
    view: ViewName


class SolvedCalibration(Kept):
    """A rig solved from the views in use. digest : SHA-256 of its file. figures : on its quality."""

    calibration_id: Text
    digest: Digest
    figures: dict[str, JsonValue]


class DraftState(History[Operation]):
    """A draft. mm : pitch of a board that is yet to be recognised."""

    outcome = ("solved",)
    format: Literal["edged-calibration-draft"] = "edged-calibration-draft"
    version: Literal[1] = 1
    boards: Annotated[tuple[Text, ...], Field(max_length=8)]
    mm: Annotated[float, Field(gt=0, le=1e4)] | None = None
    goal_um: Annotated[float, Field(gt=0, le=1e6)] | None = None
    lens: LensWish = "auto"
    views: Annotated[dict[ViewName, ViewState], Field(max_length=MOST_VIEWS, default_factory=dict)]
    solved: SolvedCalibration | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> DraftState:
        if unknown := {operation.view for operation in self.operations} - self.views.keys():
            raise ValueError(f"operations on views that are not there: {', '.join(sorted(unknown))}")
        if self.boards:
            try:
                parse_boards(",".join(self.boards))
            except CalibrationError as error:
                raise ValueError(str(error)) from error
        return self

    @property
    def board_models(self) -> tuple[NominalBoard, ...]:
        """The stated or recognised boards; none until one is recognised."""
        return parse_boards(",".join(self.boards)) if self.boards else ()

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of all views in the order they were taken, without undone ones."""
        return tuple(dict.fromkeys(step.view for step in self.holding if step.what == "add"))

    @property
    def used(self) -> tuple[str, ...]:
        """Names of the views that are not excluded by hand."""
        last = {step.view: step.what for step in self.holding}
        return tuple(name for name in self.taken if last[name] != "remove")
