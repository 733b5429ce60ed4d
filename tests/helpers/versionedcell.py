"""A folder as /opt/edged with two versions of edged, and a cell that is restarted as its links say."""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edged.domain.frames import FramePair
from edged.files import recording
from edged.setup.fleet.offers import DONE, GateNote
from edged.setup.fleet.versions import COMPLETE, CURRENT, Switched, Versions, follow
from helpers.gatedcell import GatedCell, again

OLD, NEW = "0.1.0", "edged-0.2.0"


def make_versions(folder: Path, new: str, digest: str) -> None:
    """The running version and a new one, whose programs are this one's. new : shell that ends in "$@"."""
    for name, script, mark in ((OLD, 'exec "$@"', ""), (NEW, new, digest)):
        place = folder / "versions" / name
        (place / "bin").mkdir(parents=True)
        (place / "bin" / "python").write_text(f'#!/bin/sh\nset -- {sys.executable} "$@"\n{script}\n')
        (place / "bin" / "python").chmod(0o755)
        (place / COMPLETE).write_text(mark)
    (folder / CURRENT).symlink_to(f"versions/{OLD}")


@dataclass
class VersionedCell:
    """The cell, its versions, and who restarts it (`versions.Unit`). comes_up : the new one does."""

    folder: Path
    opt: Path
    pairs: list[FramePair]
    comes_up: bool = True
    ended: int = 0

    def __post_init__(self) -> None:
        self.versions = Versions(self.opt)
        self.boot()

    @property
    def current(self) -> str:
        """The version that the link means; it is whole."""
        name = self.versions.linked(CURRENT)
        assert self.versions.digest(name) is not None
        return name

    def boot(self) -> None:
        """The page's process by the current version, and one step of its gate."""
        self.cell = GatedCell(self.folder, self.pairs)
        self.cell.gate.software.running = self.current

    def restart(self) -> str:
        """See `Unit`."""
        self.boot()
        if self.current == NEW and not self.comes_up:
            return ""  # systemd has started it, and nobody hears of it again
        self.step()
        return ""

    def restarts(self) -> int:
        """See `Unit`."""
        return self.ended

    def step(self) -> GateNote:
        """One step of the gate."""
        return asyncio.run(self.cell.step())

    def follow(self) -> Switched | None:
        """As root's service does, started anew."""
        return follow(self.versions, self.cell.cell.folder, self, 0.2, 0.01, lambda: not self.ended)

    def reach(self, *steps: str) -> GateNote:
        """Step, and let root follow, until one of these."""
        for _ in range(20):
            note = self.step()
            if note.step in steps:
                return note
            self.follow()
        raise AssertionError(f"{note.step}: {note.why}")

    def measure(self, number: int, *, is_bad: bool, **changed: float) -> None:
        """So many cycles more, as the first recorded one, or without a part. changed : see `again`."""
        entry = recording.entries(self.folder / "recordings")
        for later in range(1, number + 1):
            again(entry[0], entry[-1].index - entry[0].index + later, is_bad=is_bad, **changed)

    def whole_way(self) -> GateNote:
        """To the end of a release that finds nothing."""
        note = self.reach("probation", "rolling back", *DONE)
        if note.step == "probation" and len(recording.entries(self.folder / "recordings")) < 90:
            self.measure(40, is_bad=True)
        return note if note.step in DONE else self.reach(*DONE)


def canned(lines: list[dict[str, Any]], file: Path) -> str:
    """A new version that has measured before: it says what is in a file."""
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return f'exec cat "{file}"'


def copied(cell: VersionedCell, place: Path) -> VersionedCell:
    """Another one, with the same files."""
    shutil.copytree(cell.folder, place / "cell")
    shutil.copytree(cell.opt, place / "opt", symlinks=True)
    config = place / "cell" / "cell.toml"
    config.write_text(config.read_text().replace(str(cell.opt), str(place / "opt")))
    return VersionedCell(place / "cell", place / "opt", cell.pairs)
