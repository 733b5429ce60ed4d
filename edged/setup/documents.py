"""What several topics of setting up send: heads of drafts, what is in the way, pictures, poses, sigmas."""

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
    """A model that does not change; made of values, or of the attributes of something that has the same."""

    model_config = ConfigDict(
        frozen=True, from_attributes=True, json_schema_serialization_defaults_required=True
    )


def now_text() -> str:
    """The time, UTC, to the second, as documents have it."""
    return datetime.now(UTC).isoformat(timespec="seconds")


Message = Annotated[str, AfterValidator(without_folders)]
"""Text of an error: a page names files, and not where they lie on this machine."""
M = TypeVar("M", bound=Frozen)
B = TypeVar("B", bound=BaseModel)


def read_model(file: Path, model: type[B], what: str) -> B:
    """What a file of JSON holds. what : it is, for messages. Raises `FileFormatError`."""
    try:
        return model.model_validate_json(read_bytes(file, what))
    except ValidationError as error:
        raise FileFormatError(f"{file}: {problem_of(error.errors()[0], model)}") from error


class LastDocument(Generic[M]):
    """The last outcome of something, in a file of its own. what : it is, for the log."""

    def __init__(self, file: Path, model: type[M], what: str) -> None:
        self._file = file
        self._model = model
        self._what = what

    def write(self, document: M) -> None:
        """Keep it instead of the one before. Raises `OSError`."""
        make_folders(self._file.parent)
        write_atomically(self._file, document.model_dump_json(indent=1).encode())

    def read(self) -> M | None:
        """The one that is kept; None where there is none, or it cannot be read."""
        try:
            return self._model.model_validate_json(self._file.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as error:
            log.warning("%s cannot be read, as if there were none: %s", self._what, error)
            return None


class Trouble(Frozen):
    """What keeps something from being done. code, params : as of a problem.  text : in English."""

    code: str
    text: Message
    params: dict[str, str | float] = Field(default={})


class PicturePaths(Frozen):
    """Where the pictures of a pair are."""

    left: str
    right: str

    @classmethod
    def below(cls, place: str) -> Self:
        """As JPEGs of a folder of the API."""
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
    """One sigma of three angles, degrees; null for what is not known: the turn of a round part."""

    a: float | None
    b: float | None
    c: float | None


class DraftHead(Frozen):
    """What the documents of all drafts have in common. active : the cell runs by what came of it."""

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
