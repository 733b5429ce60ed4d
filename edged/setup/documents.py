"""Documents shared by several setup topics: heads of drafts, problems, pictures, poses, sigmas."""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Generic, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from edged.config.reading import problem_of
from edged.errors import FileFormatError, without_folders
from edged.files.atomic import make_folders, read_bytes, write_atomically

log = logging.getLogger(__name__)


class Frozen(BaseModel):
    """An immutable model; can be made from values, or from an object with attributes of the same names."""

    model_config = ConfigDict(
        frozen=True, from_attributes=True, json_schema_serialization_defaults_required=True
    )


def now_text() -> str:
    """The current time, UTC, to the second, in the form of documents."""
    return datetime.now(UTC).isoformat(timespec="seconds")


Message = Annotated[str, AfterValidator(without_folders)]
"""Text of an error for pages, with the names of files but not their folders on this machine."""
M = TypeVar("M", bound=Frozen)
B = TypeVar("B", bound=BaseModel)


def read_model(file: Path, model: type[B], what: str) -> B:
    """Read a model from a JSON file. what : description for messages. Raises `FileFormatError`."""
    try:
        return model.model_validate_json(read_bytes(file, what))
    except ValidationError as error:
        raise FileFormatError(f"{file}: {problem_of(error.errors()[0], model)}") from error


class LastDocument(Generic[M]):
    """The last outcome of something, in its own file. what : description for the log."""

    def __init__(self, file: Path, model: type[M], what: str) -> None:
        self._file = file
        self._model = model
        self._what = what

    def write(self, document: M) -> None:
        """Replace the former document. Raises `OSError`."""
        make_folders(self._file.parent)
        write_atomically(self._file, document.model_dump_json(indent=1).encode())

    def read(self) -> M | None:
        """Read the document; None if there is none, or it cannot be read."""
        try:
            return self._model.model_validate_json(self._file.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as error:
            log.warning("%s cannot be read, as if there were none: %s", self._what, error)
            return None


class Trouble(Frozen):
    """Reason why something cannot be done. code, params : as of a problem.  text : in English."""

    code: str
    text: Message
    params: dict[str, str | float] = Field(default={})


class PicturePaths(Frozen):
    """API paths of a pair's pictures."""

    left: str
    right: str

    @classmethod
    def below(cls, place: str) -> Self:
        """Paths of the JPEGs below a path of the API."""
        return cls(left=f"{place}/left.jpg", right=f"{place}/right.jpg")


class PlaceMm(Frozen):
    """A pose: mm, and three angles, degrees."""

    x_mm: float
    y_mm: float
    z_mm: float
    a_deg: float
    b_deg: float
    c_deg: float


class SigmaXyz(Frozen):
    """One sigma of X, Y, Z, µm."""

    x: float
    y: float
    z: float


class SigmaAbc(Frozen):
    """One sigma of three angles, degrees; null where not known, such as the rotation of a round part."""

    a: float | None
    b: float | None
    c: float | None


class DraftHead(Frozen):
    """Common fields of all drafts' documents. active : the cell uses the draft's result."""

    id: str
    revision: int
    created: str
    author: str
    can_undo: bool
    can_redo: bool
    active: bool


class DraftSummary(Frozen):
    """A draft in a list. trouble : why it cannot be read; then only its id is known."""

    id: str
    created: str = ""
    author: str = ""
    active: bool = False
    trouble: Message | None = None
