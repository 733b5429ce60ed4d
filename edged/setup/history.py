"""What drafts of all kinds keep on disc: a state with its revision, and operations that can be undone."""

from __future__ import annotations

import contextlib
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from edged.config.reading import problem_of
from edged.errors import FileFormatError, UserError
from edged.files.atomic import make_folders, read_bytes, write_atomically

MOST_OPERATIONS = 2000
_STATE = "state.json"
BEGINNING_S = 3600.0
"""Longer than it takes to write the first files of a draft."""
_IDENTITY = re.compile(r"[0-9]{8}-[0-9]{6}-[0-9a-f]{4}")
DraftId = Annotated[str, Field(pattern=f"^{_IDENTITY.pattern}$")]
Text = Annotated[str, Field(max_length=2000)]


class Kept(BaseModel):
    """Frozen, without keys that are not known, and every number finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


O = TypeVar("O", bound=Kept)  # noqa: E741  (an operation)


class History(Kept, Generic[O]):
    """A draft's state. revision : counts every change.  operations : `done` of them hold, the others were
    undone.
    """

    id: DraftId
    revision: Annotated[int, Field(ge=0)] = 0
    created: Text
    author: Text
    operations: Annotated[tuple[O, ...], Field(max_length=MOST_OPERATIONS)] = ()
    done: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _is_within(self) -> Self:
        if self.done > len(self.operations):
            raise ValueError("more operations done than there are")
        return self

    @property
    def holding(self) -> tuple[O, ...]:
        """The operations that were not undone."""
        return self.operations[: self.done]

    @property
    def can_undo(self) -> bool:
        """Whether an operation holds."""
        return self.done > 0

    @property
    def can_redo(self) -> bool:
        """Whether one was undone, and nothing else done since."""
        return self.done < len(self.operations)

    def changed(self, **changes: Any) -> Self:
        """With these fields, checked, one revision later."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self)(**{**fields, **changes, "revision": self.revision + 1})

    def operated(self, operation: O, **changes: Any) -> Self:
        """With one operation more; what was undone is forgotten."""
        done = (*self.holding, operation)
        return self.changed(operations=done, done=len(done), **changes)


S = TypeVar("S", bound=History[Any])


class StateFile(Generic[S]):
    """A draft's folder and state. Each change is on disc when its method returns; it raises `OSError` where
    that refuses. error : what there is raised for a step that cannot be taken.
    """

    def __init__(self, folder: Path, state: S, error: type[UserError]) -> None:
        self.folder = folder
        self._state = state
        self._error = error

    @property
    def state(self) -> S:
        """As it is on disc."""
        return self._state

    def write(self, state: S) -> None:
        """Let it be so from now on."""
        write_atomically(self.folder / _STATE, state.model_dump_json(indent=1).encode())
        self._state = state

    def step(self, by: Literal[-1, 1], **changes: Any) -> None:
        """Take the last operation back, or do again what was taken back last."""
        done = self._state.done + by
        if not 0 <= done <= len(self._state.operations):
            raise self._error(f"there is nothing to {'undo' if by < 0 else 'do again'}")
        self.write(self._state.changed(done=done, **changes))


def new_identity(now: datetime) -> str:
    """Of a draft; in the order of time."""
    return f"{now:%Y%m%d-%H%M%S}-{secrets.token_hex(2)}"


class DraftFolders(Generic[S]):
    """Drafts of one kind, in a folder.

    model : of their state.  error : of theirs.  places : folders inside each.  most : drafts; with one more
    the oldest goes.  pictures : by the state, the files in "pictures" without which a draft cannot be read.
    """

    def __init__(
        self,
        folder: Path,
        model: type[S],
        error: type[UserError],
        places: Sequence[str],
        most: int,
        pictures: Callable[[S], Iterable[str]],
    ) -> None:
        self._folder = folder
        self._model = model
        self._error = error
        self._places = places
        self._most = most
        self._pictures = pictures

    def place(self, identity: str) -> Path:
        """The folder of one, with those inside it. Raises `OSError`."""
        for place in self._places:
            make_folders(self._folder / identity / place)
        return self._folder / identity

    def add(self, state: S) -> StateFile[S]:
        """Begin one, whose other files are in its `place` already; the oldest beyond `most` go."""
        draft = StateFile(self.place(state.id), state, self._error)
        draft.write(state)
        for old in self.names()[self._most :]:
            self.clear(old)
        self._sweep()
        return draft

    def _sweep(self) -> None:
        """Forget drafts that were cut off while they began."""
        for entry in self._folder.iterdir():
            with contextlib.suppress(OSError):  # somebody else has removed it
                is_old = time.time() - entry.stat().st_mtime > BEGINNING_S
                if is_old and _IDENTITY.fullmatch(entry.name) and not (entry / _STATE).exists():
                    shutil.rmtree(entry, ignore_errors=True)

    def remove(self, identity: str) -> None:
        """Forget one. Raises `KeyError` when there is none."""
        if identity not in self.names():
            raise KeyError(identity)
        self.clear(identity)

    def clear(self, identity: str) -> None:
        """Leave nothing of one, begun or not; it is none before the first of its other files goes."""
        (self._folder / identity / _STATE).unlink(missing_ok=True)
        shutil.rmtree(self._folder / identity, ignore_errors=True)

    def names(self) -> list[str]:
        """Of all drafts, the youngest first."""
        try:
            return sorted((file.parent.name for file in self._folder.glob(f"*/{_STATE}")), reverse=True)
        except OSError:
            return []

    def load(self, identity: str) -> StateFile[S]:
        """Read one. Raises `KeyError` when there is none, `FileFormatError` that says what is wrong."""
        if identity not in self.names():
            raise KeyError(identity)
        file = self._folder / identity / _STATE
        try:
            state = self._model.model_validate_json(read_bytes(file, "a draft"))
        except ValidationError as error:
            raise FileFormatError(f"{file}: {problem_of(error.errors()[0], self._model)}") from error
        if state.id != identity:
            raise FileFormatError(f"{file}: id: is {state.id!r}, the folder's name is {identity!r}")
        for name in self._pictures(state):
            picture = file.parent / "pictures" / name
            if picture.is_symlink() or not picture.is_file():
                raise FileFormatError(f"{picture}: a picture of the draft is missing")
        return StateFile(file.parent, state, self._error)

    def states(self) -> list[tuple[str, S | FileFormatError]]:
        """Of all drafts, the youngest first: the identity, and the state or what is wrong with it."""
        found: list[tuple[str, S | FileFormatError]] = []
        for identity in self.names():
            try:
                found.append((identity, self.load(identity).state))
            except FileFormatError as error:
                found.append((identity, error))
            except KeyError:  # forgotten meanwhile
                continue
        return found
