"""Judges releases by recorded cycles: before they become active, and in their probation."""

from __future__ import annotations

import math
from collections.abc import Mapping

from edged.errors import UserError
from edged.setup.fleet.offers import Figure, GateNote
from edged.setup.fleet.probation import LAST, JudgedCycle
from edged.setup.inuse import CellInUse
from edged.setup.recordings.recorded import CAPTURE, CycleLine, Records
from edged.setup.recordings.regressiondocuments import ChangedCycle, RegressionDocument
from edged.setup.recordings.setups import Contents, facts_of_jobs

LEAST_GOOD = 5
"""Good recordings that each changed job must have, or it is not known whether it still measures as before."""
TURNED_DEG = 1.0
"""Limit on rotations, even for a release that may move results: larger ones make a gripper miss."""


class RecordedJudgement:
    """Recordings of a cell, as its gate evaluates them."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._records: Records | None = None

    def forget(self) -> None:
        """Drop the cache, so that all is read again next time."""
        self._records = None

    def lines(self) -> list[CycleLine]:
        """Recorded cycles that show how the jobs perform, newest first."""
        folder = self._cell.recordings
        if folder is None:
            return []
        if self._records is None or self._records.folder != folder:
            self._records = Records(folder)
        lines = map(self._records.line, self._records.entries())
        return [
            line
            for line in lines
            if isinstance(line, CycleLine) and line.kind != "GRAB" and line.reasons != (CAPTURE,)
        ]

    def check(self, active: Contents, changed: Mapping[int, int]) -> None:
        """Check the changed jobs. Raises `UserError` for one with too few good recordings."""
        good = [line.job_number for line in self.lines() if line.status == "OK" and line.has_pictures]
        for job in facts_of_jobs(active):
            if job.number in changed and good.count(job.number) < LEAST_GOOD:
                raise UserError(
                    f"job {job.name}: good recorded cycles: {good.count(job.number)}, expected {LEAST_GOOD}: "
                    "measure with it first, with [recorder] in the configuration"
                )

    def before(self, changed: Mapping[int, int]) -> tuple[int, list[JudgedCycle]]:
        """Index of the newest recording, and the last cycles of the jobs that change."""
        lines = self.lines()
        found = [line for line in lines if line.job_number in changed][:LAST]
        return max((line.number for line in lines), default=-1), [
            _judged(line, changed[line.job_number]) for line in reversed(found)
        ]

    def since(self, note: GateNote) -> tuple[int, list[JudgedCycle]]:
        """Index of the newest recording, and cycles not counted yet; for software, of any fingerprint."""
        lines, is_software = self.lines(), note.staged.offer.kind == "software"
        return max((line.number for line in lines), default=note.since), [
            _judged(line, line.job_number)
            for line in reversed(lines)
            if line.number > note.since
            and (is_software or line.fingerprint == note.wanted)
            and line.job_number in note.jobs
        ]


def objection(found: RegressionDocument, may_move_mm: float) -> str:
    """Objection to a release from its regression; "" for none."""
    counts = found.counts
    if counts.good_to_bad:
        cycle = found.good_to_bad[0]
        return f"{counts.good_to_bad} good recorded cycles become bad, as cycle {cycle.number}: {cycle.after}"
    if counts.lost:
        return f"{counts.lost} good parts of recorded cycles are not found any more"
    moved = [cycle for cycle in found.apart if _moves(cycle, may_move_mm)]
    if moved:
        worst = max(moved, key=lambda cycle: (cycle.turned_deg or 0.0, _moved_mm(cycle)))
        turned = "" if worst.turned_deg is None else f", turned by {worst.turned_deg:.1f}°"
        return (
            f"{len(moved)} good recorded cycles come out elsewhere, as cycle {worst.number}: by "
            f"{_moved_mm(worst):.3f} mm{turned}; the release may move results by {may_move_mm:g} mm"
        )
    return "" if counts.good_stay else "no good recorded cycle could be measured with it"


def _moves(cycle: ChangedCycle, may_move_mm: float) -> bool:
    return may_move_mm == 0 or _moved_mm(cycle) > may_move_mm or (cycle.turned_deg or 0.0) > TURNED_DEG


def _moved_mm(cycle: ChangedCycle) -> float:
    return math.hypot(*(cycle.apart_um or [0.0])) / 1000


def _judged(line: CycleLine, job: int) -> JudgedCycle:
    if line.status != "OK":
        return JudgedCycle(job, False)
    known: dict[Figure, float | None] = {
        "sigma": line.sigma_um,
        "rows": line.rows_px,
        "time": line.total_ms,
        "left": line.left_mm,
        "right": line.right_mm,
    }
    return JudgedCycle(job, True, {name: value for name, value in known.items() if value is not None})
