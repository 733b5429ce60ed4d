"""The jobs of a running cell: listed with their use, renamed, renumbered, retired and brought back."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from edged.domain.overview import Use
from edged.errors import FileFormatError, UserError
from edged.files.atomic import make_folders, write_atomically
from edged.setup.documents import Frozen, now_text
from edged.setup.history import Kept, Text
from edged.setup.inuse import CellInUse
from edged.setup.releases.jobsfolder import Jobs as Files
from edged.setup.releases.jobsfolder import of_job, renamed, with_job, without_job
from edged.setup.releases.jobsinuse import JobLine, JobsInUse
from edged.setup.releases.releasefolder import Release, ReleaseFolder
from edged.setup.releases.service import Activation, Mandate
from edged.setup.teaching.drafts import keeps_pair
from edged.setup.teaching.model import JobName, Number

log = logging.getLogger(__name__)


class JobDocument(Frozen):
    """A job. active : the one in use now.  last_used, cycles, ok_share : since the start.

    editable : the pair that it was taught from is kept.  retired : out of use, and kept in a release.
    """

    folder: str
    name: str
    number: int
    features: int
    last_used: str | None = None
    cycles: int = 0
    ok_share: float | None = None
    active: bool = False
    editable: bool = False
    retired: bool = False
    retired_by: str | None = None
    retired_at: str | None = None


class JobList(Frozen):
    """All jobs, sorted by number; retired ones come last."""

    jobs: list[JobDocument]


class VersionDocument(Frozen):
    """A release that changed a job. active : the job is now as it was in this release."""

    release: int
    created: str
    author: str
    note: str
    active: bool


class VersionList(Frozen):
    """Versions of a job, newest first."""

    versions: list[VersionDocument]


class Retired(Kept):
    """A job that was taken out of use."""

    name: JobName
    number: Number
    features: Annotated[int, Field(ge=0)]
    by: Text
    at: Text


_KEPT = TypeAdapter(dict[str, Retired])


class Jobs:
    """Jobs of a running cell; used on the event loop only."""

    def __init__(self, cell: CellInUse, releases: ReleaseFolder, activation: Activation) -> None:
        self._cell = cell
        self._retired = cell.folder / "retired.json"
        self._releases = releases
        self._activation = activation

    async def listed(self) -> JobList:
        """List all jobs, retired ones included."""
        return await asyncio.to_thread(self._listed)

    async def take(self, job: str) -> None:
        """Switch to a job, as a PLC's command does, while no PLC has the right to write.

        Raises `KeyError`, `SetupRefused`, `CommandRefused`.
        """
        await self._cell.running.take_job(self._cell.job_lines().line(job).number)

    async def keep_golden(self, job: str) -> None:
        """Measure now, and keep the pose of the job's only good part, as the command GOLDEN does.

        Raises `KeyError`, `SetupRefused`, `CommandRefused`; then nothing has changed.
        """
        await self._cell.running.keep_golden(self._cell.job_lines().line(job).number)

    async def change(self, job: str, by: Mandate, *, name: str | None, number: int | None) -> Release:
        """Rename or renumber a job. Raises `KeyError`, `UserError`; then nothing has changed."""
        jobs = self._cell.job_lines()
        line, folder = jobs.line(job), jobs.line(job).folder
        if name is not None and name != line.name:
            _check_unnamed(line, jobs)
        wanted_name, wanted_number = name or line.name, number or line.number
        jobs.check_free(wanted_name, wanted_number, folder)
        place = wanted_name if folder == line.name else folder

        def changed(there: Files) -> Files:
            files = renamed(of_job(there, folder), name=wanted_name, number=wanted_number)
            return with_job(there, place, files, folder)

        return await self._activation.activate_jobs(changed, by)

    async def copy(self, job: str, by: Mandate, *, name: str, number: int | None) -> Release:
        """Copy a job under another name and number. Raises as `change`."""
        folder = self._cell.job_lines().line(job).folder
        wanted = number or self._cell.job_lines().free_number
        self._cell.job_lines().check_free(name, wanted, None)

        def copied(there: Files) -> Files:
            return with_job(there, name, renamed(of_job(there, folder), name=name, number=wanted), None)

        return await self._activation.activate_jobs(copied, by)

    async def versions(self, job: str) -> VersionList:
        """Versions of a job in use, from releases that were ever active."""
        folder = self._cell.job_lines().line(job).folder
        releases, active = await self._activation.listed()
        now = next((release.digests.get(folder) for release in releases if release.number == active), None)
        found, before = list[VersionDocument](), None
        for release in reversed([release for release in releases if release.activated]):
            digest = release.digests.get(folder)
            if digest is not None and digest != before:
                fields = release.model_dump(include={"created", "author", "note"})
                found.append(VersionDocument(release=release.number, active=digest == now, **fields))
            before = digest
        return VersionList(versions=found[::-1])

    async def retire(self, job: str, by: Mandate) -> Release:
        """Take a job out of use; its release keeps it. Raises `KeyError`; `UserError` for the last one."""
        jobs = self._cell.job_lines()
        line, folder = jobs.line(job), jobs.line(job).folder
        _check_unnamed(line, jobs)
        if len(jobs.lines) == 1:
            raise UserError("it is the only job: a cell without any measures nothing", "last_job")
        kept = Retired(
            name=line.name, number=line.number, features=line.features, by=by.author, at=now_text()
        )
        # noted first: a job in use never counts as retired, whatever is noted
        await asyncio.to_thread(self._note, folder, kept)
        return await self._activation.activate_jobs(lambda there: without_job(there, folder), by)

    async def bring_back(self, job: str, by: Mandate, *, number: int | None) -> Release:
        """Bring back a retired job. number : a new one instead of its own. Raises as `change`."""
        retired = await asyncio.to_thread(self._kept)
        folder = job if job in retired else {former.name: name for name, former in retired.items()}[job]
        kept = retired[folder]
        wanted = number or kept.number
        self._cell.job_lines().check_free(kept.name, wanted, None)
        files = await asyncio.to_thread(self._files, folder)
        if number is not None:
            files = renamed(files, name=None, number=number)
        release = await self._activation.activate_jobs(lambda there: with_job(there, folder, files, None), by)
        await asyncio.to_thread(self._note, folder, None)
        return release

    def _listed(self) -> JobList:
        jobs = self._cell.job_lines()
        found = [self._document(line, jobs) for line in sorted(jobs.lines, key=lambda line: line.number)]
        for folder, kept in sorted(self._kept().items(), key=lambda item: item[1].number):
            retired = {"retired": True, "retired_by": kept.by, "retired_at": kept.at}
            found.append(JobDocument(folder=folder, **kept.model_dump(exclude={"by", "at"}), **retired))
        return JobList(jobs=found)

    def _document(self, line: JobLine, jobs: JobsInUse) -> JobDocument:
        now = self._cell.running.summary
        use = now.uses.get(line.number, Use())
        last = datetime.fromtimestamp(use.last_ns * 1e-9, UTC) if use.last_ns else None
        return JobDocument(
            **asdict(line),
            last_used=None if last is None else last.isoformat(timespec="seconds"),
            cycles=use.cycles,
            ok_share=use.good_share,
            active=line.number == now.active_job,
            editable=keeps_pair(jobs.folder / line.folder),
        )

    def _files(self, folder: str) -> dict[str, bytes]:
        """Files of a retired job, from the newest release that has it. Raises `UserError` if none has."""
        for release in self._releases.all():
            if folder in release.jobs:
                try:
                    return of_job(self._releases.jobs(release.number), folder)
                except FileFormatError as error:
                    log.warning("release %d: %s", release.number, error)
        raise UserError(f"no release has the job {folder} any more")

    def _kept(self) -> Mapping[str, Retired]:
        """Retired jobs by folder, without those in use again."""
        try:
            kept = _KEPT.validate_json(self._retired.read_bytes())
        except FileNotFoundError:
            return {}
        except (OSError, ValidationError) as error:
            log.warning("%s cannot be read, so no job counts as retired: %s", self._retired, error)
            return {}
        in_use = {line.folder for line in self._cell.job_lines().lines}
        return {folder: job for folder, job in kept.items() if folder not in in_use}

    def _note(self, folder: str, kept: Retired | None) -> None:
        others = {name: job for name, job in self._kept().items() if name != folder}
        if kept is not None:
            others[folder] = kept
        make_folders(self._retired.parent)
        text = json.dumps({name: job.model_dump(mode="json") for name, job in others.items()}, indent=1)
        write_atomically(self._retired, text.encode())


def _check_unnamed(line: JobLine, jobs: JobsInUse) -> None:
    """Check that the configuration does not name a job. Raises `UserError` if it does."""
    if line.name == jobs.wanted:
        raise UserError(
            f"cell.job of the configuration names {line.name}: the cell begins with it. Take that line out, "
            "or let it name another job",
            "named",
        )
