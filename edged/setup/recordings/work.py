"""What the worker process does with recorded cycles: by name, with a `Progress` before the arguments."""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from edged.files import recording
from edged.setup.pairs import Progress
from edged.setup.recordings import whatif
from edged.setup.recordings.comparing import TriedCycle, try_on
from edged.setup.recordings.setups import Contents, MeasuredBy, Setups, measured_by, successors
from edged.setup.recordings.whatif import Change, WhatIf
from edged.setup.releases.archive import read
from edged.setup.releases.differences import ReleaseDifference, difference


@lru_cache(maxsize=1)
def _setups() -> Setups:
    """Read once: rigs and jobs of recordings do not change under their fingerprint."""
    return Setups()


def what_if(progress: Progress, file: Path, change: Change | None) -> WhatIf:
    """One recording by the rig and the job that it was measured by, and by a change."""
    taken = recording.load(file)
    rig, job = _setups().of(file, taken.snapshot)
    return whatif.what_if(file, taken, rig, job, change, progress)


def try_recordings(
    _progress: Progress,
    entries: Sequence[recording.Entry],
    active: Contents,
    candidate: Contents,
    most_s: float,
) -> list[TriedCycle]:
    """The first of some recordings by two setups: as many as the time allows, one at least."""
    end_s = time.monotonic() + most_s
    before, after = _in_memory().of(active), _in_memory().of(candidate)
    after = after.in_place_of(successors(active, candidate))
    tried: list[TriedCycle] = []
    for entry in entries:
        tried.append(try_on(entry, before, after, _setups()))
        if time.monotonic() >= end_s:
            break
    return tried


def compare_releases(_progress: Progress, before: Path, after: Path) -> ReleaseDifference:
    """What is other in one archive than in another."""
    return difference(read(before), read(after))


class _InMemory:
    """The setups that were tried last: with what a rig prepares, they take longer to make than a cycle."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, MeasuredBy] = OrderedDict()

    def of(self, contents: Contents) -> MeasuredBy:
        """A setup from its files."""
        whole = hashlib.sha256()
        for name in sorted(contents):
            whole.update(name.encode() + b"\0" + hashlib.sha256(contents[name]).digest())
        key = whole.hexdigest()
        if key not in self._known:
            self._known[key] = measured_by(contents, Path("a setup"))
        self._known.move_to_end(key)
        while len(self._known) > 2:
            self._known.popitem(last=False)
        return self._known[key]


@lru_cache(maxsize=1)
def _in_memory() -> _InMemory:
    return _InMemory()
