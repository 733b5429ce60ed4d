"""Drafts of jobs: what people are at, on disc after each step, so that a kill loses nothing.

ID/state.json            written last: what it names is there
ID/pictures/             left.png, right.png: the pair, every grey value; and as JPEG for the page; of further
                         pairs HASH-left.png, HASH-right.png

The pair and what was wanted of it stay with the job that comes of it:

JOB/taught/              left.png, right.png, content.json, and further pairs: `edged` reads none of them
                         to measure
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Literal

from pydantic import JsonValue, ValidationError

from edged.config.reading import problem_of
from edged.domain.arrays import SIDES, Image
from edged.errors import TeachError
from edged.files.atomic import read_bytes
from edged.files.images import load_image
from edged.pictures.encoding import jpeg
from edged.setup.documents import read_model
from edged.setup.history import DraftFile, DraftFolders, Kept, beginning
from edged.setup.pairs import write_sides
from edged.setup.teaching.model import Content, TeachOperation, TeachState

KEPT = 20
"""Drafts; with one more the oldest goes. A pair of 1280x960 has 2 MB."""
TAUGHT = "taught"
"""The folder in a job's folder."""
_CONTENT = "content.json"
JPEG_QUALITY = 90
"""Per cent, of the pictures for people."""


class KeptContent(Kept):
    """What a job was taught by, beside its pair."""

    format: Literal["edged-taught"] = "edged-taught"
    version: Literal[1] = 1
    content: Content


@dataclass(frozen=True, slots=True, eq=False)
class KeptPair:
    """Raw pictures. content : by which a job was taught from them; None: none was. further : by name."""

    left: Image
    right: Image
    content: Content | None = None
    further: Mapping[str, tuple[Image, Image]] = field(default_factory=dict)


class TeachingDraft(DraftFile[TeachState]):
    """A draft of a job."""

    error = TeachError

    def picture(self, side: str, suffix: str = "png", pair: str = "") -> Path:
        """A raw picture; as "jpg" for people.  pair : a further one."""
        return self.pictures / picture_name(side, suffix, pair)

    def put_further(self, pair: KeptPair) -> str:
        """Keep the pictures of a further pair; returns its name. Raises `TeachError` for another size."""
        if pair.left.shape != (self.state.height, self.state.width):
            raise TeachError("the pair is of another size than the first one", "further_size")
        pixels = pair.left.tobytes() + pair.right.tobytes()
        name = hashlib.sha256(pixels).hexdigest()[:12]
        _write_pair(self.pictures, (pair.left, pair.right), name)
        return name

    def propose(self, shapes: list[JsonValue]) -> None:
        """The region that is proposed before anybody says another; nobody has changed anything by it."""
        start = self.state.start.with_({"shapes": shapes})
        self.write(self.state.model_copy(update={"start": start}))

    def operate(self, what: str, sets: Mapping[str, JsonValue]) -> None:
        """One step. Raises `TeachError` for what cannot be."""
        try:
            operation = TeachOperation.model_validate({"what": what, "sets": dict(sets)})
        except ValidationError as error:
            raise TeachError(problem_of(error.errors()[0], Content)) from error
        try:
            self.write(self.state.operated(operation))
        except ValidationError as error:
            raise TeachError("too many steps: activate it, and edit the job") from error

    def note_activated(self, digest: str | None) -> None:
        """A job is to come of it, by the SHA-256 of its text; None: none is after all."""
        self.write(self.state.changed(activated=digest))

    def note_job(self, folder: str) -> None:
        """The job in this folder has come of it: from now on it is that one's draft."""
        self.write(self.state.changed(job=folder, is_same_pair=True))

    def kept(self) -> dict[str, bytes]:
        """What stays with the job, by its name in the job's folder."""
        content = KeptContent(content=self.state.content).model_dump_json(indent=1).encode()
        pictures = {
            f"{TAUGHT}/{picture_name(side, 'png', pair)}": read_bytes(
                self.picture(side, pair=pair), "a picture"
            )
            for pair in ("", *self.state.content.further)
            for side in SIDES
        }
        return {**pictures, f"{TAUGHT}/{_CONTENT}": content}


class TeachingDrafts(DraftFolders[TeachState, TeachingDraft]):
    """All drafts of jobs of a cell, in a folder."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, TeachState, TeachingDraft, ("pictures",), KEPT, _pictures)

    def create(
        self, author: str, start: Content, pair: KeptPair, now: datetime, job: str | None = None
    ) -> TeachingDraft:
        """Begin one with a pair; the oldest beyond `KEPT` go. job : the folder that it replaces."""
        height, width = pair.left.shape
        about = {"job": job, "width": width, "height": height, "start": start}
        state = TeachState.model_validate(
            {**beginning(author, now), **about, "is_same_pair": pair.content is not None}
        )
        try:
            place = self.place(state.id) / "pictures"
            for name, images in {"": (pair.left, pair.right), **pair.further}.items():
                _write_pair(place, images, name)
            return self.add(state)
        except OSError:  # a disc that is full is not filled further
            self.clear(state.id)
            raise


def picture_name(side: str, suffix: str, pair: str = "") -> str:
    """A file of a pair, of a further one by its name."""
    return f"{pair}-{side}.{suffix}" if pair else f"{side}.{suffix}"


def _write_pair(place: Path, images: tuple[Image, Image], name: str) -> None:
    """Write both pictures, for the cell and for people.  name : of a further pair, or ""."""
    write_sides(place, picture_name("{side}", "png", name), images)
    write_sides(place, picture_name("{side}", "jpg", name), images, partial(jpeg, quality=JPEG_QUALITY))


def _pictures(state: TeachState) -> list[str]:
    return [picture_name(side, "png", pair) for pair in ("", *state.content.further) for side in SIDES]


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
    kept = read_model(place / _CONTENT, KeptContent, "what a job was taught by")

    def read(pair: str) -> tuple[Image, Image]:
        left, right = (load_image(place / picture_name(side, "png", pair)) for side in SIDES)
        return left, right

    return KeptPair(*read(""), kept.content, {pair: read(pair) for pair in kept.content.further})
