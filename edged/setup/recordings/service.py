"""Recorded cycles of a running cell: listed, shown feature by feature, and measured again with changes.

The disc is read in a separate thread, and all measuring is done in the worker process.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TypeVar

from edged.domain.arrays import Side
from edged.errors import FileFormatError
from edged.files import recording
from edged.files.images import load_image
from edged.pictures.encoding import jpeg
from edged.setup.documents import Frozen, Message, PicturePaths
from edged.setup.inuse import CellInUse
from edged.setup.recordings.recorded import CycleFilter, CycleLine, CycleList, Damaged, Records
from edged.setup.recordings.recordedparts import PartSight, parts_of, taught_part
from edged.setup.recordings.setups import facts_of_jobs, job_of_cycle, rig_and_job, setup_of
from edged.setup.recordings.whatif import Change, WhatIf
from edged.setup.teaching.drafts import TAUGHT
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job

FUNCTIONS = {"what_if": "edged.setup.recordings.work:what_if"}
PLACE = "/api/v1/cycles"
JPEG_QUALITY = 90
"""Quality high enough to see edges of single pixels."""
T = TypeVar("T")


class PairView(Frozen):
    """A pair with the parts seen in it, all in raw px.

    kind : "now"; "taught", as the part lay at teaching; "good", another cycle that was good. number, at : of
    the recording. pictures : null if none are kept.
    """

    kind: str
    number: int | None = None
    at: str | None = None
    width: int
    height: int
    pictures: PicturePaths | None
    parts: list[PartSight]


class RecordedLimits(Frozen):
    """Limits of a cycle's job at that time; `contrast` and `min_score` are of its search."""

    max_sigma_mm: float
    max_rms_px: float
    min_support: float
    max_epipolar_px: float
    radius_tolerance_mm: float | None
    form_tolerance_mm: float | None
    min_score: float
    depth_mm: list[float]
    contrast: float


class CycleDocument(CycleLine):
    """A recorded cycle with its features. folder : of its job in the cell; null if there is no such job now.

    trouble : why there are no features: "setup" if its rig or job is missing or damaged, "snapshot" if its
    own text is damaged. beside : the newest good cycle of the job, if there is one.
    """

    trouble: str | None = None
    trouble_text: Message = ""
    reference: str = ""
    folder: str | None = None
    limits: RecordedLimits | None = None
    now: PairView | None = None
    taught: PairView | None = None
    beside: PairView | None = None


class Cycles:
    """Recorded cycles of a cell; used on the event loop only."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._disc = ThreadPoolExecutor(1, thread_name_prefix="cycles")
        # used in that thread only
        self._records: Records | None = None

    async def listed(self, wanted: CycleFilter) -> CycleList:
        """List the recordings that match a filter."""
        return await self._on_disc(self._listed)(wanted)

    async def document(self, number: int) -> CycleDocument:
        """A recording with its features. Raises `KeyError`, `FileFormatError`."""
        return await self._on_disc(self._document)(number)

    async def picture(self, number: int, side: Side, width_px: int | None = None) -> bytes:
        """A picture of a recording as JPEG, at most this wide. Raises `KeyError`, `FileFormatError`."""
        return await self._on_disc(self._picture)(number, side, width_px)

    async def taught_picture(self, number: int, side: Side) -> bytes:
        """A picture of the pair that the job of a cycle was taught from. Raises as `picture`."""
        return await self._on_disc(self._taught_picture)(number, side)

    async def what_if(self, number: int, change: Change | None) -> WhatIf:
        """Measure a recording with a change, or find what would have helped.

        Raises `KeyError`, `UserError`, `TaskFailed`.
        """
        file = await self.file(number)
        found: WhatIf = await self._cell.worker.run("what_if", file, change)
        return found

    async def file(self, number: int) -> Path:
        """File of a recording. Raises `KeyError`."""
        return await self._on_disc(lambda: self._known().entry(number).path)()

    async def close(self) -> None:
        """Stop the disc's thread."""
        await asyncio.to_thread(self._disc.shutdown, wait=True, cancel_futures=True)

    # --- in the disc's thread ----------------------------------------------------------------

    def _on_disc(self, work: Callable[..., T]) -> Callable[..., asyncio.Future[T]]:
        def begin(*arguments: object) -> asyncio.Future[T]:
            return asyncio.get_running_loop().run_in_executor(self._disc, partial(work, *arguments))

        return begin

    def _known(self) -> Records:
        """Recordings in the folder that is used now. Raises `KeyError` if the cell records nothing."""
        folder = self._cell.recordings
        if folder is None:
            raise KeyError("the cell records nothing")
        if self._records is None or self._records.folder != folder:
            self._records = Records(folder)
        return self._records

    def _folder_of(self, name: str, number: int, digest: str | None) -> tuple[str | None, bool]:
        """Folder of a recorded cycle's job, and whether that job still measures as it did then."""
        job = job_of_cycle(facts_of_jobs(self._cell.files.contents), name, number)
        return (None, False) if job is None else (job.folder, job.digest == digest)

    def _listed(self, wanted: CycleFilter) -> CycleList:
        try:
            return self._known().page(wanted)
        except KeyError:
            return CycleList(recorder=False, cycles=[], damaged=[], counts={}, has_more=False)

    def _document(self, number: int) -> CycleDocument:
        records = self._known()
        entry = records.entry(number)
        line = records.line(entry)
        if isinstance(line, Damaged):
            raise FileFormatError(line.why)
        facts = line.model_dump()
        snapshot, _ = recording.load_snapshot(entry.path)
        try:
            prepared, job = rig_and_job(entry.path, snapshot)
            digest = setup_of(entry.path, snapshot).job_digests[job.number]
            folder, is_same = self._folder_of(line.job, line.job_number, digest)
        except FileFormatError as error:
            return CycleDocument(**facts, trouble="setup", trouble_text=str(error))
        rig = prepared.rig
        try:
            parts = parts_of(snapshot, rig, job, str(entry.path))
        except FileFormatError as error:
            return CycleDocument(**facts, trouble="snapshot", trouble_text=str(error))
        return CycleDocument(
            **facts,
            reference=job.reference,
            folder=folder,
            limits=_limits(job),
            now=_pair_view("now", rig, _pictures(line), parts, line),
            taught=_pair_view(
                "taught", rig, self._of_teaching(line, folder, is_same), [taught_part(rig, job)]
            ),
            beside=self._beside(records, line, job),
        )

    def _beside(self, records: Records, line: CycleLine, job: Job) -> PairView | None:
        """A good cycle for comparison, with the features of its own job, which may be an older version."""
        entry = records.newest_good(job.number, line.calibration, line.number)
        good = None if entry is None else records.line(entry)
        if entry is None or not isinstance(good, CycleLine):
            return None
        try:
            snapshot, _ = recording.load_snapshot(entry.path)
            rig, its_job = rig_and_job(entry.path, snapshot)
            parts = parts_of(snapshot, rig.rig, its_job, str(entry.path))
            return _pair_view("good", rig.rig, _pictures(good), parts, good)
        except FileFormatError:
            return None

    def _of_teaching(self, line: CycleLine, folder: str | None, is_same: bool) -> PicturePaths | None:
        """Pictures of the pair that the job was taught from; None if it was taught again since."""
        if folder is None or not is_same or not self._taught_file(folder, "left").is_file():
            return None
        return PicturePaths.below(f"{PLACE}/{line.number}/taught")

    def _taught_file(self, folder: str, side: Side) -> Path:
        return self._cell.files.config.cell.jobs / folder / TAUGHT / f"{side}.png"

    def _picture(self, number: int, side: Side, width_px: int | None) -> bytes:
        image = recording.load_picture(self._known().entry(number).path, side)
        return jpeg(image, JPEG_QUALITY, width_px)

    def _taught_picture(self, number: int, side: Side) -> bytes:
        line, folder = self._known().line(self._known().entry(number)), None
        if not isinstance(line, Damaged):
            folder, _ = self._folder_of(line.job, line.job_number, None)
        if folder is None or not self._taught_file(folder, side).is_file():
            raise KeyError(number)
        return jpeg(load_image(self._taught_file(folder, side)), JPEG_QUALITY)


def _limits(job: Job) -> RecordedLimits:
    limits = asdict(job.limits)
    return RecordedLimits(
        **{**limits, "depth_mm": list(job.limits.depth_mm)},
        min_score=job.search.min_score,
        contrast=job.search.min_contrast,
    )


def _pictures(line: CycleLine) -> PicturePaths | None:
    return PicturePaths.below(f"{PLACE}/{line.number}") if line.has_pictures else None


def _pair_view(
    kind: str,
    rig: StereoRig,
    pictures: PicturePaths | None,
    parts: list[PartSight],
    line: CycleLine | None = None,
) -> PairView:
    return PairView(
        kind=kind,
        number=None if line is None else line.number,
        at=None if line is None else line.at,
        width=rig.left.width,
        height=rig.left.height,
        pictures=pictures,
        parts=parts,
    )
