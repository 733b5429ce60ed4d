"""Drafts of jobs, saved to disc after each step, so that a killed process loses nothing.

ID/state.json            written last, so that all files it names exist
ID/pictures/             left.png, right.png: the pair, lossless, and as JPEG for the page; further pairs are
                         HASH-left.png, HASH-right.png

The pair and the content of the draft stay with the job that is made from it:

JOB/taught/              left.png, right.png, content.json, and further pairs: `edged` does not read them
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
"""Number of drafts kept; the oldest is deleted when there is one more. A pair of 1280x960 has 2 MB."""
TAUGHT = "taught"
"""Folder inside a job's folder with the pair that it was taught from."""
_CONTENT = "content.json"
JPEG_QUALITY = 90
"""JPEG quality of the pictures for the page."""


class KeptContent(Kept):
    """File with the content that a job was taught with, beside its pair."""

    format: Literal["edged-taught"] = "edged-taught"
    version: Literal[1] = 1
    content: Content


@dataclass(frozen=True, slots=True, eq=False)
class KeptPair:
    """A raw pair. content : that a job was taught with from it, or None. further : pairs by name."""

    left: Image
    right: Image
    content: Content | None = None
    further: Mapping[str, tuple[Image, Image]] = field(default_factory=dict)


class TeachingDraft(DraftFile[TeachState]):
    """A draft of a job."""

    error = TeachError

    def picture(self, side: str, suffix: str = "png", pair: str = "") -> Path:
        """Path of a raw picture; suffix "jpg" for the page's copy.  pair : name of a further one, or ""."""
        return self.pictures / picture_name(side, suffix, pair)

    def put_further(self, pair: KeptPair) -> str:
        """Store the pictures of a further pair, and return its name. Raises `TeachError` for another size."""
        if pair.left.shape != (self.state.height, self.state.width):
            raise TeachError("the pair is of another size than the first one", "further_size")
        pixels = pair.left.tobytes() + pair.right.tobytes()
        name = hashlib.sha256(pixels).hexdigest()[:12]
        _write_pair(self.pictures, (pair.left, pair.right), name)
        return name

    def propose(self, shapes: list[JsonValue]) -> None:
        """Set the proposed initial region; it does not count as an operation or a change."""
        start = self.state.start.with_({"shapes": shapes})
        self.write(self.state.model_copy(update={"start": start}))

    def operate(self, what: str, sets: Mapping[str, JsonValue]) -> None:
        """Apply one operation. Raises `TeachError` for invalid values."""
        try:
            operation = TeachOperation.model_validate({"what": what, "sets": dict(sets)})
        except ValidationError as error:
            raise TeachError(problem_of(error.errors()[0], Content)) from error
        try:
            self.write(self.state.operated(operation))
        except ValidationError as error:
            raise TeachError("too many steps: activate it, and edit the job") from error

    def note_activated(self, digest: str | None) -> None:
        """Record that its job is being activated, by the SHA-256 of its text; None takes that back."""
        self.write(self.state.changed(activated=digest))

    def note_job(self, folder: str) -> None:
        """Record that the job in this folder was made from it; from now on it is a draft of that job."""
        self.write(self.state.changed(job=folder, is_same_pair=True))

    def kept(self) -> dict[str, bytes]:
        """Files that stay with the job, by path in the job's folder."""
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
        """Create a draft from a pair, and delete any beyond `KEPT`. job : the folder that it replaces."""
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
        except OSError:  # leave nothing behind on a full disc
            self.clear(state.id)
            raise


def picture_name(side: str, suffix: str, pair: str = "") -> str:
    """File name of a picture of the first pair, or of a further one."""
    return f"{pair}-{side}.{suffix}" if pair else f"{side}.{suffix}"


def _write_pair(place: Path, images: tuple[Image, Image], name: str) -> None:
    """Write both pictures, for the cell and for the page.  name : of a further pair, or ""."""
    write_sides(place, picture_name("{side}", "png", name), images)
    write_sides(place, picture_name("{side}", "jpg", name), images, partial(jpeg, quality=JPEG_QUALITY))


def _pictures(state: TeachState) -> list[str]:
    return [picture_name(side, "png", pair) for pair in ("", *state.content.further) for side in SIDES]


def keeps_pair(folder: Path) -> bool:
    """Whether a job keeps the pair and the content that it was taught with."""
    names = _CONTENT, *(f"{side}.png" for side in SIDES)
    return all((folder / TAUGHT / name).is_file() for name in names)


def kept_pair(folder: Path) -> KeptPair:
    """Read pair and content that a job was taught with. Raises `TeachError` if none, `FileFormatError`."""
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
