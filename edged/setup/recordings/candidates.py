"""Candidates to try on recorded cycles, as the files that a cell would measure with."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path, PurePosixPath

from edged.errors import UserError
from edged.files.jobs import SHAPE, TEXT, check_text, job_files, job_of
from edged.setup.inuse import CellInUse
from edged.setup.recordings.setups import RIG, Contents
from edged.setup.recordings.whatif import JobChange, changed_job
from edged.setup.releases.archive import jobs_of, rig_in
from edged.setup.releases.jobsfolder import contents_with, with_job
from edged.setup.releases.jobsinuse import Candidate
from edged.setup.releases.releasefolder import ReleaseFolder

Solution = Callable[[str], Awaitable[bytes]]
"""The rig that a draft of a calibration was solved to; raises `KeyError`, `EdgedError`."""
Taught = Callable[[str], Awaitable[Candidate]]
"""The job of a teaching draft; raises `KeyError`, `EdgedError`."""


class CandidateContents:
    """Builds the files that a cell would measure with if a candidate were active."""

    def __init__(self, cell: CellInUse, releases: ReleaseFolder, solution: Solution, taught: Taught) -> None:
        self._cell = cell
        self._releases = releases
        self._solution = solution
        self._taught = taught

    async def of_calibration(self, identity: str) -> Contents:
        """Files with the rig of a solved draft. Raises `KeyError`, `EdgedError`."""
        return {**self._cell.files.contents, RIG: await self._solution(identity)}

    async def of_teaching(self, identity: str) -> Contents:
        """Files with the job of a draft, as it would become active. Raises `KeyError`, `EdgedError`."""
        job, active = await self._taught(identity), self._cell.files.contents
        jobs = {name.removeprefix("jobs/"): data for name, data in active.items() if name.startswith("jobs/")}
        return contents_with(active, job.put(jobs))

    async def of_release(self, number: int) -> Contents:
        """Files with rig and jobs of a release, as if it became active. Raises `KeyError`, `EdgedError`."""
        kept = await asyncio.to_thread(self._releases.open, number)
        jobs, active = jobs_of(kept), self._cell.files.contents
        return {**(contents_with(active, jobs) if jobs else active), RIG: rig_in(kept)}

    async def of_change(self, name: str, change: JobChange) -> Contents:
        """Files with one job's limits, features or contrast changed. Raises `UserError`."""
        active = self._cell.files.contents
        place = PurePosixPath("jobs") / name

        def changed() -> dict[str, bytes]:
            files = {file: active.get(str(place / file), b"") for file in (TEXT, SHAPE)}
            if not files[TEXT]:
                raise UserError(f"there is no job {name}")
            job = changed_job(job_of(files, Path(place)), change)
            check_text(job)
            return job_files(job)

        return with_job(active, str(place), await asyncio.to_thread(changed), None)
