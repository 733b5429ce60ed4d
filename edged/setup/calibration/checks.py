"""Does the rig in use still hold? One fresh pair, judged in the worker process; the last verdict is kept."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edged.cell.lease.notices import Notices
from edged.domain.frames import FramePair
from edged.errors import SetupRefused, UserError
from edged.files.atomic import make_folders, write_atomically
from edged.setup.calibration.checking import Finding, Limits, offered_lengths
from edged.setup.inuse import RigInUse
from edged.setup.jobs.worker import Worker
from edged.vision.boards.board import NominalBoard
from edged.vision.calibration.verification import COVERAGE, Verdict
from edged.vision.part.job import Job

log = logging.getLogger(__name__)

LIMITS = Limits(epipolar_px=0.3, length_percent=0.1)
"""As `edged verify` judges, where nothing else is stated."""


class Rows(BaseModel):
    """How far apart the same mark lies in both pictures across the rows, rms."""

    model_config = ConfigDict(frozen=True)
    measured_px: float
    limit_px: float
    verdict: Verdict


class CheckedLength(BaseModel):
    """A known length. spread_percent : to either side, 95 %, from the noise of this pair."""

    model_config = ConfigDict(frozen=True)
    name: str
    true_mm: float
    measured_mm: float
    error_mm: float
    error_percent: float
    spread_percent: float
    limit_percent: float
    verdict: Verdict


class CheckDocument(BaseModel):
    """A verdict. reason : why there are no figures, in English; remarks : of the cameras, likewise.

    calibration : id of the rig that was judged. board, job : by which; one of them is null.
    """

    model_config = ConfigDict(frozen=True)
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


class OfferedLength(BaseModel):
    """What a part may be measured by. taught_mm : as the job has it; null: not known."""

    model_config = ConfigDict(frozen=True)
    name: str
    taught_mm: float | None


class OfferedPart(BaseModel):
    """A part, by the name of its job."""

    model_config = ConfigDict(frozen=True)
    job: str
    lengths: list[OfferedLength]


class Checked(BaseModel):
    """The last check. is_current : it judged the rig that is in use. boards, parts : to check with."""

    model_config = ConfigDict(frozen=True)
    last: CheckDocument | None
    is_current: bool
    boards: list[str] = Field(description="of the last check, and of the calibration in use, as far as known")
    parts: list[OfferedPart]


class Checks:
    """Used on the event loop only.

    kept : file of the last verdict. capture : an exposure, for the token of who has the cell.
    rig : the one in use; None without. jobs : by name.
    """

    def __init__(
        self,
        kept: Path,
        worker: Worker,
        notices: Notices,
        capture: Callable[[str], Awaitable[FramePair]],
        rig: Callable[[], RigInUse | None],
        jobs: Callable[[], Mapping[str, Job]],
    ) -> None:
        self._kept = kept
        self._worker = worker
        self._notices = notices
        self._capture = capture
        self._rig = rig
        self._jobs = jobs

    async def by_board(self, token: str, author: str, board: NominalBoard) -> CheckDocument:
        """Take a pair of a board. Raises `SetupRefused`, `CaptureError`, `ImageError`, `OSError`."""
        rig, pair = await self._seen(token)
        images = pair.left.image, pair.right.image
        finding = await self._worker.run("check_board", rig.content, rig.path, images, board, LIMITS)
        return await self._keep(_document(finding, author, rig, board=str(board)))

    async def by_part(
        self, token: str, author: str, name: str, known_mm: Mapping[str, float]
    ) -> CheckDocument:
        """Take a pair of a part, whose lengths are known by the names of a job. Raises also `UserError`."""
        job = self._jobs().get(name)
        if job is None:
            raise UserError(f"there is no job {name}")
        rig, pair = await self._seen(token)
        images = pair.left.image, pair.right.image
        finding = await self._worker.run("check_part", rig.content, rig.path, images, job, known_mm, LIMITS)
        return await self._keep(_document(finding, author, rig, job=name))

    async def last(self) -> Checked:
        """What is known."""
        last, rig = await asyncio.to_thread(self._read), self._rig()
        is_current = last is not None and rig is not None and last.calibration == rig.calibration_id
        boards = [] if last is None or last.board is None else [last.board]
        boards += [] if rig is None else rig.boards
        parts = [_offered(job) for job in self._jobs().values()]
        return Checked(last=last, is_current=is_current, boards=list(dict.fromkeys(boards)), parts=parts)

    async def _seen(self, token: str) -> tuple[RigInUse, FramePair]:
        rig = self._rig()
        if rig is None:
            raise SetupRefused("there is no calibration to check: calibrate first")
        return rig, await self._capture(token)

    async def _keep(self, document: CheckDocument) -> CheckDocument:
        await asyncio.to_thread(self._write, document)
        self._notices.publish("check", {"id": "last", **(await self.last()).model_dump(mode="json")})
        return document

    def _write(self, document: CheckDocument) -> None:
        make_folders(self._kept.parent)
        write_atomically(self._kept, document.model_dump_json(indent=1).encode())

    def _read(self) -> CheckDocument | None:
        try:
            return CheckDocument.model_validate_json(self._kept.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as error:
            log.warning("the last check cannot be read, as if there were none: %s", error)
            return None


def _offered(job: Job) -> OfferedPart:
    lengths = [OfferedLength(name=name, taught_mm=taught_mm) for name, taught_mm in offered_lengths(job)]
    return OfferedPart(job=job.name, lengths=lengths)


def _document(
    finding: Finding, author: str, rig: RigInUse, *, board: str | None = None, job: str | None = None
) -> CheckDocument:
    rows = None
    if math.isfinite(finding.epipolar_rms_px):
        agree = finding.epipolar_rms_px <= LIMITS.epipolar_px
        rows = Rows(
            measured_px=finding.epipolar_rms_px,
            limit_px=LIMITS.epipolar_px,
            verdict="OK" if agree else "NOT_OK",
        )
    return CheckDocument(
        at=datetime.now(UTC).isoformat(timespec="seconds"),
        by=author,
        calibration=rig.calibration_id,
        board=board,
        job=job,
        verdict=finding.verdict,
        reason=finding.reason,
        rows=rows,
        lengths=[
            CheckedLength(
                name=length.name,
                true_mm=length.true_mm,
                measured_mm=length.measured_mm,
                error_mm=length.error_mm,
                error_percent=length.error_percent,
                spread_percent=COVERAGE * 100 * length.sigma_mm / length.true_mm,
                limit_percent=LIMITS.length_percent,
                verdict=length.verdict(LIMITS.length_percent),
            )
            for length in finding.lengths
        ],
        remarks=[remark.text for remark in finding.cameras if remark.remedy],
    )
