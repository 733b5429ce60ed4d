"""Sources of the pair for a new job draft: the cameras, a recorded cycle, or the replaced job."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from edged.errors import TeachError
from edged.files.recording import load
from edged.setup.inuse import CellInUse
from edged.setup.releases.jobsinuse import JobLine
from edged.setup.teaching.drafts import KeptPair, kept_pair


class Sources:
    """Gets pairs for job drafts. recorded : returns the file of a recorded cycle; raises `KeyError`."""

    def __init__(self, cell: CellInUse, recorded: Callable[[int], Awaitable[Path]]) -> None:
        self._cell = cell
        self._recorded = recorded

    async def take(self, token: str | None, cycle: int | None, replaced: JobLine | None) -> KeptPair:
        """The pair of a recorded cycle, otherwise a fresh one, otherwise the one that a job keeps.

        Raises `TeachError`, `SetupRefused`, `CaptureError`, `FileFormatError`, and `KeyError` for an unknown
        cycle.
        """
        if cycle is not None:
            file = await self._recorded(cycle)
            rig = self._cell.needed_rig()
            return await asyncio.to_thread(recorded_pair, file, rig.calibration_id)
        if token is not None:
            pair = await self._cell.session.capture(token)
            return KeptPair(*pair.images)
        if replaced is None:
            raise TeachError("a job is taught from a fresh pair, a recorded one, or that which a job keeps")
        return await asyncio.to_thread(kept_pair, self._cell.job_lines().folder / replaced.folder)


def recorded_pair(file: Path, calibration_id: str) -> KeptPair:
    """The pair of a recorded cycle measured with the rig in use. Raises `TeachError`, `FileFormatError`."""
    cycle = load(file)
    if cycle.pair is None:
        raise TeachError("that cycle has no pictures: the cameras gave none", "no_pictures")
    if cycle.snapshot.get("calibration") != calibration_id:
        raise TeachError(
            "that cycle was measured by another rig: what its pictures show is elsewhere by now", "other_rig"
        )
    return KeptPair(cycle.pair.left.image, cycle.pair.right.image)
