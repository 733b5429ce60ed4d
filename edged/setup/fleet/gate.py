"""The gate of a cell: tries a fetched release on recordings, waits for permission, and supervises probation.

    staged -> waiting -> activating -> probation -> committed
           -> refused                            -> rolling back -> rolled back

Each step is noted on disc before it is taken: whenever the power fails, the cell runs with the old jobs or
with the new ones, as `Activation` guarantees, and the gate resumes where it was: the cell's fingerprint tells
which.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from edged.errors import EdgedError, FileFormatError, LinkError, RegressionNeeded, SetupRefused, UserError
from edged.files.atomic import make_folders, read_bytes, write_atomically
from edged.identity.audit import AuditEntry, AuditFile
from edged.setup.documents import now_text
from edged.setup.fleet.objections import RecordedJudgement, objection
from edged.setup.fleet.offers import (
    DONE,
    FOLDER,
    GATE,
    GateNote,
    Staged,
    fetched_in,
    file_of,
    gate_in,
    jobs_in_release,
)
from edged.setup.fleet.probation import baseline_of, counted, judge
from edged.setup.fleet.software import SoftwareGate
from edged.setup.inuse import CellInUse
from edged.setup.recordings.regressiondocuments import TriedCandidate
from edged.setup.recordings.regressions import Regressions
from edged.setup.recordings.setups import Contents, affected_jobs, successors
from edged.setup.releases.archive import MAX_BYTES, Parts, parts_at, with_parts
from edged.setup.releases.jobsfolder import Jobs, contents_with, of_job, with_job
from edged.setup.releases.service import Activation, Mandate

log = logging.getLogger(__name__)

AUTHOR = "fleet"
POLL_S = 2.0


class FleetGate:
    """Gate for releases of a cell; used on the event loop. now : returns local time, for the window."""

    def __init__(
        self,
        cell: CellInUse,
        activation: Activation,
        regressions: Regressions,
        now: Callable[[], datetime] = lambda: datetime.now().astimezone(),
    ) -> None:
        self._cell = cell
        self._activation = activation
        self._regressions = regressions
        self._now = now
        self._recorded = RecordedJudgement(cell)
        self.software = SoftwareGate(cell, regressions, self._recorded, self)
        self._running: asyncio.Task[None] | None = None

    @property
    def _folder(self) -> Path:
        return self._cell.folder / FOLDER

    def start(self) -> None:
        """Start to look for releases."""
        self._running = asyncio.create_task(self._run(), name="fleet")
        self._running.add_done_callback(_tell_of_a_bug)

    async def close(self) -> None:
        """Stop; the gate resumes at the next start."""
        if self._running is not None:
            self._running.cancel()
            await asyncio.wait({self._running})

    async def _run(self) -> None:
        last = ""
        while True:
            try:
                if self._cell.files.config.fleet is not None and self._cell.is_complete:
                    await self.step()
                last = ""
            except (EdgedError, OSError) as error:
                if str(error) != last:
                    # the message says what and where: a traceback adds nothing
                    log.error("the gate of releases waits: %s", error)  # noqa: TRY400
                last = str(error)
            await asyncio.sleep(POLL_S)

    async def step(self) -> GateNote | None:
        """Take the next step if there is one, and return the gate's note. Raises `EdgedError`, `OSError`."""
        staged, note = await asyncio.to_thread(self._read)
        if staged is not None and (
            note is None or (note.step in DONE and note.staged.identity != staged.identity)
        ):
            note = await self.note(GateNote(staged=staged), "staged", "fetched and verified")
        if note is None or note.step in DONE:
            return note
        try:
            return await self._next(note)
        except SetupRefused as error:  # locked since `has_leave` was checked
            log.info("release %s waits: %s", note.staged.offer.name, error)
            return note

    async def _next(self, note: GateNote) -> GateNote:
        if note.staged.offer.kind == "software":
            return await self.software.next(note)
        running = self._cell.files.fingerprint
        match note.step:
            case "staged":
                return await self._try(note)
            case "waiting":
                return await self._activate(note) if self.has_leave(in_window=True) else note
            case "activating":
                if running == note.wanted:
                    return await self._begin_probation(note)
                return await self.note(note, "waiting", "the cell was stopped before it became active")
            case "probation" if running == note.wanted:
                return await self.judge(note)
            case "rolling back" if running == note.wanted:
                return await self._roll_back(note) if self.has_leave(in_window=False) else note
            case "rolling back" if running == note.before:
                return await self.note(note, "rolled back", note.why)
        return await self.note(note, "left", "somebody has changed the cell meanwhile: it is theirs")

    def has_leave(self, *, in_window: bool) -> bool:
        """Whether jobs may change now: unlocked, no lease held, and in the window if in_window."""
        session, section = self._cell.session, self._cell.files.config.fleet
        is_open = section is None or section.is_open(self._now().time())
        return not session.is_locked and not session.holder and (is_open or not in_window)

    # --- steps --------------------------------------------------------------------------------------

    async def _try(self, note: GateNote) -> GateNote:
        """Measure recorded cycles with the release."""
        try:
            jobs = await asyncio.to_thread(self._jobs, note.staged)
            active = self._cell.files.contents
            candidate = contents_with(active, merged((await asyncio.to_thread(self._there)).jobs, jobs))
            changed = await asyncio.to_thread(self._changed, active, candidate)
            why = "only new jobs: nothing recorded is measured otherwise"
            if changed:
                why = await self._regression(note.staged, active, candidate, changed)
        except UserError as error:
            return await self.note(note, "refused", str(error))
        return await self.note(
            note.model_copy(update={"jobs": tuple(sorted(changed.values()))}), "waiting", why
        )

    async def _regression(
        self, staged: Staged, active: Contents, candidate: Contents, changed: Mapping[int, int]
    ) -> str:
        """Run a regression; return the reason to accept the release. Raises `UserError` for an objection."""
        await asyncio.to_thread(self._recorded.check, active, changed)
        what = TriedCandidate(kind="release", id=staged.offer.name)
        task, identity = await self._regressions.begin(candidate, what, AUTHOR)
        while self._cell.tasks.is_running(task):  # noqa: ASYNC110  (a worker's process measures)
            await asyncio.sleep(0.1)
        try:
            found = await self._regressions.get(identity)
        except KeyError:
            problem = self._cell.tasks.document(task).problem
            reason = "it was cancelled" if problem is None else problem.detail
            raise FileFormatError(f"recorded cycles could not be measured: {reason}") from None
        if against := objection(found, staged.offer.may_move_um / 1000):
            raise UserError(f"regression {identity}: {against}")
        return f"regression {identity}: {found.counts.good_stay} good recorded cycles stay as they are"

    async def _activate(self, note: GateNote) -> GateNote:
        jobs = await asyncio.to_thread(self._jobs, note.staged)
        before, there = self._cell.files, await asyncio.to_thread(self._there)
        wanted = merged(there.jobs, jobs)
        with_it = await asyncio.to_thread(with_parts, self._cell.path, replace(there, jobs=wanted))
        fingerprint = with_it.fingerprint
        if fingerprint == before.fingerprint:
            return await self.note(note, "committed", "the cell runs by these jobs already")
        changed = await asyncio.to_thread(
            self._changed, before.contents, contents_with(before.contents, wanted)
        )
        last, cycles = await asyncio.to_thread(self._recorded.before, changed)
        known = {
            "before": before.fingerprint,
            "wanted": fingerprint,
            "since": last,
            "baseline": baseline_of(cycles),
            "jobs": tuple(sorted(changed.values())),
        }
        note = await self.note(note.model_copy(update=known), "activating", note.why)
        by = Mandate(AUTHOR, f"release {note.staged.offer.name}")
        try:
            await self._activation.activate_jobs(lambda there: merged(there, jobs), by)
        except SetupRefused as error:
            return await self.note(note, "waiting", str(error))
        except (UserError, FileFormatError) as error:
            return await self.note(note, "refused", str(error))
        except RegressionNeeded as error:  # the cell has changed since the regression
            return await self.note(note, "staged", str(error))
        except LinkError as error:  # the cell's fingerprint will show whether it was installed
            log.warning("release %s: %s", note.staged.offer.name, error)
        return note

    async def _begin_probation(self, note: GateNote) -> GateNote:
        releases, active = await self._activation.listed()
        former = next((release.parent for release in releases if release.number == active), None)
        if former is None or not any(release.number == former for release in releases):
            former = next((r.number for r in releases if r.fingerprint == note.before), None)
        return await self.note(note.model_copy(update={"former": former}), "probation", "the cell runs by it")

    async def judge(self, note: GateNote) -> GateNote:
        """Count the cycles since the last call, and decide."""
        since, cycles = await asyncio.to_thread(self._recorded.since, note)
        tally = counted(note.baseline, note.tally, cycles)
        found = judge(note.baseline, tally)
        note = note.model_copy(update={"since": since, "tally": tally})
        if found.decision == "commit":
            return await self.note(note, "committed", found.why)
        if found.decision == "roll back":
            return await self.note(note, "rolling back", found.why)
        return await self.note(note, "probation", found.why, is_news=False) if cycles else note

    async def _roll_back(self, note: GateNote) -> GateNote:
        if note.former is None:
            return await self.note(
                note, "left", f"{note.why}; and no release of before is there to go back to"
            )
        by = Mandate(AUTHOR, f"back from release {note.staged.offer.name}: {note.why}")
        await self._activation.activate_again(note.former, by)
        return await self.note(note, "rolled back", note.why)

    # --- files --------------------------------------------------------------------------------------

    def _read(self) -> tuple[Staged | None, GateNote | None]:
        return fetched_in(self._folder), gate_in(self._folder)

    async def note(self, note: GateNote, step: str, why: str, *, is_news: bool = True) -> GateNote:
        """Write down a step before it is taken."""
        noted = GateNote.model_validate(
            {**note.model_dump(), "step": step, "why": why[:2000], "at": now_text()}
        )
        await asyncio.to_thread(self._write, noted, is_news)
        if noted.step in DONE:
            self._recorded.forget()
        return noted

    def _write(self, note: GateNote, is_news: bool) -> None:
        make_folders(self._folder)
        write_atomically(self._folder / GATE, note.model_dump_json(indent=1).encode())
        if not is_news:
            return
        name = note.staged.offer.name
        log.info("release %s: %s: %s", name, note.step, note.why)
        entry = AuditEntry(
            AUTHOR,
            "",
            "",
            note.step,
            f"release {name}",
            "ok",
            note.before or None,
            note.wanted or None,
            note.why,
        )
        AuditFile(self._cell.folder).add(entry)

    def _jobs(self, staged: Staged) -> Jobs:
        """Jobs of a staged release. Raises `FileFormatError`."""
        file = self._folder / file_of(staged)
        data = read_bytes(file, "a release", MAX_BYTES)
        if hashlib.sha256(data).hexdigest() != staged.sha256:
            raise FileFormatError(f"{file}: is not what was signed: fetch it again")
        return jobs_in_release(data, str(file))

    def _there(self) -> Parts:
        section = self._cell.files.config.cell
        return parts_at(section.rig, section.jobs)

    @staticmethod
    def _changed(active: Contents, candidate: Contents) -> dict[int, int]:
        """Old and new numbers of the jobs that are measured differently."""
        there, numbers = successors(active, candidate), affected_jobs(active, candidate)
        return {old: new for old, new in there.items() if numbers is None or old in numbers}


def merged(there: Jobs, jobs: Jobs) -> Jobs:
    """The cell's jobs with those of a release added or replaced; others stay."""
    for folder in {place.split("/")[0] for place in jobs}:
        there = with_job(there, folder, of_job(jobs, folder), None)
    return there


def _tell_of_a_bug(ended: asyncio.Task[None]) -> None:
    if not ended.cancelled() and (bug := ended.exception()) is not None:
        log.error("the gate of releases has ended: no release becomes active", exc_info=bug)
