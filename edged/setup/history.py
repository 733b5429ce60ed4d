"""Drafts on disc: folders with pictures and a state, which has a revision and undoable operations."""

from __future__ import annotations

import contextlib
import hashlib
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, model_validator

from edged.errors import CalibrationError, FileFormatError, UserError
from edged.files.atomic import make_folders, write_atomically
from edged.files.rig import read_rig
from edged.setup.documents import read_model

MOST_OPERATIONS = 2000
_STATE = "state.json"
BEGINNING_S = 3600.0
"""Age from which on a draft folder without a state was abandoned while it was being created."""
_IDENTITY = re.compile(r"[0-9]{8}-[0-9]{6}-[0-9a-f]{4}")
DraftId = Annotated[str, Field(pattern=f"^{_IDENTITY.pattern}$")]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
"""SHA-256 of a file."""
Text = Annotated[str, Field(max_length=2000)]


class Kept(BaseModel):
    """Model of a file: frozen, without unknown keys, and with finite numbers only."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


O = TypeVar("O", bound=Kept)  # noqa: E741  (an operation)


class History(Kept, Generic[O]):
    """A draft's state. revision : counts every change.  operations : the first `done` hold, the others were
    undone.  outcome : names of fields with results of the operations; reset to None by each step.
    """

    outcome: ClassVar[tuple[str, ...]] = ()
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
    def head(self) -> dict[str, Any]:
        """Fields of a `DraftHead` that follow from the state alone."""
        fields = {name: getattr(self, name) for name in ("id", "revision", "created", "author")}
        return {**fields, "can_undo": self.done > 0, "can_redo": self.done < len(self.operations)}

    def changed(self, **changes: Any) -> Self:
        """Copy with these fields changed and validated, and the next revision."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self)(**{**fields, **changes, "revision": self.revision + 1})

    def without_outcome(self, **changes: Any) -> Self:
        """Copy with these fields changed, and without the outcome."""
        return self.changed(**dict.fromkeys(self.outcome), **changes)

    def operated(self, operation: O, **changes: Any) -> Self:
        """Copy with one more operation; undone ones are dropped."""
        done = (*self.holding, operation)
        return self.without_outcome(operations=done, done=len(done), **changes)


def beginning(author: str, now: datetime) -> dict[str, Any]:
    """Initial fields of a new draft's state; ids sort by time."""
    identity = f"{now:%Y%m%d-%H%M%S}-{secrets.token_hex(2)}"
    return {"id": identity, "created": now.isoformat(timespec="seconds"), "author": author}


S = TypeVar("S", bound=History[Any])


class DraftFile(Generic[S]):
    """A draft's folder and state. Each change is on disc when its method returns, or it raises `OSError`.

    error : raised for a step that cannot be taken.
    """

    error: ClassVar[type[UserError]] = CalibrationError

    def __init__(self, folder: Path, state: S) -> None:
        self.folder = folder
        self._state = state

    @property
    def state(self) -> S:
        """The state on disc."""
        return self._state

    @property
    def pictures(self) -> Path:
        """The folder of its pictures."""
        return self.folder / "pictures"

    def small(self, name: str, side: str) -> Path:
        """The small JPEG of a picture."""
        return self.folder / "small" / f"{name}_{side}.jpg"

    def write(self, state: S) -> None:
        """Replace the state."""
        write_atomically(self.folder / _STATE, state.model_dump_json(indent=1).encode())
        self._state = state

    def undo(self) -> None:
        """Undo the last operation. Raises `error` if there is none."""
        self._step(-1, "undo")

    def redo(self) -> None:
        """Redo the operation that was undone last. Raises `error` if there is none."""
        self._step(1, "do again")

    def _step(self, by: Literal[-1, 1], what: str) -> None:
        done = self._state.done + by
        if not 0 <= done <= len(self._state.operations):
            raise self.error(f"there is nothing to {what}")
        self.write(self._state.without_outcome(done=done))


D = TypeVar("D", bound=DraftFile[Any])


class DraftFolders(Generic[S, D]):
    """Drafts of one kind, in a folder.

    model, draft : the types of their states and files.  places : folders inside each.  most : number of
    drafts kept; beyond it, the oldest are deleted.  pictures : returns for a state the names of the files in
    "pictures" that a draft needs.
    """

    def __init__(
        self,
        folder: Path,
        model: type[S],
        draft: Callable[[Path, S], D],
        places: Sequence[str],
        most: int,
        pictures: Callable[[S], Iterable[str]],
    ) -> None:
        self._folder = folder
        self._model = model
        self._draft = draft
        self._places = places
        self._most = most
        self._pictures = pictures

    def place(self, identity: str) -> Path:
        """Make the folder of a draft with its subfolders, and return it. Raises `OSError`."""
        for place in self._places:
            make_folders(self._folder / identity / place)
        return self._folder / identity

    def add(self, state: S) -> D:
        """Add a draft whose other files are in its `place` already; the oldest beyond `most` are deleted."""
        draft = self._draft(self.place(state.id), state)
        draft.write(state)
        for old in self.names()[self._most :]:
            self.clear(old)
        self._sweep()
        return draft

    def _sweep(self) -> None:
        """Remove drafts whose creation was interrupted."""
        for entry in self._folder.iterdir():
            with contextlib.suppress(OSError):  # removed meanwhile
                is_old = time.time() - entry.stat().st_mtime > BEGINNING_S
                if is_old and _IDENTITY.fullmatch(entry.name) and not (entry / _STATE).exists():
                    shutil.rmtree(entry, ignore_errors=True)

    def remove(self, identity: str) -> None:
        """Remove a draft. Raises `KeyError` when there is none."""
        if identity not in self.names():
            raise KeyError(identity)
        self.clear(identity)

    def clear(self, identity: str) -> None:
        """Delete a draft's folder, complete or not; its state goes first, so that it is no draft any more."""
        (self._folder / identity / _STATE).unlink(missing_ok=True)
        shutil.rmtree(self._folder / identity, ignore_errors=True)

    def names(self) -> list[str]:
        """Ids of all drafts, newest first."""
        try:
            return sorted((file.parent.name for file in self._folder.glob(f"*/{_STATE}")), reverse=True)
        except OSError:
            return []

    def load(self, identity: str) -> D:
        """Read a draft. Raises `KeyError` if there is none, `FileFormatError` if it is damaged."""
        if identity not in self.names():
            raise KeyError(identity)
        file = self._folder / identity / _STATE
        state = read_model(file, self._model, "a draft")
        if state.id != identity:
            raise FileFormatError(f"{file}: id: is {state.id!r}, the folder's name is {identity!r}")
        for name in self._pictures(state):
            picture = file.parent / "pictures" / name
            if picture.is_symlink() or not picture.is_file():
                raise FileFormatError(f"{picture}: a picture of the draft is missing")
        return self._draft(file.parent, state)

    def states(self) -> list[tuple[str, S | FileFormatError]]:
        """All drafts, newest first: the id, and the state or what is wrong with it."""
        found: list[tuple[str, S | FileFormatError]] = []
        for identity in self.names():
            try:
                found.append((identity, self.load(identity).state))
            except FileFormatError as error:
                found.append((identity, error))
            except KeyError:  # removed meanwhile
                continue
        return found


# --- rigs that drafts were solved to ---------------------------------------------------------------


def solved_file(folder: Path, pattern: str, digest: str) -> Path:
    """Path of a file of a draft's solution. pattern : such as "rig-*.json".  digest : SHA-256 of the rig."""
    return folder / pattern.replace("*", digest[:16])


def write_solved(draft: DraftFile[S], state: S, digest: str, files: Mapping[str, bytes]) -> None:
    """Write a draft's solution, by patterns of `solved_file`, then its state; delete the former solution."""
    for pattern, content in files.items():
        write_atomically(solved_file(draft.folder, pattern, digest), content)
    draft.write(state)
    for pattern in files:
        for file in draft.folder.glob(pattern):
            if file != solved_file(draft.folder, pattern, digest):
                file.unlink()


def solved_rig(folder: Path, digest: str | None, counted: str) -> bytes:
    """Content of the rig file that a draft was solved to.

    digest : in the draft's state.  counted : name of its inputs, for messages. Raises `CalibrationError` if
    it is not solved, `FileFormatError` if the file was changed.
    """
    if digest is None:
        raise CalibrationError(f"it is not solved, or its {counted} have changed since: solve it first")
    file = solved_file(folder, "rig-*.json", digest)
    content = read_rig(file)
    if hashlib.sha256(content).hexdigest() != digest:
        raise FileFormatError(f"{file}: is not the solution that was kept: solve it again")
    return content
