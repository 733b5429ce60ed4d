"""What a calibration's draft keeps on disc: values, read with suspicion; pictures lie beside them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from edged.config.reading import problem_of
from edged.errors import CalibrationError, FileFormatError
from edged.vision.boards.board import NominalBoard, parse_boards

MOST_VIEWS = 500
DraftId = Annotated[str, Field(pattern=r"^[0-9]{8}-[0-9]{6}-[0-9a-f]{4}$")]
ViewName = Annotated[str, Field(pattern=r"^view_[0-9]{3}$")]
Text = Annotated[str, Field(max_length=2000)]
Corner = tuple[float, float]


class Kept(BaseModel):
    """Frozen, without keys that are not known, and every number finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class PictureState(Kept):
    """A board in a picture that was kept. outline : four corners, px; None: not found, with the reason."""

    outline: tuple[Corner, Corner, Corner, Corner] | None
    reason: Text = ""
    clipped: bool = False


class ViewState(Kept):
    """A pair that was kept."""

    left: PictureState
    right: PictureState


class Operation(Kept):
    """Something that can be undone."""

    what: Literal["add", "remove"]
    view: ViewName


class Solved(Kept):
    """A rig from the views in use. digest : SHA-256 of its file; figures : what there is to say about it."""

    calibration_id: Text
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    figures: dict[str, JsonValue]


class DraftState(Kept):
    """A draft. revision : counts every change.  mm : pitch of a board that is to be recognised.
    operations : `done` of them hold, the others were undone.
    """

    format: Literal["edged-calibration-draft"] = "edged-calibration-draft"
    version: Literal[1] = 1
    id: DraftId
    revision: Annotated[int, Field(ge=0)] = 0
    created: Text
    author: Text
    boards: Annotated[tuple[Text, ...], Field(max_length=8)]
    mm: Annotated[float, Field(gt=0, le=1e4)] | None = None
    goal_um: Annotated[float, Field(gt=0, le=1e6)] | None = None
    lens: Literal["division", "brown"] = "brown"
    operations: Annotated[tuple[Operation, ...], Field(max_length=4 * MOST_VIEWS)] = ()
    done: Annotated[int, Field(ge=0)] = 0
    views: Annotated[dict[ViewName, ViewState], Field(max_length=MOST_VIEWS)] = {}
    solved: Solved | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> DraftState:
        if self.done > len(self.operations):
            raise ValueError("more operations done than there are")
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
        """As they were stated; none as long as they are to be recognised."""
        return parse_boards(",".join(self.boards)) if self.boards else ()

    @property
    def taken(self) -> tuple[str, ...]:
        """Views there are, in the order they came; those that were undone are not."""
        done = self.operations[: self.done]
        return tuple(dict.fromkeys(operation.view for operation in done if operation.what == "add"))

    @property
    def used(self) -> tuple[str, ...]:
        """Views that nobody left out."""
        left_out: dict[str, bool] = {}
        for operation in self.operations[: self.done]:
            left_out[operation.view] = operation.what == "remove"
        return tuple(name for name in self.taken if not left_out[name])

    def changed(self, **changes: Any) -> DraftState:
        """With these fields, checked, one revision later."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return DraftState(**{**fields, **changes, "revision": self.revision + 1})

    def operated(self, operation: Operation, **changes: Any) -> DraftState:
        """With one operation more; what was undone is forgotten, and a solution is one of other views."""
        done = (*self.operations[: self.done], operation)
        return self.changed(operations=done, done=len(done), solved=None, **changes)


def state_of(data: bytes, place: str) -> DraftState:
    """The state in a file that was read. Raises `FileFormatError` that names place and first mistake."""
    try:
        return DraftState.model_validate_json(data)
    except ValidationError as error:
        raise FileFormatError(f"{place}: {problem_of(error.errors()[0], DraftState)}") from error
