"""List of recorded cycles: newest first, filtered by status, job and reason; damaged ones are named.

Files of recordings never change: each is read once, without its pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edged.domain.events import CommandKind
from edged.domain.measurement import Reject, Status
from edged.domain.numerals import number_in
from edged.errors import FileFormatError
from edged.files import recording
from edged.payload import Json
from edged.setup.documents import Frozen

MOST = 200
"""Most recordings in one answer."""
NOT_FOUND, CAPTURE = "NOT_FOUND", "CAPTURE"
"""Reasons besides the names of `Reject`: nothing looked like the part; the cameras gave no pair."""
REASONS = (*(str(bit.name) for bit in Reject), NOT_FOUND, CAPTURE)


class CycleLine(Frozen):
    """A recorded cycle. reasons : from `REASONS`; empty for a good one.

    number : of the recording; `cycle` counts from each start of the cell. kind : of its command, or "".
    parts : number of good ones. sigma_um : of the first good part, the largest of X, Y, Z. rows_px : its
    epipolar rms. left_mm, right_mm : shift of each camera since teaching, by the reference marks. None where
    not known.
    """

    number: int
    at: str
    status: str
    cycle: int
    kind: str
    job: str
    job_number: int
    calibration: str
    fingerprint: str
    reasons: tuple[str, ...]
    parts: int
    sigma_um: float | None
    rows_px: float | None
    total_ms: float | None
    left_mm: float | None
    right_mm: float | None
    error: str
    has_pictures: bool


class Damaged(Frozen):
    """A recording that cannot be read, and why."""

    file: str
    why: str


class CycleList(Frozen):
    """Cycles, newest first. recorder : the cell records at all. counts : of all recordings, by status.

    damaged : unreadable ones among those read for this answer. has_more : there are older ones, see `before`.
    """

    recorder: bool
    cycles: list[CycleLine]
    damaged: list[Damaged]
    counts: dict[str, int]
    has_more: bool


@dataclass(frozen=True, slots=True)
class CycleFilter:
    """Conditions of a list; None for any. before : only recordings with a smaller number."""

    status: str | None = None
    reason: str | None = None
    job: str | None = None
    before: int | None = None
    most: int = 50


class Records:
    """Recordings in a folder; calls block while the disc is read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, CycleLine | Damaged] = {}

    def entries(self) -> list[recording.Entry]:
        """All recordings by their file names, newest first."""
        return recording.entries(self.folder)[::-1]

    def entry(self, number: int) -> recording.Entry:
        """Find a recording by its number. Raises `KeyError` if there is none."""
        found = recording.find(self.folder, number)
        if found is None:
            raise KeyError(number)
        return found

    def page(self, wanted: CycleFilter) -> CycleList:
        """One page of the list."""
        entries = self.entries()
        names = {entry.path.name for entry in entries}
        for gone in [name for name in self._known if name not in names]:
            self._known.pop(gone, None)
        counts: dict[str, int] = {}
        for entry in entries:
            counts[entry.status] = counts.get(entry.status, 0) + 1
        lines: list[CycleLine] = []
        damaged: list[Damaged] = []
        has_more = False
        for found in self._found(entries, wanted):
            if isinstance(found, Damaged):
                damaged.append(found)
                continue
            if has_more := len(lines) == wanted.most:
                break
            lines.append(found)
        return CycleList(recorder=True, cycles=lines, damaged=damaged, counts=counts, has_more=has_more)

    def newest_good(self, job_number: int, calibration: str, but: int) -> recording.Entry | None:
        """Newest good cycle of a job, for comparison; one with the given calibration if possible."""
        other = None
        for entry in self.entries():
            if entry.status != Status.OK or entry.index == but:
                continue
            line = self.line(entry)
            if isinstance(line, Damaged) or line.job_number != job_number or not line.parts:
                continue
            if line.calibration == calibration:
                return entry
            other = other or entry
        return other

    def line(self, entry: recording.Entry) -> CycleLine | Damaged:
        """Summary of a recording; cached."""
        name = entry.path.name
        known = self._known.get(name)
        if known is None:
            try:
                known = _line(entry, *recording.load_snapshot(entry.path))
            except FileFormatError as error:
                known = Damaged(file=name, why=str(error))
            self._known[name] = known
        return known

    def _found(
        self, entries: Sequence[recording.Entry], wanted: CycleFilter
    ) -> Iterator[CycleLine | Damaged]:
        for entry in entries:
            if wanted.before is not None and entry.index >= wanted.before:
                continue
            if wanted.status is not None and entry.status != wanted.status:
                continue
            line = self.line(entry)
            if isinstance(line, CycleLine):
                if wanted.reason is not None and wanted.reason not in line.reasons:
                    continue
                if wanted.job is not None and wanted.job != line.job:
                    continue
            yield line


def reasons_of(snapshot: Json) -> tuple[str, ...]:
    """Why a recorded cycle is not good, in the order of `REASONS`."""
    status, command = snapshot.get("status"), snapshot.get("command")
    if status == Status.OK or (isinstance(command, dict) and command.get("kind") == CommandKind.GRAB.name):
        return ()
    if status == Status.CAPTURE_FAULT:
        return (CAPTURE,)
    lists = [item.get("reject") for key in ("rejected", "dismissed") for item in _objects(snapshot, key)]
    given = [name for names in lists if isinstance(names, list) for name in names]
    return tuple(name for name in REASONS if name in given) or (NOT_FOUND,)


def _line(entry: recording.Entry, snapshot: Json, has_pictures: bool) -> CycleLine:
    targets, command = _objects(snapshot, "targets"), snapshot.get("command")
    kind = command.get("kind", "") if isinstance(command, dict) else ""
    return CycleLine(
        number=entry.index,
        at=entry.recorded.isoformat(timespec="milliseconds"),
        status=entry.status,
        cycle=snapshot["cycle"],
        kind=str(kind)[:40],
        job=snapshot["job"][:200],
        job_number=snapshot["job_number"],
        calibration=str(snapshot.get("calibration", ""))[:200],
        fingerprint=str(snapshot.get("fingerprint", ""))[:64],
        reasons=reasons_of(snapshot),
        parts=len(targets),
        sigma_um=_worst_um(targets[0]) if targets else None,
        rows_px=_number(targets[0], "epipolar_rms_px") if targets else None,
        total_ms=_number(snapshot.get("timing_ms"), "total"),
        left_mm=_number(snapshot.get("marks"), "left_mm"),
        right_mm=_number(snapshot.get("marks"), "right_mm"),
        error=str(snapshot.get("error", ""))[:500],
        has_pictures=has_pictures,
    )


def _worst_um(target: Json) -> float | None:
    sigmas = target.get("sigma_mm")
    numbers = (
        [sigma for sigma in sigmas if isinstance(sigma, int | float)] if isinstance(sigmas, list) else []
    )
    return round(1e3 * max(numbers), 2) if numbers else None


def _number(table: object, key: str) -> float | None:
    """Number in a table; None if there is no table or no number."""
    return number_in(table.get(key)) if isinstance(table, dict) else None


def _objects(snapshot: Json, key: str) -> list[dict[str, Any]]:
    """List of the objects under a key; empty if there is no list."""
    value = snapshot.get(key)
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []
