"""Releases of a cell: each an archive as `edged backup` makes it, with its author, time and reason.

    0007.tar.gz     the cell, checked to load; readable by its owner only, as every backup
    0007.json       written after the archive: an archive without it is not a release
pictures/       pairs that jobs were taught from, by their SHA-256: many releases share them

Releases that were ever active are kept; of the others, only the newest `KEPT`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from edged.errors import FileFormatError
from edged.files.atomic import make_folders, read_bytes, sync, write_atomically
from edged.setup.documents import read_model
from edged.setup.history import Kept, Text
from edged.setup.releases.archive import Backup, Made, jobs_of, read

KEPT = 50
"""Number of releases kept that were never active. A release has some ten kB, and a few hundred for each job;
the pairs of jobs, a few MB each, are kept once.
"""
PICTURES = "pictures"
_FILE = re.compile(r"([0-9]{4,6})\.(json|tar\.gz)")
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Number = Annotated[int, Field(ge=1, le=999_999)]


class Tested(Kept):
    """Regression test on recorded cycles before a release became active. regression : its id; None without.

    cycles : how many it was, or would have been, tried on. signed : why it became active all the same.
    """

    regression: Text | None
    cycles: int
    good_to_bad: int | None
    signed: Text | None


class Release(Kept):
    """Description of a release. parent : the release that was active before.  rig : its calibration id.

    activated : time of each activation.  tested : before the last one; None if no recorded cycle was
    affected. digests : of each job's files, by its folder.  pictures : SHA-256 of pictures that its archive
    leaves out, by their paths in the folder of the jobs.
    """

    format: Literal["edged-release"] = "edged-release"
    version: Literal[1] = 1
    number: Number
    created: Text
    author: Text
    note: Text
    parent: Number | None
    fingerprint: Text
    rig: Text
    jobs: tuple[Text, ...]
    activated: tuple[Text, ...] = ()
    tested: Tested | None = None
    digests: dict[Text, Text] = Field(default_factory=dict)
    pictures: dict[Text, Digest] = Field(default_factory=dict)


class ReleaseFolder:
    """Releases in a folder. All methods that write raise `OSError`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def add(
        self,
        made: Made,
        *,
        rig: str,
        author: str,
        note: str,
        parent: int | None,
        now: datetime,
        pictures: Mapping[str, bytes] | None = None,
    ) -> Release:
        """Add a release. rig : its calibration id.  pictures : those of its jobs, not in the archive."""
        digests = {place: hashlib.sha256(data).hexdigest() for place, data in (pictures or {}).items()}
        taken = [int(found[1]) for found in map(_FILE.fullmatch, self._names()) if found is not None]
        release = Release(
            number=max(taken, default=0) + 1,
            created=_text(now),
            author=author,
            note=note,
            parent=parent,
            fingerprint=made.backup.fingerprint,
            rig=rig,
            jobs=tuple(_jobs(made.backup)),
            digests=_digests(made.backup),
            pictures=digests,
        )
        make_folders(self._folder / PICTURES)
        for place, data in (pictures or {}).items():
            if not self._picture(digests[place]).exists():
                write_atomically(self._picture(digests[place]), data)
        write_atomically(self._archive(release.number), made.archive, mode=0o600)
        self._write(release)
        return release

    def note_active(self, number: int, now: datetime, tested: Tested | None = None) -> Release:
        """Record that a release becomes active; it is never pruned from then on. Raises `KeyError`."""
        release = self.get(number)
        noted = {"activated": (*release.activated, _text(now)), "tested": tested}
        release = release.model_copy(update=noted)
        self._write(release)
        return release

    def restore(self, release: Release) -> None:
        """Write back an earlier description of a release."""
        self._write(release)

    def forget(self, number: int) -> None:
        """Delete a release if it exists."""
        # the description goes first: an archive without it is not a release
        for file in (self._about(number), self._archive(number)):
            file.unlink(missing_ok=True)
            if self._folder.is_dir():
                sync(self._folder)

    def prune(self) -> None:
        """Delete old releases that were never active."""
        never = [release for release in self.all() if not release.activated]
        for release in never[KEPT:]:
            self.forget(release.number)
        self._sweep()

    def _sweep(self) -> None:
        """Delete pictures that no release uses; none while there is a release that cannot be read."""
        if not (self._folder / PICTURES).is_dir():
            return
        known = self.all()
        if len(known) < sum(name.endswith(".json") for name in self._names()):
            return
        used = {digest for release in known for digest in release.pictures.values()}
        for file in (self._folder / PICTURES).iterdir():
            if file.stem not in used:
                file.unlink(missing_ok=True)

    def all(self) -> list[Release]:
        """All releases, newest first, without damaged ones."""
        found = []
        for name in self._names():
            match = _FILE.fullmatch(name)
            if match is None or match[2] != "json":
                continue
            try:
                found.append(self.get(int(match[1])))
            except (KeyError, FileFormatError):
                continue
        return sorted(found, key=lambda release: -release.number)

    def get(self, number: int) -> Release:
        """Description of a release. Raises `KeyError` if there is none, `FileFormatError` if damaged."""
        file = self._about(number)
        if not file.is_file() or not self._archive(number).is_file():
            raise KeyError(number)
        release = read_model(file, Release, "a release")
        if release.number != number:
            raise FileFormatError(f"{file}: number: is {release.number}, the file's is {number}")
        return release

    def open(self, number: int) -> Backup:
        """Read the archive of a release and check all checksums. Raises `KeyError`, `FileFormatError`."""
        self.get(number)
        return read(self._archive(number))

    def jobs(self, number: int) -> dict[str, bytes]:
        """Job files of a release, by path, without missing or damaged pictures. Raises as `open`."""
        found = jobs_of(self.open(number))
        for place, digest in self.get(number).pictures.items():
            file = self._picture(digest)
            data = read_bytes(file, "a picture") if file.is_file() else b""
            if hashlib.sha256(data).hexdigest() == digest:
                found[place] = data
        return found

    def _picture(self, digest: str) -> Path:
        return self._folder / PICTURES / f"{digest}.png"

    def file(self, number: int) -> Path:
        """Path of a release's archive. Raises `KeyError`, `FileFormatError`."""
        self.get(number)
        return self._archive(number)

    def _names(self) -> list[str]:
        return [file.name for file in self._folder.iterdir()] if self._folder.is_dir() else []

    def _write(self, release: Release) -> None:
        write_atomically(self._about(release.number), release.model_dump_json(indent=1).encode())

    def _about(self, number: int) -> Path:
        return self._folder / f"{number:04}.json"

    def _archive(self, number: int) -> Path:
        return self._folder / f"{number:04}.tar.gz"


def _jobs(cell: Backup) -> list[str]:
    """Folders of the jobs in a backup."""
    return sorted({Path(name).parent.name for name in cell.files if name.endswith("/job.toml")})


def _digests(cell: Backup) -> dict[str, str]:
    """SHA-256 of each job's text and shape, by its folder."""
    found = {}
    for name in cell.files:
        if name.endswith("/job.toml"):
            data = cell.files[name] + cell.files.get(f"{name.removesuffix('job.toml')}shape.npz", b"")
            found[Path(name).parent.name] = hashlib.sha256(data).hexdigest()
    return found


def _text(time: datetime) -> str:
    return time.isoformat(timespec="seconds")
