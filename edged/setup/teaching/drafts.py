"""Drafts of jobs: what people are at, on disc after each step, so that a kill loses nothing.

ID/state.json            written last: what it names is there
ID/pictures/             left.png, right.png: the pair, every grey value; and as JPEG for the page

The pair and what was wanted of it stay with the job that comes of it:

JOB/taught/              left.png, right.png, content.json: `edged` reads none of them to measure
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

import cv2
from pydantic import JsonValue, ValidationError

from edged.config.reading import problem_of
from edged.domain.arrays import SIDES, Image
from edged.errors import FileFormatError, TeachError
from edged.files.atomic import read_bytes, write_atomically
from edged.files.images import load_image
from edged.setup.history import DraftFolders, Kept, StateFile, new_identity
from edged.setup.teaching.model import Content, TeachOperation, TeachState

KEPT = 20
"""Drafts; with one more the oldest goes. A pair of 1280x960 has 2 MB."""
TAUGHT = "taught"
"""The folder in a job's folder."""
_CONTENT = "content.json"
_QUICK = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_FOR_PEOPLE = (cv2.IMWRITE_JPEG_QUALITY, 90)


class KeptContent(Kept):
    """What a job was taught by, beside its pair."""

    format: Literal["edged-taught"] = "edged-taught"
    version: Literal[1] = 1
    content: Content


@dataclass(frozen=True, slots=True, eq=False)
class KeptPair:
    """Raw pictures. content : by which a job was taught from them; None: none was."""

    left: Image
    right: Image
    content: Content | None = None


class TeachingDraft:
    """One draft. Each change is on disc when its method returns; it raises `OSError` where that refuses."""

    def __init__(self, file: StateFile[TeachState]) -> None:
        self._file = file

    @property
    def state(self) -> TeachState:
        """As it is on disc."""
        return self._file.state

    @property
    def folder(self) -> Path:
        """Where all of it is."""
        return self._file.folder

    def picture(self, side: str, suffix: str = "png") -> Path:
        """A raw picture; as "jpg" for people."""
        return self.folder / "pictures" / f"{side}.{suffix}"

    def propose(self, shapes: list[JsonValue]) -> None:
        """The region that is proposed before anybody says another."""
        self._file.write(self.state.changed(start=self.state.start.with_({"shapes": shapes})))

    def operate(
        self, what: Literal["region", "tap", "features", "about", "drawing"], sets: Mapping[str, JsonValue]
    ) -> None:
        """One step. Raises `TeachError` for what cannot be."""
        try:
            operation = TeachOperation(what=what, sets=dict(sets))
        except ValidationError as error:
            raise TeachError(problem_of(error.errors()[0], Content)) from error
        try:
            self._file.write(self.state.operated(operation, activated=None))
        except ValidationError as error:
            raise TeachError("too many steps: activate it, and edit the job") from error

    def undo(self) -> None:
        """Take the last operation back. Raises `TeachError` when there is none."""
        self._file.step(-1, activated=None)

    def redo(self) -> None:
        """Do again what was taken back last. Raises `TeachError` when there is nothing."""
        self._file.step(1, activated=None)

    def note_activated(self, digest: str | None) -> None:
        """A job is to come of it, by the SHA-256 of its text; None: none is after all."""
        self._file.write(self.state.changed(activated=digest))

    def note_job(self, folder: str) -> None:
        """The job in this folder has come of it: from now on it is that one's draft."""
        self._file.write(self.state.changed(job=folder, is_same_pair=True))

    def kept(self) -> dict[str, bytes]:
        """What stays with the job, by its name in the job's folder."""
        content = KeptContent(content=self.state.content).model_dump_json(indent=1).encode()
        pictures = {f"{TAUGHT}/{side}.png": read_bytes(self.picture(side), "a picture") for side in SIDES}
        return {**pictures, f"{TAUGHT}/{_CONTENT}": content}


class TeachingDrafts:
    """All drafts of jobs of a cell, in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folders = DraftFolders(folder, TeachState, TeachError, ("pictures",), KEPT, _pictures)

    def create(
        self, author: str, start: Content, pair: KeptPair, now: datetime, job: str | None = None
    ) -> TeachingDraft:
        """Begin one with a pair; the oldest beyond `KEPT` go. job : the folder that it replaces."""
        images = pair.left, pair.right
        height, width = pair.left.shape
        state = TeachState(
            id=new_identity(now),
            created=now.isoformat(timespec="seconds"),
            author=author,
            job=job,
            width=width,
            height=height,
            start=start,
            is_same_pair=pair.content is not None,
        )
        try:
            place = self._folders.place(state.id) / "pictures"
            for side, image in zip(SIDES, images, strict=True):
                write_atomically(place / f"{side}.png", _encoded(".png", image, _QUICK))
                write_atomically(place / f"{side}.jpg", _encoded(".jpg", image, _FOR_PEOPLE))
            return TeachingDraft(self._folders.add(state))
        except OSError:  # a disc that is full is not filled further
            self._folders.clear(state.id)
            raise

    def names(self) -> list[str]:
        """Of all drafts, the youngest first."""
        return self._folders.names()

    def states(self) -> list[tuple[str, TeachState | FileFormatError]]:
        """Of all drafts, the youngest first: the identity, and the state or what is wrong with it."""
        return self._folders.states()

    def remove(self, identity: str) -> None:
        """Forget one. Raises `KeyError` when there is none."""
        self._folders.remove(identity)

    def load(self, identity: str) -> TeachingDraft:
        """Read one. Raises `KeyError` when there is none, `FileFormatError` that says what is wrong."""
        return TeachingDraft(self._folders.load(identity))


def _pictures(_state: TeachState) -> list[str]:
    return [f"{side}.png" for side in SIDES]


def keeps_pair(folder: Path) -> bool:
    """Whether a job keeps what it was taught by."""
    names = _CONTENT, *(f"{side}.png" for side in SIDES)
    return all((folder / TAUGHT / name).is_file() for name in names)


def kept_pair(folder: Path) -> KeptPair:
    """What a job was taught by. Raises `TeachError` where it does not keep that, `FileFormatError`."""
    place = folder / TAUGHT
    if not keeps_pair(folder):
        raise TeachError(
            f"{folder.name} does not keep the pair it was taught from: teach it from a fresh one", "no_pair"
        )
    try:
        kept = KeptContent.model_validate_json(read_bytes(place / _CONTENT, "what a job was taught by"))
    except ValidationError as error:
        raise FileFormatError(f"{place / _CONTENT}: {problem_of(error.errors()[0], KeptContent)}") from error
    left, right = (load_image(place / f"{side}.png") for side in SIDES)
    return KeptPair(left, right, kept.content)


def _encoded(suffix: str, image: Image, options: tuple[int, ...]) -> bytes:
    _, data = cv2.imencode(suffix, image, list(options))
    return data.tobytes()
