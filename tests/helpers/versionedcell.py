"""A folder like /opt/edged with two versions of edged, and a cell that restarts with the linked version."""

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
    """The running version and a new one, both running this checkout. new : shell script that ends in "$@"."""
    for name, script, mark in ((OLD, 'exec "$@"', ""), (NEW, new, digest)):
        place = folder / "versions" / name
        (place / "bin").mkdir(parents=True)
        (place / "bin" / "python").write_text(f'#!/bin/sh\nset -- {sys.executable} "$@"\n{script}\n')
        (place / "bin" / "python").chmod(0o755)
        (place / COMPLETE).write_text(mark)
    (folder / CURRENT).symlink_to(f"versions/{OLD}")


@dataclass
class VersionedCell:
    """The cell, its versions, and its restarts (`versions.Unit`). comes_up : whether the new one starts."""

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
        """Version that the link points to, which must be complete."""
        name = self.versions.linked(CURRENT)
        assert self.versions.digest(name) is not None
        return name

    def boot(self) -> None:
        """Start the page's gate with the current version."""
        self.cell = GatedCell(self.folder, self.pairs)
        self.cell.gate.software.running = self.current

    def restart(self) -> str:
        """Restart the cell, see `Unit`."""
        self.boot()
        if self.current == NEW and not self.comes_up:
            return ""  # systemd has started it, but it never responds
        self.step()
        return ""

    def restarts(self) -> int:
        """Number of restarts, see `Unit`."""
        return self.ended

    def step(self) -> GateNote:
        """Take one step of the gate."""
        return asyncio.run(self.cell.step())

    def follow(self) -> Switched | None:
        """Run root's service, as if just started."""
        return follow(self.versions, self.cell.cell.folder, self, 0.2, 0.01, lambda: not self.ended)

    def reach(self, *steps: str) -> GateNote:
        """Step, and let root's service follow, until the gate reaches one of these steps."""
        for _ in range(20):
            note = self.step()
            if note.step in steps:
                return note
            self.follow()
        raise AssertionError(f"{note.step}: {note.why}")

    def measure(self, number: int, *, is_bad: bool, **changed: float) -> None:
        """Add this many cycles like the first recorded one, or without a part. changed : see `again`."""
        entry = recording.entries(self.folder / "recordings")
        for later in range(1, number + 1):
            again(entry[0], entry[-1].index - entry[0].index + later, is_bad=is_bad, **changed)

    def whole_way(self) -> GateNote:
        """Run a release to its end, with only bad cycles."""
        note = self.reach("probation", "rolling back", *DONE)
        if note.step == "probation" and len(recording.entries(self.folder / "recordings")) < 90:
            self.measure(40, is_bad=True)
        return note if note.step in DONE else self.reach(*DONE)


def canned(lines: list[dict[str, Any]], file: Path) -> str:
    """A new version whose measurement is fixed: it prints the contents of a file."""
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return f'exec cat "{file}"'


def copied(cell: VersionedCell, place: Path) -> VersionedCell:
    """A copy with the same files."""
    shutil.copytree(cell.folder, place / "cell")
    shutil.copytree(cell.opt, place / "opt", symlinks=True)
    config = place / "cell" / "cell.toml"
    config.write_text(config.read_text().replace(str(cell.opt), str(place / "opt")))
    return VersionedCell(place / "cell", place / "opt", cell.pairs)
