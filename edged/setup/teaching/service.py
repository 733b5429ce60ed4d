"""Drafts of jobs in a running cell: a pair is kept, people say what of it is the part, the worker learns it.

What people say is on disc before it is answered; what it comes to is told when the worker has looked.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

from pydantic import JsonValue

from edged.cell.lease.notices import Notices
from edged.domain.frames import FramePair
from edged.errors import EdgedError, FileFormatError, SetupRefused, TaskFailed, TaskTooLarge, TeachError
from edged.files.jobs import SHAPE, TEXT, job_files, read_job
from edged.files.rig import rig_of
from edged.setup.inuse import RigInUse
from edged.setup.jobs.tasks import Tasks
from edged.setup.jobs.worker import Worker
from edged.setup.pairs import Progress
from edged.setup.releases.jobsinuse import Candidate, JobsInUse
from edged.setup.teaching.documents import (
    Stale,
    TeachingDocument,
    TeachingLine,
    TeachingList,
    teaching_document,
)
from edged.setup.teaching.drafts import TeachingDraft, TeachingDrafts
from edged.setup.teaching.editing import edited
from edged.setup.teaching.former import FormerFiles
from edged.setup.teaching.model import (
    Drawing,
    Shape,
    TeachState,
    nearest,
)
from edged.setup.teaching.proposing import Order, Seen
from edged.setup.teaching.sources import Sources
from edged.setup.teaching.wishes import (
    Drawn,
    Grip,
    Tapped,
    WantedSize,
    check_region,
    kept,
    kept_grip,
    kept_size,
    polygon,
    tapped_feature,
)
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job

FUNCTIONS = {
    name: f"edged.setup.teaching.work:{name}"
    for name in ("propose_region", "regions_at", "read_drawing", "see_part")
}
PLACE = "/api/v1/teachings"


@dataclass(eq=False, slots=True)
class _Open:
    """A draft that is worked on. seen : what `seen_of` teaches; trouble : why that is nothing."""

    draft: TeachingDraft
    seen: Seen | None = None
    seen_of: tuple[object, ...] = ()
    trouble: EdgedError | None = None
    task: str | None = None
    ended: asyncio.Event = field(default_factory=asyncio.Event)
    changing: asyncio.Lock = field(default_factory=asyncio.Lock)


class Teachings:
    """All drafts of jobs of a cell; used on its event loop.

    capture : an exposure, for the token of who has the cell.  rig, jobs : those in use.
    recorded : the file of a recorded cycle; raises `KeyError`.
    """

    def __init__(
        self,
        folder: Path,
        worker: Worker,
        tasks: Tasks,
        notices: Notices,
        capture: Callable[[str], Awaitable[FramePair]],
        rig: Callable[[], RigInUse | None],
        jobs: Callable[[], JobsInUse],
        recorded: Callable[[int], Awaitable[Path]],
    ) -> None:
        self._drafts = TeachingDrafts(folder)
        self._worker = worker
        self._tasks = tasks
        self._notices = notices
        self._rig = rig
        self._jobs = jobs
        self._sources = Sources(capture, rig, jobs, recorded)
        self._open: dict[str, _Open] = {}
        self._beginning = asyncio.Lock()

    # --- what is asked -----------------------------------------------------------------------

    async def begin(
        self, author: str, *, token: str | None, name: str | None, job: str | None, cycle: int | None
    ) -> TeachingDocument:
        """A new draft: from a fresh pair or a recorded one, else from that which a job was taught from.

        job : the one that it replaces. Raises `TeachError`, `SetupRefused`, `CaptureError`, `OSError`, and
        `KeyError` for a job or a cycle that there is not.
        """
        replaced = None if job is None else self._jobs().line(job)
        taken = await self._sources.take(token, cycle, replaced)
        async with self._beginning:
            start = self._jobs().named(taken.content, name, replaced)
            now, folder = datetime.now(UTC), None if replaced is None else replaced.folder
            one = _Open(await asyncio.to_thread(self._drafts.create, author, start, taken, now, folder))
            self._open = {key: value for key, value in self._open.items() if self._is_looking(value)}
            self._open[one.draft.state.id] = one
        self._look(one)
        return self._tell(one)

    async def listed(self) -> TeachingList:
        """All of them."""
        states = await asyncio.to_thread(self._drafts.states)
        return TeachingList(teachings=[self._line(*one) for one in states])

    async def document(self, identity: str) -> TeachingDocument:
        """One of them. Raises `KeyError`, and `FileFormatError` for one that cannot be read."""
        return self._document(await self._opened(identity))

    async def draft(self, identity: str) -> TeachingDraft:
        """Raises as `document`."""
        return (await self._opened(identity)).draft

    async def job(self, identity: str) -> Job:
        """The job that is wanted, once it is learnt. Raises `KeyError`, `TeachError` that says why not."""
        return (await self._seen(await self._opened(identity))).job

    async def remove(self, identity: str, revision: int | None) -> None:
        """Forget a draft. Raises `KeyError`, `Stale`."""
        one = self._open.get(identity)
        if one is not None:
            self._check_revision(one, revision)
            del self._open[identity]
        if one is not None and self._tasks.is_running(one.task):
            await self._tasks.cancel(str(one.task))
        await asyncio.to_thread(self._drafts.remove, identity)
        self._notices.publish("teaching", {"id": identity, "gone": True})

    async def set_region(
        self, identity: str, revision: int | None, shapes: Sequence[Shape]
    ) -> TeachingDocument:
        """Where the part is. Raises `TeachError` for what is no region, `Stale`."""
        one = await self._opened(identity)
        state = one.draft.state
        await asyncio.to_thread(check_region, shapes, state.width, state.height)
        sets: JsonValue = [shape.model_dump(mode="json") for shape in shapes]
        return await self._operate(one, revision, "region", {"shapes": sets, "drawing": None})

    async def draw(self, identity: str, revision: int | None, drawn: Drawn) -> TeachingDocument:
        """Learn from a drawing instead. Raises `TeachError` that says what is wrong with it, `Stale`."""
        one = await self._opened(identity)
        self._check_revision(one, revision)
        depth_mm = await self._depth_mm(one) if drawn.depth_mm is None else drawn.depth_mm
        outlines = await self._worker.run("read_drawing", drawn.data, drawn.name, drawn.unit, drawn.layers)
        drawing = Drawing(name=drawn.name, depth_mm=depth_mm, outlines=outlines).model_dump(mode="json")
        return await self._operate(one, revision, "drawing", {"drawing": drawing})

    async def _depth_mm(self, one: _Open) -> float:
        """As it was stated before, else as the pair shows it. Raises `TeachError` where neither is known."""
        known = one.draft.state.content.drawing
        if known is not None:
            return known.depth_mm
        try:
            seen = await self._seen(one)
        except TeachError as error:
            raise TeachError(
                "depth: state the distance of the face from the left camera: the pair does not tell it",
                "drawing_depth",
            ) from error
        return round(float(seen.job.rig_from_part[2, 3]), 1)

    async def tap(self, identity: str, revision: int | None, place: Tapped) -> TeachingDocument:
        """Let the region be what is there: the largest thing, at the next tap the next smaller one.

        Whoever taps what was proposed means it, and not a bore in it.
        """
        one = await self._opened(identity)
        self._check_revision(one, revision)
        regions = await self._worker.run("regions_at", one.draft.folder / "pictures", place.x, place.y)
        shapes: list[JsonValue] = [[polygon(corners)] for corners in regions]
        now: JsonValue = [shape.model_dump(mode="json") for shape in one.draft.state.content.shapes or ()]
        state = one.draft.state
        is_again = state.done > 0 and state.operations[state.done - 1].what == "tap"
        following = (shapes.index(now) + 1) % len(shapes) if is_again and now in shapes else 0
        sets = {"shapes": shapes[following], "drawing": None}
        return await self._operate(one, revision, "tap", sets)

    async def take(self, identity: str, revision: int | None, taken: Mapping[str, bool]) -> TeachingDocument:
        """Take features, or leave them. Raises `TeachError` when nothing is left, `KeyError`."""
        one = await self._opened(identity)
        seen = await self._seen(one)
        marks = {name: seen.marks[name] for name in taken}
        named = {nearest(mark, seen.marks): mark for mark in one.draft.state.content.left_out}
        left_out = {name: mark for name, mark in named.items() if name not in taken}
        left_out |= {name: mark for name, mark in marks.items() if not taken[name]}
        # what lies nowhere now may lie there again in another region
        lost = [mark for mark in one.draft.state.content.left_out if nearest(mark, seen.marks) is None]
        every = [*lost, *(mark for name, mark in left_out.items() if name is not None)]
        return await self._wish(one, revision, "features", {"left_out": [kept(mark) for mark in every]})

    async def wish(
        self,
        identity: str,
        revision: int | None,
        sets: Mapping[str, JsonValue],
        *,
        reference: str | Tapped | None = None,
        gripping: Grip | None = None,
        sizes: Sequence[WantedSize] | None = None,
    ) -> TeachingDocument:
        """Anything else. sets : fields of the content as they are kept. Raises `TeachError`, `KeyError`."""
        one, found = await self._opened(identity), dict(sets)
        if reference is not None or gripping is not None or sizes is not None:
            seen = await self._seen(one)
            if reference is not None:
                name = reference if isinstance(reference, str) else tapped_feature(seen, reference)
                found["reference"] = kept(seen.marks[name])
            if gripping is not None:
                found["gripping"] = kept_grip(seen, self._rig_there(), gripping).model_dump(mode="json")
            if sizes is not None:
                found["sizes"] = [kept_size(seen, size).model_dump(mode="json") for size in sizes]
        if {"name", "number"} & found.keys():
            wanted = one.draft.state.content.with_(found)
            self._jobs().check_free(wanted.name, wanted.number, one.draft.state.job)
        return await self._wish(one, revision, "about", found)

    async def candidate(self, identity: str) -> Candidate:
        """The job that is wanted, as files. Raises `KeyError`, `TeachError` that says why there is none."""
        one = await self._opened(identity)
        job = (await self._seen(one)).job
        files = {**job_files(job), **await asyncio.to_thread(one.draft.kept)}
        return self._jobs().candidate(job.name, job.number, one.draft.state.job, files)

    async def note_activated(self, identity: str, candidate: Candidate | None) -> None:
        """The job is about to be the cell's; None: it is not after all."""
        one = await self._opened(identity)
        async with one.changing:
            digest = None if candidate is None else candidate.digest
            await asyncio.to_thread(one.draft.note_activated, digest)

    async def tell(self, identity: str) -> None:
        """Tell every page how a draft is now: whether it is active is not its own doing."""
        self._tell(await self._opened(identity))

    async def step(self, identity: str, revision: int | None, by: Literal[-1, 1]) -> TeachingDocument:
        """Undo, or redo. Raises `TeachError`, `Stale`."""
        one = await self._opened(identity)
        return await self._change(one, revision, one.draft.undo if by < 0 else one.draft.redo)

    # --- changing --------------------------------------------------------------------------------

    async def _wish(
        self,
        one: _Open,
        revision: int | None,
        what: Literal["features", "about"],
        sets: Mapping[str, JsonValue],
    ) -> TeachingDocument:
        """Where the job is learnt already, what cannot be is refused now."""
        if one.seen is not None:
            wanted = one.draft.state.content.with_(sets)
            edited(one.seen.taught, wanted, one.seen.marks, one.seen.pixel_mm, one.seen.moved)
        return await self._operate(one, revision, what, sets)

    async def _operate(
        self,
        one: _Open,
        revision: int | None,
        what: Literal["region", "tap", "features", "about", "drawing"],
        sets: Mapping[str, JsonValue],
    ) -> TeachingDocument:
        return await self._change(one, revision, partial(one.draft.operate, what, sets))

    async def _change(self, one: _Open, revision: int | None, change: Callable[[], None]) -> TeachingDocument:
        async with one.changing:
            self._check_revision(one, revision)
            await asyncio.to_thread(change)
        self._look(one)
        return self._tell(one)

    def _check_revision(self, one: _Open, revision: int | None) -> None:
        if revision is not None and revision != one.draft.state.revision:
            raise Stale(self._document(one))

    # --- learning --------------------------------------------------------------------------------

    def _wanted(self, one: _Open) -> tuple[object, ...]:
        """What it depends on how the part is seen."""
        rig, job = self._rig(), one.draft.state.job
        line = None if job is None else next((x for x in self._jobs().lines if x.folder == job), None)
        return one.draft.state.content, None if rig is None else rig.content, line

    def _is_looking(self, one: _Open) -> bool:
        return self._tasks.is_running(one.task)

    def _look(self, one: _Open) -> None:
        """See to it that what is shown is what is wanted."""
        if not self._is_looking(one) and one.seen_of != self._wanted(one):
            one.ended.clear()
            one.task = self._tasks.start("teach", partial(self._run_look, one))

    async def _seen(self, one: _Open) -> Seen:
        """What is wanted, as it is seen. Raises `TeachError` that says why it is not."""
        self._look(one)
        await one.ended.wait()
        if one.seen is None:
            raise one.trouble or TeachError("nothing is learnt")
        return one.seen

    async def _run_look(self, one: _Open, progress: Progress) -> None:
        failed = 0
        try:
            while True:
                try:
                    await self._propose(one)
                    if one.seen_of == (wanted := self._wanted(one)):
                        break
                    one.seen = await self._looked(one, progress)
                    one.seen_of, one.trouble = wanted, None
                except EdgedError as error:
                    failed += isinstance(error, TaskFailed)
                    failed += isinstance(error, TaskTooLarge)  # once is enough
                    if failed == 1 and isinstance(error, TaskFailed):  # somebody ended the process
                        continue
                    one.seen, one.seen_of = None, self._wanted(one)
                    one.trouble = error
                    if isinstance(error, TaskFailed):
                        raise
                if one.seen_of != self._wanted(one):
                    self._tell(one)
        finally:
            one.ended.set()
            # when the task has ended: then nothing is being proposed any more
            asyncio.get_running_loop().call_soon(self._tell_if_open, one)

    async def _propose(self, one: _Open) -> None:
        """The region before anybody has said another."""
        if one.draft.state.content.shapes is not None:
            return
        corners = await self._worker.run("propose_region", one.draft.folder / "pictures")
        async with one.changing:
            if one.draft.state.content.shapes is None:
                shapes: list[JsonValue] = [] if corners is None else [polygon(corners)]
                await asyncio.to_thread(one.draft.propose, shapes)
        self._tell(one)

    async def _looked(self, one: _Open, progress: Progress) -> Seen:
        rig, content = self._rig(), one.draft.state.content
        if rig is None:
            raise SetupRefused("there is no calibration: calibrate first")
        former = await asyncio.to_thread(self._former, one.draft)
        order = Order(one.draft.folder / "pictures", content, rig.content, rig.path, former)
        seen: Seen = await self._worker.run("see_part", order, progress=progress)
        return seen

    def _former(self, draft: TeachingDraft) -> FormerFiles | None:
        """The job that is replaced, as it is now; None where it is gone or cannot be read."""
        if draft.state.job is None:
            return None
        folder = self._jobs().folder / draft.state.job
        try:
            files = read_job(folder)
        except FileFormatError:
            return None
        return FormerFiles(files[TEXT], files[SHAPE], folder, draft.state.is_same_pair)

    # --- telling ---------------------------------------------------------------------------------

    async def _opened(self, identity: str) -> _Open:
        if identity not in self._open:
            draft = await asyncio.to_thread(self._drafts.load, identity)
            self._open.setdefault(identity, _Open(draft))
        one = self._open[identity]
        line = next((x for x in self._jobs().lines if x.digest == one.draft.state.activated), None)
        if line is not None and (one.draft.state.job, one.draft.state.is_same_pair) != (line.folder, True):
            async with one.changing:
                await asyncio.to_thread(one.draft.note_job, line.folder)
        self._look(one)
        return one

    def _line(self, identity: str, state: TeachState | FileFormatError) -> TeachingLine:
        if isinstance(state, FileFormatError):
            return TeachingLine(id=identity, trouble=str(state))
        return TeachingLine(
            id=identity,
            name=state.content.name,
            number=state.content.number,
            job=state.job,
            author=state.author,
            created=state.created,
            active=self._is_active(state),
        )

    def _is_active(self, state: TeachState) -> bool:
        """Whether the job that came of it is the cell's, as it is."""
        return state.activated is not None and state.activated in {one.digest for one in self._jobs().lines}

    def _tell_if_open(self, one: _Open) -> None:
        if self._open.get(one.draft.state.id) is one:
            self._tell(one)

    def _tell(self, one: _Open) -> TeachingDocument:
        document = self._document(one)
        self._notices.publish("teaching", document.model_dump(mode="json"))
        return document

    def _document(self, one: _Open) -> TeachingDocument:
        return teaching_document(
            one.draft,
            one.seen,
            self._stereo_rig(),
            f"{PLACE}/{one.draft.state.id}",
            task=one.task if self._is_looking(one) else None,
            trouble=one.trouble,
            active=self._is_active(one.draft.state),
        )

    def _rig_there(self) -> StereoRig:
        rig = self._stereo_rig()
        if rig is None:
            raise SetupRefused("there is no calibration: calibrate first")
        return rig

    def _stereo_rig(self) -> StereoRig | None:
        rig = self._rig()
        return None if rig is None else _rig_of(rig.content, rig.path)


@lru_cache(maxsize=1)
def _rig_of(content: bytes, path: Path) -> StereoRig:
    return rig_of(content, path)
