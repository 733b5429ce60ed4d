"""Tries a new job or rig on the recorded cycles, keeps the results, and is the gate before activation.

The worker process measures, newest first, a few seconds at a time, so that other requests get their turn.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from edged.errors import FileFormatError, RegressionNeeded, UserError
from edged.files import recording
from edged.files.atomic import make_folders, write_atomically
from edged.setup.documents import read_model
from edged.setup.inuse import CellInUse
from edged.setup.pairs import Progress
from edged.setup.recordings.comparing import TriedCycle, compare
from edged.setup.recordings.recorded import CycleLine, Records
from edged.setup.recordings.regressiondocuments import (
    RegressionDocument,
    RegressionLine,
    TriedCandidate,
    document_of,
)
from edged.setup.recordings.setups import Contents, affected_jobs, digest_of, facts_of_jobs, job_of_cycle
from edged.setup.releases.releasefolder import Tested

log = logging.getLogger(__name__)

FUNCTIONS = {name: f"edged.setup.recordings.work:{name}" for name in ("try_recordings", "compare_releases")}
KEPT = 30
"""Number of results kept, a few hundred kB each at most."""
CHUNK_S = 2.0
"""Time of one request to the worker: the longest that other requests wait for it."""
STAGE = "measuring recorded cycles"


class Regressions:
    """Regression tests of a cell; used on its event loop."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._kept = cell.folder / "regressions"
        self._records: Records | None = None
        self._turn = asyncio.Lock()

    async def begin(self, candidate: Contents, what: TriedCandidate, author: str) -> tuple[str, str]:
        """Try a candidate on all recordings that it affects; return the ids of the task and of the result.

        Raises `UserError` if nothing is in use, nothing is recorded, or nothing would be measured
        differently.
        """
        active, fingerprint = self._cell.files.contents, self._cell.files.fingerprint
        if not self._cell.is_complete:
            raise UserError("nothing is in use yet that it could be compared with")
        entries = await self._in_turn(lambda: self._concerned(active, candidate))
        if not entries:
            raise UserError("it changes nothing that recorded cycles are measured with")
        now = datetime.now(UTC)
        identity = f"{now:%Y%m%d-%H%M%S}-{now.microsecond >> 4:04x}"  # sorts by start time

        async def work(progress: Progress) -> None:
            begun_s = time.monotonic()
            tried = await self._tried(entries, active, candidate, progress)
            document = document_of(
                await asyncio.to_thread(compare, tried, of_rig=_is_other_rig(active, candidate)),
                identity=identity,
                at=now,
                by=author,
                what=what,
                against=fingerprint,
                digests=(digest_of(active), digest_of(candidate)),
                seconds=time.monotonic() - begun_s,
            )
            await asyncio.to_thread(self.keep, document)

        return self._cell.tasks.start("regression", work), identity

    async def listed(self) -> list[RegressionLine]:
        """Kept results, newest first."""
        return await asyncio.to_thread(
            lambda: [
                RegressionLine.model_validate(document, from_attributes=True) for document in self._all()
            ]
        )

    async def get(self, identity: str) -> RegressionDocument:
        """One result. Raises `KeyError`, `FileFormatError`."""
        return await asyncio.to_thread(self._read, identity)

    async def check(self, candidate: Contents, signed: str | None) -> Tested | None:
        """Gate of an activation: return the record for the release; None if no recording is affected.

        Raises `RegressionNeeded` unless all good cycles stay good, or there is a signed reason why they need
        not.
        """
        active = self._cell.files.contents
        if not self._cell.is_complete or self._cell.recordings is None:
            return None
        entries = await self._in_turn(lambda: self._concerned(active, candidate))
        if not entries:
            return None
        digests = digest_of(active), digest_of(candidate)
        done = await asyncio.to_thread(self._newest, *digests)
        good_to_bad = None if done is None else done.counts.good_to_bad
        if signed is None and good_to_bad != 0:
            raise RegressionNeeded(len(entries), good_to_bad, None if done is None else done.id)
        return Tested(
            regression=None if done is None else done.id,
            cycles=len(entries) if done is None else done.cycles,
            good_to_bad=good_to_bad,
            signed=signed if good_to_bad != 0 else None,
        )

    # --- recordings -----------------------------------------------------------------------------

    async def _in_turn(self, work: Callable[[], list[recording.Entry]]) -> list[recording.Entry]:
        async with self._turn:
            return await asyncio.to_thread(work)

    def _concerned(self, active: Contents, candidate: Contents) -> list[recording.Entry]:
        """Recordings that a candidate may measure differently, newest first. Raises `FileFormatError`."""
        folder = self._cell.recordings
        if folder is None:
            return []
        if self._records is None or self._records.folder != folder:
            self._records = Records(folder)
        numbers, jobs = affected_jobs(active, candidate), facts_of_jobs(active)
        if numbers == set():
            return []
        found = []
        for entry in self._records.entries():
            line = self._records.line(entry)
            if not isinstance(line, CycleLine) or not line.has_pictures:
                continue
            job = job_of_cycle(jobs, line.job, line.job_number)
            if numbers is None or (job is not None and job.number in numbers):
                found.append(entry)
        return found

    async def _tried(
        self, entries: Sequence[recording.Entry], active: Contents, candidate: Contents, progress: Progress
    ) -> list[TriedCycle]:
        tried: list[TriedCycle] = []
        while len(tried) < len(entries):
            progress(STAGE, len(tried), len(entries))
            rest = entries[len(tried) :]
            some: list[TriedCycle] = await self._cell.worker.run(
                "try_recordings", rest, dict(active), dict(candidate), CHUNK_S
            )
            tried += some
        progress(STAGE, len(tried), len(entries))
        return tried

    # --- results --------------------------------------------------------------------------------

    def keep(self, document: RegressionDocument) -> None:
        """Keep a result, and delete the oldest ones. Raises `OSError`."""
        make_folders(self._kept)
        write_atomically(self._kept / f"{document.id}.json", document.model_dump_json().encode())
        for old in sorted(self._kept.glob("*.json"))[:-KEPT]:
            old.unlink(missing_ok=True)

    def _read(self, identity: str) -> RegressionDocument:
        file = self._kept / f"{identity}.json"
        if not file.is_file():
            raise KeyError(identity)
        return read_model(file, RegressionDocument, "a regression")

    def _all(self) -> list[RegressionDocument]:
        found = []
        for file in sorted(self._kept.glob("*.json"), reverse=True) if self._kept.is_dir() else []:
            try:
                found.append(self._read(file.stem))
            except (KeyError, FileFormatError) as error:
                log.warning("%s", error)
        return found

    def _newest(self, against: str, candidate: str) -> RegressionDocument | None:
        fitting = (
            document
            for document in self._all()
            if (document.digest_active, document.digest) == (against, candidate)
        )
        return next(fitting, None)


def _is_other_rig(active: Contents, candidate: Contents) -> bool:
    return active.get("rig.json") != candidate.get("rig.json")
