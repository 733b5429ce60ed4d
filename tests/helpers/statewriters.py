"""Everything that writes to the state directory, and whether a power cut leaves the old or the new state."""

from __future__ import annotations

import asyncio
import random
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from edged.adapters.recorder import Recorder
from edged.commands.backup import backup, restore
from edged.config.cell import RecorderSection
from edged.domain.events import Event, ExposureDone
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Status
from edged.files import atomic, recording
from edged.files.jobs import load_job, save_job
from edged.files.rig import keep_old_rig, load_rig, save_rig
from edged.setup.cellfiles import read_cell
from edged.setup.releases.archive import unpack
from helpers.powercuts import Record, cut, read_disk
from helpers.snapshots import make_snapshot

QUIET = Console(quiet=True)
START_NS = 1_700_000_000_000_000_000
SETUPS: Mapping[str, Mapping[str, bytes]] = {
    name: {"rig.json": name.encode(), "cell.toml": b"", "jobs/flange/job.toml": name.encode()}
    for name in ("0badcafe", "1badcafe")
}


# --- writing and reading --------------------------------------------------------------------------


def recorder(folder: Path, fingerprint: str) -> Recorder:
    """A recorder that keeps two good cycles, so that older ones and their setups are deleted."""
    settings = RecorderSection(folder=folder, keep_good=2, min_free_mib=0)
    return Recorder(settings, lambda: (fingerprint, SETUPS[fingerprint]), lambda: START_NS)


def record(folder: Path, fingerprint: str) -> None:
    """Start the recorder, record one cycle, and close it."""
    image = np.zeros((4, 4), np.uint8)
    pair = FramePair(*(Frame(side, 7, image, 5, START_NS) for side in ("left", "right")))
    done: Event = replace(make_snapshot(1, Status.OK), fingerprint=fingerprint)

    async def live() -> None:
        keeper = recorder(folder, fingerprint)
        await keeper.start()
        keeper.announce(ExposureDone(1, None, pair))
        keeper.announce(done)
        while keeper.figures.written + keeper.figures.failed == 0:  # noqa: ASYNC110  (there is no event for it)
            await asyncio.sleep(0.0005)
        await keeper.close()
        assert 0 == keeper.figures.failed

    asyncio.run(live())


def sweep(folder: Path) -> None:
    """Start and close the recorder, as the next start of the daemon does."""

    async def live() -> None:
        keeper = recorder(folder, "0badcafe")
        await keeper.start()
        await keeper.close()
        assert 0 == keeper.figures.failed

    asyncio.run(live())


def files(folder: Path) -> dict[str, bytes]:
    """Content of each file by relative path."""
    return {
        file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()
    }


@dataclass(frozen=True)
class State:
    """The part of the state directory that programs read.

    cell : the fingerprint of configuration, rig and jobs, and the modes of their files and folders.
    backup : the fingerprint in the archive.  recordings : names of the complete ones.
    """

    cell: tuple[str, tuple[tuple[str, int], ...]]
    backup: str
    recordings: frozenset[str]


def read_state(root: Path, known: dict[frozenset[tuple[str, bytes]], str]) -> State:
    """Read the state with the product's functions; whatever cannot be read raises.

    known : fingerprints of cells already read, by all their files; drafts are compared by name only.
    """
    found = files(root / "cell").items()
    content = frozenset((name, b"" if "/." in f"/{name}" else data) for name, data in found)
    if content not in known:
        known[content] = read_cell(root / "cell" / "cell.toml").fingerprint
    places = [root / "cell"] + [root / "cell" / name for name in ("cell.toml", "rig.json", "jobs")]
    for folder in (root / "cell" / "jobs").glob("[!.]*"):
        places += [folder, *folder.iterdir()]
    modes = [
        (place.relative_to(root).as_posix(), place.stat().st_mode & 0o777)
        for place in places
        if ".old" not in place.as_posix()
    ]
    archive = root / "release.tar.gz"
    packed = unpack(archive.read_bytes(), "there").fingerprint if archive.exists() else ""
    sweep(root / "recordings")
    assert [] == [file for file in files(root / "recordings") if "/." in file]
    entries = recording.entries(root / "recordings")
    for entry in entries:
        recording.load(entry.path)
    setups = recording.setups(root / "recordings")
    assert {entry.fingerprint for entry in entries} <= setups
    for name in setups:
        assert SETUPS[name] == files(recording.setup_folder(root / "recordings", name))
    return State(
        (known[content], tuple(sorted(modes))), packed, frozenset(entry.path.name for entry in entries)
    )


class Writers:
    """Everything that writes to the state directory, in turns."""

    def __init__(self, root: Path, template: Path, dice: random.Random) -> None:
        self._root, self._dice = root, dice
        self._cell = root / "cell"
        self._job = load_job(template.parent / "jobs" / "flange")
        self._rig = load_rig(template.parent / "rig.json")
        self._text = template.read_bytes()
        self._count = 0

    def first(self) -> None:
        """Create the cell."""
        self._cell.mkdir()
        atomic.sync(self._root)
        self.calibrate()
        self.teach()
        atomic.write_atomically(self._cell / "cell.toml", self._text)

    def teach(self) -> None:
        """Save the job again, with another score."""
        self._count += 1
        search = replace(self._job.search, min_score=0.5 + 0.001 * self._count)
        save_job(self._cell / "jobs" / "flange", replace(self._job, search=search))

    def calibrate(self) -> None:
        """Save another rig; the former one is kept."""
        self._count += 1
        keep_old_rig(self._cell / "rig.json")
        save_rig(self._cell / "rig.json", replace(self._rig, calibration_id=f"cal{self._count}"))

    def release(self) -> None:
        """Write a backup over the previous one."""
        backup(self._cell / "cell.toml", self._root / "release.tar.gz", QUIET, force=True)

    def go_back(self) -> None:
        """Restore the last backup into the running cell."""
        assert 0 == restore(self._root / "release.tar.gz", self._cell, QUIET, force=True)

    def record(self) -> None:
        """Record a cycle with one of two setups."""
        record(self._root / "recordings", self._dice.choice(list(SETUPS)))

    def all(self, count: int) -> list[Callable[[], None]]:
        """Create a cell and a backup, then run `count` random writers."""
        some = [self.teach, self.calibrate, self.release, self.go_back, self.record, self.record]
        return [self.first, self.release, *(self._dice.choice(some) for _ in range(count))]


@dataclass(frozen=True)
class Step:
    """The calls of one writer: those from `start` to `end`."""

    name: str
    start: int
    end: int
    before: State
    after: State


def watch(record: Record, work: Iterable[Callable[[], None]], copies: Path) -> list[Step]:
    """Run the writers one after the other and record their calls; the first one only prepares."""
    copies.mkdir()
    steps: list[Step] = []
    before: State | None = None
    for number, write in enumerate(work):
        start = len(record.calls)
        with record.watching():
            write()
        copy = copies / str(number)
        record.now.write(copy)
        after = read_state(copy, {})
        if before is not None:
            steps.append(Step(write.__name__, start, len(record.calls), before, after))
        before = after
    return steps


def flaw(step: Step, found: State) -> str:
    """Describe how a state left by a power cut is neither that before the step nor that after it."""
    before, after = step.before, step.after
    if found.cell not in (before.cell, after.cell):
        return f"{step.name}: a cell that never was: {found.cell}"
    if found.backup not in (before.backup, after.backup):
        return f"{step.name}: a backup that never was: {found.backup}"
    if not before.recordings & after.recordings <= found.recordings <= before.recordings | after.recordings:
        return f"{step.name}: recordings {sorted(found.recordings)}"
    return ""


def survive(template: Path, folder: Path, cuts: int, seed: int) -> list[str]:
    """Run twenty writers below a folder and cut the power `cuts` times; returns every flaw."""
    dice = random.Random(seed)
    root = folder / "state"
    root.mkdir()
    watched = Record(root)
    steps = watch(watched, Writers(root, template, dice).all(20), folder / "copies")
    assert read_disk(root) == watched.now.tree(), "a call was not recorded"
    return cut_often(watched, steps, cuts, dice, folder / "left")


def cut_often(record: Record, steps: list[Step], cuts: int, dice: random.Random, folder: Path) -> list[str]:
    """Cut the power this many times; returns every flaw. A writer that has returned has its data on disk."""
    folder.mkdir()
    flaws: list[str] = []
    known: dict[frozenset[tuple[str, bytes]], str] = {}
    for number in range(cuts):
        step = dice.choice(steps)
        position = dice.randint(step.start + 1, step.end)
        left = folder / str(number)
        cut(record.calls[:position], dice).write(left)
        expected = step if position < step.end else replace(step, before=step.after)
        try:
            problem = flaw(expected, read_state(left, known))
        except Exception as error:  # noqa: BLE001  (any of them would keep the daemon from starting)
            problem = f"{step.name}: {error!r}"
        shutil.rmtree(left)
        if problem:
            flaws.append(f"{problem} (cut after {position - step.start} of {step.end - step.start} calls)")
    return flaws
