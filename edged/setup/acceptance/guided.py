"""Guided study of a size on the page: which person places which part, each measurement, and the verdict."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from edged.adapters.web.routes import Name
from edged.errors import SetupRefused, UserError
from edged.report.acceptance import ReportedTest
from edged.setup.acceptance.studies import LEAST_CROSSED, LEAST_REPEATS
from edged.setup.acceptance.studying import StudiedSize, by_master, by_parts, made_at, study_page
from edged.setup.calibration.checking import offered_lengths
from edged.setup.documents import Frozen, LastDocument, now_text
from edged.setup.inuse import CellInUse

MOST = 1000
"""Most measurements of a study."""
Millimetres = Annotated[float, Field(ge=0.001, le=100_000)]


class StudyPlan(Frozen, extra="forbid", strict=True, allow_inf_nan=False):
    """Plan of a study. reference_mm : known size of the only part; null if there are several."""

    job: Name
    size: Name
    low_mm: Millimetres
    high_mm: Millimetres
    reference_mm: Millimetres | None = None
    parts: Annotated[int, Field(ge=1, le=100)] = 1
    people: Annotated[int, Field(ge=1, le=100)] = 1
    trials: Annotated[int, Field(ge=1, le=100)]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        shape = self.parts, self.people, self.trials
        if not self.low_mm < self.high_mm:
            raise ValueError("expected the lower limit below the upper one")
        least = LEAST_CROSSED if self.reference_mm is None else (1, 1, LEAST_REPEATS)
        if any(count < wanted for count, wanted in zip(shape, least, strict=True)):
            raise ValueError("expected at least {} parts by {} people, {} times each".format(*least))
        if self.reference_mm is not None and shape[:2] != (1, 1):
            raise ValueError("expected one part by one person where its size is known")
        if self.count > MOST:
            raise ValueError(f"expected at most {MOST} measurements")
        return self

    @property
    def count(self) -> int:
        """Total number of measurements."""
        return self.parts * self.people * self.trials


class NextMeasurement(Frozen):
    """The next measurement: part, person and trial, all counted from 1."""

    part: int
    person: int
    trial: int


class KeptStudy(Frozen):
    """A study on disc. values : size and sigma, mm; in each trial each person in turn measures all parts.

    calibration, digest : of the rig and of the job's text, which must stay the same throughout.
    taken_back : number of discarded measurements.
    """

    plan: StudyPlan
    by: str
    at: str
    rig: str
    calibration: str
    number: int
    digest: str
    values: list[tuple[float, float]] = Field([])
    taken_back: int = 0


class StudyDocument(Frozen):
    """State of a study. plan : null if there is none. next : null if all is measured; then there are figures.

    is_current : the rig and the job are those that it began with. good : null for conditionally fit.
    """

    plan: StudyPlan | None = None
    needed: int = 0
    values_mm: list[float] = Field([])
    next: NextMeasurement | None = None
    is_current: bool = True
    good: bool | None = None
    figures: dict[str, str] = Field({})


@dataclass(frozen=True, slots=True)
class _Judged:
    good: bool | None
    test: ReportedTest
    values_mm: dict[str, list[float]]


class GuidedStudy:
    """The guided study of a cell; used on the event loop only. Measurements are on disc."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._file = cell.folder / "study.json"
        self._kept = LastDocument(self._file, KeptStudy, "the study of a size")
        self._turn = asyncio.Lock()

    async def document(self) -> StudyDocument:
        """State of the study."""
        kept = await asyncio.to_thread(self._kept.read)
        if kept is None:
            return StudyDocument()
        plan, done = kept.plan, len(kept.values)
        judged = _judged(kept) if done >= plan.count else None
        return StudyDocument(
            plan=plan,
            needed=plan.count,
            values_mm=[value for value, _ in kept.values],
            next=_next(plan, done) if judged is None else None,
            is_current=self._is_current(kept),
            good=None if judged is None else judged.good,
            figures={} if judged is None else dict(judged.test.figures),
        )

    def _is_current(self, kept: KeptStudy) -> bool:
        return (kept.calibration, kept.digest) == (self._cell.calibration_id, self._digest(kept.plan.job))

    def _digest(self, job: str) -> str:
        return next((line.digest for line in self._cell.job_lines().lines if line.name == job), "")

    async def begin(self, author: str, plan: StudyPlan) -> StudyDocument:
        """Begin a study. Raises `SetupRefused` while there is another, `UserError`."""
        async with self._turn:
            if await asyncio.to_thread(self._kept.read) is not None:
                raise SetupRefused("there is a study: end it before another begins")
            rig, job = self._cell.needed_rig("to study a size by"), self._cell.job(plan.job)
            sizes = [name for name, _ in offered_lengths(job)]
            if plan.size not in sizes:
                raise UserError(f"{plan.size}: the job {job.name} has {', '.join(sizes) or 'no size'}")
            begun = KeptStudy(
                plan=plan,
                by=author,
                at=now_text(),
                rig=rig.path.name,
                calibration=rig.calibration_id,
                number=job.number,
                digest=self._digest(job.name),
            )
            await asyncio.to_thread(self._kept.write, begun)
        return await self.document()

    async def measure(self, token: str, done: int) -> StudyDocument:
        """Measure once more. done : number of measurements that the caller sees, so that double clicks fail.

        Raises `SetupRefused`, `CaptureError`, and `UserError` unless exactly one good part is seen.
        """
        async with self._turn:
            kept = await self._at(done)
            if done >= kept.plan.count:
                raise SetupRefused("all is measured")
            if not self._is_current(kept):
                raise SetupRefused("the calibration or the job was changed since the study began")
            pair = await self._cell.session.capture(token)
            images, job = pair.images, self._cell.jobs()[kept.plan.job]
            value = await self._cell.worker.run(
                "measure_size", self._cell.needed_rig(), images, job, kept.plan.size
            )
            more = {"values": [*kept.values, value], "at": now_text()}
            await asyncio.to_thread(self._kept.write, kept.model_copy(update=more))
        return await self.document()

    async def back(self, done: int) -> StudyDocument:
        """Discard the last measurement, to repeat it. Raises `SetupRefused`."""
        async with self._turn:
            kept = await self._at(done)
            if not kept.values:
                raise SetupRefused("nothing is measured yet")
            less = {"values": kept.values[:-1], "taken_back": kept.taken_back + 1}
            await asyncio.to_thread(self._kept.write, kept.model_copy(update=less))
        return await self.document()

    async def end(self) -> StudyDocument:
        """Delete the study."""
        async with self._turn:
            await asyncio.to_thread(self._file.unlink, missing_ok=True)
        return await self.document()

    async def _at(self, done: int) -> KeptStudy:
        kept = await asyncio.to_thread(self._kept.read)
        if kept is None:
            raise SetupRefused("there is no study: begin one")
        if len(kept.values) != done:
            raise SetupRefused(f"{len(kept.values)} are measured, not {done}: look again")
        return kept

    async def report(self) -> bytes | None:
        """The report page to sign; None before all is measured."""
        kept = await asyncio.to_thread(self._kept.read)
        if kept is None or len(kept.values) < kept.plan.count:
            return None
        judged, plan = _judged(kept), kept.plan
        about = {
            "rig": f"{kept.rig}, calibration {kept.calibration}",
            "job": f"{kept.number} {plan.job}",
            "made": made_at(datetime.fromisoformat(kept.at)),
            "by": kept.by,
            "taken back and repeated": f"{kept.taken_back}",
        }
        return study_page(judged.good, _size(plan), about, [judged.test], judged.values_mm)


def _size(plan: StudyPlan) -> StudiedSize:
    return StudiedSize(plan.size, plan.low_mm, plan.high_mm)


def _next(plan: StudyPlan, done: int) -> NextMeasurement:
    before, part = divmod(done, plan.parts)
    trial, person = divmod(before, plan.people)
    return NextMeasurement(part=part + 1, person=person + 1, trial=trial + 1)


def _judged(kept: KeptStudy) -> _Judged:
    """Judge a study with the same code as `edged study`."""
    plan, sizes = kept.plan, kept.values[: kept.plan.count]
    values = [value for value, _ in sizes]
    if plan.reference_mm is not None:
        master, _, test = by_master(sizes, plan.reference_mm, _size(plan))
        return _Judged(master.good, test, {"master": values})
    crossed = np.array(values).reshape(plan.trials, plan.people, plan.parts).transpose(2, 1, 0)
    gauge, test = by_parts(crossed, _size(plan))
    rows = {
        f"part {part + 1}, person {person + 1}": crossed[part, person].tolist()
        for part in range(plan.parts)
        for person in range(plan.people)
    }
    return _Judged(gauge.good, test, rows)
