"""Checks of the rig in use by one fresh pair, judged in the worker process; the last verdict is kept."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from pydantic import Field

from edged.setup.calibration.checking import Finding, Limits, offered_lengths
from edged.setup.documents import Frozen, LastDocument, now_text
from edged.setup.inuse import CellInUse, RigInUse
from edged.vision.boards.board import NominalBoard
from edged.vision.calibration.verification import COVERAGE, Length, Verdict
from edged.vision.part.job import Job

LIMITS = Limits(epipolar_px=0.3, length_percent=0.1)
"""The default limits of `edged verify`."""


class Rows(Frozen):
    """Epipolar error: rms distance across the rows between the same mark in both pictures."""

    measured_px: float
    limit_px: float
    verdict: Verdict


class CheckedLength(Frozen):
    """A checked length. spread_percent : half-width of the 95 % interval from the noise of this pair."""

    name: str
    true_mm: float
    measured_mm: float
    error_mm: float
    error_percent: float
    spread_percent: float
    limit_percent: float
    verdict: Verdict


class CheckDocument(Frozen):
    """A verdict. reason : why there are no figures, in English. remarks : on the cameras, in English.

    calibration : id of the rig that was checked. board, job : used for the check; one of them is null.
    """

    at: str
    by: str
    calibration: str
    board: str | None
    job: str | None
    verdict: Verdict
    reason: str
    rows: Rows | None
    lengths: list[CheckedLength]
    remarks: list[str]


class OfferedLength(Frozen):
    """A length of a part that can be checked. taught_mm : its value in the job, null if not known."""

    name: str
    taught_mm: float | None


class OfferedPart(Frozen):
    """A part, by the name of its job."""

    job: str
    lengths: list[OfferedLength]


class Checked(Frozen):
    """The last check. is_current : it was of the rig in use. boards, parts : available for another check."""

    last: CheckDocument | None
    is_current: bool
    boards: list[str] = Field(description="of the last check, and of the calibration in use, as far as known")
    parts: list[OfferedPart]


class Checks:
    """Checks of the rig in use; used on the event loop only. The last verdict is kept on disc."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._kept = LastDocument(cell.folder / "check.json", CheckDocument, "the last check")

    async def by_board(self, token: str, author: str, board: NominalBoard) -> CheckDocument:
        """Check by a pair of a board. Raises `SetupRefused`, `CaptureError`, `ImageError`, `OSError`."""
        return await self._check(token, author, "check_board", board, board=str(board))

    async def by_part(
        self, token: str, author: str, name: str, known_mm: Mapping[str, float]
    ) -> CheckDocument:
        """Check by a pair of a part. known_mm : true lengths by name in the job. Raises also `UserError`."""
        return await self._check(token, author, "check_part", self._cell.job(name), known_mm, job=name)

    async def _check(
        self, token: str, author: str, function: str, *what: object, **named: str
    ) -> CheckDocument:
        rig = self._cell.needed_rig("to check")
        pair = await self._cell.session.capture(token)
        images = pair.images
        finding = await self._cell.worker.run(function, rig, images, *what, LIMITS)
        document = _document(finding, author, rig, **named)
        await asyncio.to_thread(self._kept.write, document)
        last = (await self.last()).model_dump(mode="json")
        self._cell.notices.publish("check", {"id": "last", **last})
        return document

    async def last(self) -> Checked:
        """The last verdict, and the boards and parts available for another check."""
        last, rig = await asyncio.to_thread(self._kept.read), self._cell.rig()
        is_current = last is not None and rig is not None and last.calibration == rig.calibration_id
        checked_by = [last.board] if last is not None and last.board is not None else []
        made_by = [] if rig is None else rig.boards
        boards = [*checked_by, *made_by] if is_current else [*made_by, *checked_by]
        parts = [_offered(job) for job in self._cell.jobs().values()]
        return Checked(last=last, is_current=is_current, boards=list(dict.fromkeys(boards)), parts=parts)


def _offered(job: Job) -> OfferedPart:
    lengths = [OfferedLength(name=name, taught_mm=taught_mm) for name, taught_mm in offered_lengths(job)]
    return OfferedPart(job=job.name, lengths=lengths)


def _document(
    finding: Finding, author: str, rig: RigInUse, *, board: str | None = None, job: str | None = None
) -> CheckDocument:
    rows = None
    if math.isfinite(px := finding.epipolar_rms_px):
        limit_px = LIMITS.epipolar_px
        rows = Rows(measured_px=px, limit_px=limit_px, verdict="OK" if px <= limit_px else "NOT_OK")
    return CheckDocument(
        at=now_text(),
        by=author,
        calibration=rig.calibration_id,
        board=board,
        job=job,
        verdict=finding.verdict,
        reason=finding.reason,
        rows=rows,
        lengths=[_checked(length) for length in finding.lengths],
        remarks=[remark.text for remark in finding.cameras if remark.remedy],
    )


def _checked(length: Length) -> CheckedLength:
    return CheckedLength(
        name=length.name,
        true_mm=length.true_mm,
        measured_mm=length.measured_mm,
        error_mm=length.error_mm,
        error_percent=length.error_percent,
        spread_percent=COVERAGE * 100 * length.sigma_mm / length.true_mm,
        limit_percent=LIMITS.length_percent,
        verdict=length.verdict(LIMITS.length_percent),
    )
