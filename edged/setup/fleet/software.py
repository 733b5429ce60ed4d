"""The gate's steps for a software release, after root has installed it beside the running version.

The new version measures recorded cycles in its own environment and its own process; the results are compared
with those of the running one. Root does the switching (`versions`), by order of this gate; the page's process
knows from its own environment which version runs.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import sys
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from edged.cell.tasks import both
from edged.errors import FileFormatError, UserError
from edged.files.atomic import write_atomically
from edged.payload import Json
from edged.setup.fleet.objections import LEAST_GOOD, RecordedJudgement, objection
from edged.setup.fleet.offers import FOLDER, GateNote
from edged.setup.fleet.probation import LAST, baseline_of
from edged.setup.fleet.versions import ORDER, VersionOrder, Versions, order_in
from edged.setup.inuse import CellInUse
from edged.setup.recordings.again import tried
from edged.setup.recordings.comparing import compare
from edged.setup.recordings.regressiondocuments import TriedCandidate, document_of
from edged.setup.recordings.regressions import Regressions
from edged.setup.recordings.setups import digest_of, facts_of_jobs

MODULE = "edged.setup.recordings.again"
MOST_S = 3600.0
"""Time limit for measuring 200 recordings, including the compilation of kernels."""
AGAIN_S = 60.0
AUTHOR = "fleet"
RUNNING = Path(sys.prefix).resolve().name
"""Name of the running version, resolved at import, before a link can be switched."""
PYTHON = Path(sys.executable)


class GateSteps(Protocol):
    """Steps of the gate that are the same for any release."""

    def has_leave(self, *, in_window: bool) -> bool:
        """Whether the plant allows the cell to change now."""

    async def note(self, note: GateNote, step: str, why: str, *, is_news: bool = True) -> GateNote:
        """Write down a step before it is taken."""

    async def judge(self, note: GateNote) -> GateNote:
        """Count the cycles since the last call, and decide."""


class SoftwareGate:
    """Gate for software releases; used on the event loop. running : the version of this process."""

    def __init__(
        self, cell: CellInUse, regressions: Regressions, recorded: RecordedJudgement, steps: GateSteps
    ) -> None:
        self._cell = cell
        self._regressions = regressions
        self._recorded = recorded
        self._steps = steps
        self.running = RUNNING

    async def next(self, note: GateNote) -> GateNote:
        """Take the next step. Raises `EdgedError`, `OSError`."""
        wanted, noted = note.staged.offer.name, self._steps.note
        match note.step:
            case "staged":
                return await self._try(note)
            case "waiting":
                return await self._begin(note) if self._steps.has_leave(in_window=True) else note
            case "activating" if self.running == wanted:
                since = (await asyncio.to_thread(self._recorded.before, {}))[0]
                return await noted(
                    note.model_copy(update={"since": since}), "probation", "the cell runs by it"
                )
            case "activating" | "probation" if why := await asyncio.to_thread(self._failed, note):
                return await noted(note, "refused" if note.step == "activating" else "rolled back", why)
            case "activating":
                return await self._order(note, note.order, back=False)
            case "probation" if self.running == wanted:
                return await self._steps.judge(note)
            case "rolling back" if self.running == wanted:
                return await self._go_back(note)
            case "rolling back" if self.running == note.before:
                return await noted(note, "rolled back", note.why)
        return await noted(note, "left", "somebody has changed the version meanwhile: it is theirs")

    # --- steps --------------------------------------------------------------------------------------

    async def _try(self, note: GateNote) -> GateNote:
        """Measure recorded cycles with the new version."""
        offer, jobs = note.staged.offer, {job.number for job in facts_of_jobs(self._cell.files.contents)}
        versions = self._versions()
        try:
            if versions.digest(offer.name) != note.staged.sha256:
                raise UserError(
                    f"{versions.folder}: {offer.name} is not installed: edged release pull, as root"
                )
            await asyncio.to_thread(_take_kernels, versions.folder / "versions" / offer.name / "kernels")
            begun = datetime.now(UTC)
            # both at the same time: a fast cell has other recordings a minute later
            before, after = await self._measured_by_both(versions.python(offer.name))
            if sum(line.get("shown", {}).get("status") == "OK" for line in before) < LEAST_GOOD:
                raise UserError(
                    f"fewer than {LEAST_GOOD} good recorded cycles: measure first, with [recorder]"
                )
            digest = digest_of(self._cell.files.contents)
            found = document_of(
                compare(tried(before, after), of_rig=False),
                identity=f"{begun:%Y%m%d-%H%M%S}-{begun.microsecond >> 4:04x}",
                at=begun,
                by=AUTHOR,
                what=TriedCandidate(kind="release", id=offer.name),
                against=self._cell.files.fingerprint,
                digests=(digest, digest),
                seconds=(datetime.now(UTC) - begun).total_seconds(),
            )
            await asyncio.to_thread(self._regressions.keep, found)
            if against := objection(found, offer.may_move_um / 1000):
                raise UserError(f"regression {found.id}: {against}")
        except (UserError, FileFormatError) as error:
            return await self._steps.note(note, "refused", str(error))
        note = note.model_copy(update={"jobs": tuple(sorted(jobs))})
        why = f"regression {found.id}: {found.counts.good_stay} good recorded cycles stay, by the new version"
        return await self._steps.note(note, "waiting", why)

    async def _begin(self, note: GateNote) -> GateNote:
        since, cycles = await asyncio.to_thread(self._recorded.before, {job: job for job in note.jobs})
        order = await asyncio.to_thread(self._number)
        known = {
            "before": self.running,
            "wanted": note.staged.offer.name,
            "since": since,
            "baseline": baseline_of(cycles, moves_marks=True),
            "order": order + 1,
        }
        note = await self._steps.note(note.model_copy(update=known), "activating", note.why)
        return await self._order(note, note.order, back=False)

    async def _go_back(self, note: GateNote) -> GateNote:
        order = await asyncio.to_thread(order_in, self._folder)
        if order is not None and order.number == note.order and not order.back:
            if not self._steps.has_leave(in_window=False):
                return note
            note = note.model_copy(update={"order": note.order + 1})
            note = await self._steps.note(note, "rolling back", note.why, is_news=False)
        return await self._order(note, note.order, back=True)

    async def _order(self, note: GateNote, number: int, *, back: bool) -> GateNote:
        """Order root to switch, unless it was ordered lately; only while changes are allowed."""
        if await asyncio.to_thread(self._is_fresh, number):
            return note
        if not self._steps.has_leave(in_window=not back):
            return note
        order = VersionOrder(number=number, to=note.before if back else note.wanted, back=back)
        await asyncio.to_thread(
            write_atomically, self._folder / ORDER, order.model_dump_json(indent=1).encode()
        )
        return note

    # --- files and processes ------------------------------------------------------------------------

    @property
    def _folder(self) -> Path:
        return self._cell.folder / FOLDER

    def _versions(self) -> Versions:
        section = self._cell.files.config.fleet
        if section is None or section.software is None:
            raise UserError("[fleet] software is missing: this cell takes no software")
        return Versions(section.software)

    def _is_fresh(self, number: int) -> bool:
        """Whether an order was written lately; one that root has missed is written again later."""
        if self._number() < number:
            return False
        return time.time() - (self._folder / ORDER).stat().st_mtime < AGAIN_S

    def _number(self) -> int:
        order = order_in(self._folder)
        return 0 if order is None else order.number

    def _failed(self, note: GateNote) -> str:
        """Why root went back on its own; "" if it did not."""
        switched = self._versions().switched()
        is_ours = switched is not None and switched.order.number == note.order and not switched.order.back
        return switched.why if switched is not None and is_ours and switched.state == "failed" else ""

    async def _measured_by_both(self, python: Path) -> tuple[list[Json], list[Json]]:
        """Measure the recorded cycles with this version and with another one. Raises `UserError`."""
        try:
            return await both(self._measured(PYTHON), self._measured(python), MOST_S)
        except TimeoutError as error:
            raise UserError(f"{python}: recorded cycles took longer than {MOST_S:g} s") from error

    async def _measured(self, python: Path) -> list[Json]:
        """Measure the recorded cycles with a version. Raises `UserError`."""
        # without PYTHON... variables: the page's environment belongs to the running version
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        process = await asyncio.create_subprocess_exec(
            "nice", str(python), "-P", "-m", MODULE, str(self._cell.path), str(LAST),
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            env=environment,
        )  # fmt: skip
        try:
            said, problem = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode:
            words = problem.decode(errors="replace").strip()[-500:]
            raise UserError(f"{python}: recorded cycles could not be measured: {words}")
        return _lines(said, python)


def _lines(said: bytes, python: Path) -> list[Json]:
    try:
        lines: list[Mapping[str, object]] = [json.loads(line) for line in said.splitlines()]
        for line in lines:
            _ = line["number"], line["at"], line["job"], line.get("shown") or line["detail"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{python}: speaks otherwise of recorded cycles: {error}") from error
    return [dict(line) for line in lines]


def _take_kernels(compiled: Path) -> None:
    """Copy the kernels that root has compiled into this process's cache, as the service does at its start."""
    cache = os.environ.get("NUMBA_CACHE_DIR", "")
    if cache and compiled.is_dir():
        shutil.copytree(compiled, cache, dirs_exist_ok=True)
