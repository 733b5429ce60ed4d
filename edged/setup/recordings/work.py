"""Functions that the worker process runs for recorded cycles."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from edged.files import recording
from edged.setup.pairs import Progress
from edged.setup.recordings import whatif
from edged.setup.recordings.comparing import TriedCycle, try_on
from edged.setup.recordings.setups import Contents, MeasuredBy, measured_by, rig_and_job, successors
from edged.setup.recordings.whatif import Change, WhatIf
from edged.setup.releases.archive import read
from edged.setup.releases.differences import ReleaseDifference, difference


def what_if(file: Path, change: Change | None, progress: Progress) -> WhatIf:
    """Measure one recording with its own rig and job, and with a change."""
    taken = recording.load(file)
    rig, job = rig_and_job(file, taken.snapshot)
    return whatif.what_if(file, taken, rig, job, change, progress)


def try_recordings(
    entries: Sequence[recording.Entry], active: Contents, candidate: Contents, most_s: float
) -> list[TriedCycle]:
    """Measure recordings with two setups: as many as the time allows, but at least one."""
    end_s = time.monotonic() + most_s
    before, after = (_measured_by(tuple(sorted(files.items()))) for files in (active, candidate))
    after = after.in_place_of(successors(active, candidate))
    tried: list[TriedCycle] = []
    for entry in entries:
        tried.append(try_on(entry, before, after))
        if time.monotonic() >= end_s:
            break
    return tried


def compare_releases(before: Path, after: Path) -> ReleaseDifference:
    """Differences between two archives."""
    return difference(read(before), read(after))


@lru_cache(maxsize=2)  # preparing a setup takes longer than a cycle
def _measured_by(files: tuple[tuple[str, bytes], ...]) -> MeasuredBy:
    return measured_by(dict(files), Path("a setup"))
