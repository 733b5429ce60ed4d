"""What the worker process does with recorded cycles: by name, with a `Progress` before the arguments."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from edged.commissioning import whatif
from edged.commissioning.pairs import Progress
from edged.commissioning.setups import Setups
from edged.commissioning.whatif import Change, WhatIf
from edged.files import recording


@lru_cache(maxsize=1)
def _setups() -> Setups:
    """Read once: rigs and jobs of recordings do not change under their fingerprint."""
    return Setups()


def what_if(progress: Progress, file: Path, change: Change | None) -> WhatIf:
    """One recording by the rig and the job that it was measured by, and by a change."""
    taken = recording.load(file)
    rig, job = _setups().of(file, taken.snapshot)
    return whatif.what_if(file, taken, rig, job, change, progress)
