"""Job drafts in a running cell: a pair is stored, users mark the part in it, and the worker learns it.

Users' input is on disc before the request is answered; results are sent when the worker has computed them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import JsonValue

from edged.errors import EdgedError, FileFormatError, TaskFailed, TaskTooLarge, TeachError
from edged.files.jobs import SHAPE, TEXT, job_files, read_job
from edged.files.jobs.schema import TraySection
from edged.setup.documents import DraftHead, PicturePaths
from edged.setup.drafts import OpenDrafts, trouble_in
from edged.setup.inuse import CellInUse
from edged.setup.pairs import Progress
from edged.setup.releases.jobsinuse import Candidate, JobLine
from edged.setup.teaching.documents import ContoursDocument, DrawingDocument, TeachingDocument
from edged.setup.teaching.drafts import TeachingDraft, TeachingDrafts
from edged.setup.teaching.editing import FormerFiles, edited
from edged.setup.teaching.model import Drawing, GripWanted, Shape, SizeWanted, TapPlace, TeachState, nearest
from edged.setup.teaching.proposing import JobSeen, LearningOrder
from edged.setup.teaching.sources import Sources
from edged.setup.teaching.wishes import (
    Drawn,
    check_region,
    gripping_in,
    kept,
    kept_grip,
    kept_size,
    polygon,
    tapped_feature,
)
from edged.vision.part.job import Job

FUNCTIONS = {
    **{name: f"edged.setup.teaching.work:{name}" for name in ("regions_at", "read_drawing")},
    **{name: f"edged.setup.teaching.proposing:{name}" for name in ("propose_region", "see")},
}
PLACE = "/api/v1/teachings"
NOTHING_SEEN: Mapping[str, Any] = {
    **dict.fromkeys(("features", "sizes", "rivals", "warnings"), ()),
    **dict.fromkeys(("reference", "gripping", "tray", "predicted", "break_mm", "break_end")),
    "outlines": ContoursDocument(left=[], right=[]),
}
"""Fields of a `TeachingDocument` before the worker has analysed the pair."""


@dataclass(eq=False, slots=True)
class OpenTeaching:
    """An open draft. seen : result for the inputs `seen_of`, or None. trouble : why there is none."""

    draft: TeachingDraft
    seen: JobSeen | None = None
    seen_of: tuple[object, ...] = ()
    trouble: EdgedError | None = None
    task: str | None = None
    ended: asyncio.Event = field(default_factory=asyncio.Event)
    is_gone: bool = False

    @property
    def is_busy(self) -> bool:
        """Whether it is being learnt."""
        return self.task is not None and not self.ended.is_set()


class Teachings:
    """All drafts of jobs of a cell; used on its event loop.

    recorded : returns the file of a recorded cycle; raises `KeyError`.
    """

    def __init__(self, cell: CellInUse, recorded: Callable[[int], Awaitable[Path]]) -> None:
        self._cell = cell
        self._worker = cell.worker
        self._tasks = cell.tasks
        self._folders = TeachingDrafts(cell.folder / "teachings")
        self._sources = Sources(cell, recorded)
        self.drafts = OpenDrafts("teaching", cell.notices, self._folders, self)

    # --- requests ------------------------------------------------------------------------------

    async def begin(
        self, author: str, *, token: str | None, name: str | None, job: str | None, cycle: int | None
    ) -> DraftHead:
        """Begin a draft from a fresh pair or a recorded one, otherwise from the pair that a job keeps.

        job : the one that it replaces. Raises `TeachError`, `SetupRefused`, `CaptureError`, `OSError`, and
        `KeyError` for an unknown job or cycle.
        """
        replaced = None if job is None else self._cell.job_lines().line(job)
        taken = await self._sources.take(token, cycle, replaced)

        def create() -> TeachingDraft:
            start = self._cell.job_lines().named(taken.content, name, replaced)
            folder = None if replaced is None else replaced.folder
            return self._folders.create(author, start, taken, datetime.now(UTC), folder)

        opened = await self.drafts.begin(create)
        self.refresh(opened)
        return self.drafts.publish(opened)

    async def job(self, identity: str) -> Job:
        """The wanted job, once it is learnt. Raises `KeyError`, and `TeachError` with the reason if not."""
        return (await self._seen(await self.drafts.get(identity))).job

    async def set_region(self, identity: str, revision: int | None, shapes: Sequence[Shape]) -> DraftHead:
        """Set the region of the part. Raises `TeachError` for an invalid one, `StaleDraft`."""
        state = (await self.drafts.get(identity)).draft.state
        await asyncio.to_thread(check_region, shapes, state.width, state.height)
        sets: JsonValue = [shape.model_dump(mode="json") for shape in shapes]
        return await self._operate(identity, revision, "region", {"shapes": sets, "drawing": None})

    async def draw(self, identity: str, revision: int | None, drawn: Drawn) -> DraftHead:
        """Learn from a drawing instead. Raises `TeachError` with what is wrong with it, `StaleDraft`."""
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        depth_mm = await self._depth_mm(opened) if drawn.depth_mm is None else drawn.depth_mm
        order = (drawn.data, drawn.name, drawn.unit, drawn.layers)
        outlines = await self._worker.run("read_drawing", *order)
        drawing = Drawing(name=drawn.name, depth_mm=depth_mm, outlines=outlines).model_dump(mode="json")
        return await self._operate(identity, revision, "drawing", {"drawing": drawing})

    async def _depth_mm(self, opened: OpenTeaching) -> float:
        """Depth as stated before, or else as the pair shows it. Raises `TeachError` if neither is known."""
        known = opened.draft.state.content.drawing
        if known is not None:
            return known.depth_mm
        try:
            seen = await self._seen(opened)
        except TeachError as error:
            raise TeachError(
                "depth: state the distance of the face from the left camera: the pair does not show it",
                "drawing_depth",
            ) from error
        return round(float(seen.job.rig_from_part[2, 3]), 1)

    async def add_pair(
        self, identity: str, revision: int | None, *, token: str | None, cycle: int | None
    ) -> DraftHead:
        """Add a further pair, fresh or of a recorded cycle, of the part tilted or in other light.

        Raises `TeachError`, `SetupRefused`, `CaptureError`, `StaleDraft`, and `KeyError` for an unknown
        cycle.
        """
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        taken = await self._sources.take(token, cycle, None)
        name = await asyncio.to_thread(opened.draft.put_further, taken)
        return await self.keep_pairs(identity, revision, [*opened.draft.state.content.further, name])

    async def keep_pairs(self, identity: str, revision: int | None, names: Sequence[str]) -> DraftHead:
        """Keep only these further pairs. Raises `KeyError` for an unknown one, `StaleDraft`."""
        draft = (await self.drafts.get(identity)).draft
        for name in names:
            if not draft.picture("left", pair=name).is_file():
                raise KeyError(name)
        return await self._operate(identity, revision, "further", {"further": list(dict.fromkeys(names))})

    async def tap(self, identity: str, revision: int | None, place: TapPlace) -> DraftHead:
        """Set the region to the largest object at a place, with each further tap to the next smaller one.

        The first tap on the proposed region selects that region, not a bore in it.
        """
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        regions = await self._worker.run("regions_at", opened.draft.pictures, place.x, place.y)
        shapes: list[JsonValue] = [[polygon(corners)] for corners in regions]
        state = opened.draft.state
        now: JsonValue = [shape.model_dump(mode="json") for shape in state.content.shapes or ()]
        is_again = state.done > 0 and state.operations[state.done - 1].what == "tap"
        following = (shapes.index(now) + 1) % len(shapes) if is_again and now in shapes else 0
        sets = {"shapes": shapes[following], "drawing": None}
        return await self._operate(identity, revision, "tap", sets)

    async def take(self, identity: str, revision: int | None, taken: Mapping[str, bool]) -> DraftHead:
        """Use features or leave them out. Raises `TeachError` if nothing is left, `KeyError`."""
        opened = await self.drafts.get(identity)
        seen, before = await self._seen(opened), opened.draft.state.content.left_out
        marks = {name: seen.marks[name] for name in taken}
        left_out = {nearest(mark, seen.marks): mark for mark in before}
        left_out = {name: mark for name, mark in left_out.items() if name not in taken}
        left_out |= {name: mark for name, mark in marks.items() if not taken[name]}
        # keep marks that match no feature now: they may match again in another region
        every = [mark for mark in before if nearest(mark, seen.marks) is None]
        every += [mark for name, mark in left_out.items() if name is not None]
        return await self._wish(opened, revision, "features", {"left_out": [kept(mark) for mark in every]})

    async def wish(
        self,
        identity: str,
        revision: int | None,
        sets: Mapping[str, JsonValue],
        *,
        reference: str | TapPlace | None = None,
        gripping: GripWanted | None = None,
        sizes: Sequence[SizeWanted] | None = None,
    ) -> DraftHead:
        """Change anything else. sets : fields of the content as stored. Raises `TeachError`, `KeyError`."""
        opened, found = await self.drafts.get(identity), dict(sets)
        if reference is not None or gripping is not None or sizes is not None:
            seen = await self._seen(opened)
            if reference is not None:
                name = reference if isinstance(reference, str) else tapped_feature(seen, reference)
                found["reference"] = kept(seen.marks[name])
            if gripping is not None:
                found["gripping"] = kept_grip(seen, self._cell.needed_rig().stereo(), gripping)
            if sizes is not None:
                found["sizes"] = [kept_size(seen, size) for size in sizes]
        if {"name", "number"} & found.keys():
            wanted = opened.draft.state.content.with_(found)
            self._cell.job_lines().check_free(wanted.name, wanted.number, opened.draft.state.job)
        return await self._wish(opened, revision, "about", found)

    async def candidate(self, identity: str) -> Candidate:
        """The wanted job as files. Raises `KeyError`, and `TeachError` with the reason if there is none."""
        opened = await self.drafts.get(identity)
        job = (await self._seen(opened)).job
        files = {**job_files(job), **await asyncio.to_thread(opened.draft.kept)}
        return self._cell.job_lines().candidate(job.name, job.number, opened.draft.state.job, files)

    async def note_activated(self, identity: str, candidate: Candidate | None) -> None:
        """Record that the job is about to become active in the cell; None takes that back."""
        digest = None if candidate is None else candidate.digest
        async with self.drafts.changing(opened := await self.drafts.get(identity)):
            await asyncio.to_thread(opened.draft.note_activated, digest)

    async def note_job(self, identity: str) -> None:
        """Record that the draft's job is now active in the cell: from now on it is a draft of that job."""
        opened = await self.drafts.get(identity)
        async with self.drafts.changing(opened):
            await asyncio.to_thread(self._note_job, opened.draft)
        self.drafts.publish(opened)

    def _note_job(self, draft: TeachingDraft) -> None:
        state, line = draft.state, self._line(digest=draft.state.activated)
        if line is not None and (state.job, state.is_same_pair) != (line.folder, True):
            draft.note_job(line.folder)

    async def _wish(
        self, opened: OpenTeaching, revision: int | None, what: str, sets: Mapping[str, JsonValue]
    ) -> DraftHead:
        """Apply an operation; if the job is learnt already, refuse impossible ones at once."""
        seen = opened.seen
        if seen is not None:
            wanted = opened.draft.state.content.with_(sets)
            edited(seen.taught, wanted, seen.marks, seen.pixel_mm, seen.moved)
        return await self._operate(opened.draft.state.id, revision, what, sets)

    async def _operate(
        self, identity: str, revision: int | None, what: str, sets: Mapping[str, JsonValue]
    ) -> DraftHead:
        return await self.drafts.change(identity, lambda draft: draft.operate(what, sets), revision)

    # --- learning --------------------------------------------------------------------------------

    def _line(self, **wanted: str | None) -> JobLine | None:
        """The job of the cell with this value of a field; None if there is none."""
        ((name, value),) = wanted.items()
        return next((line for line in self._cell.job_lines().lines if getattr(line, name) == value), None)

    def _wanted(self, opened: OpenTeaching) -> tuple[object, ...]:
        """Inputs that `seen` depends on."""
        state, rig = opened.draft.state, self._cell.rig()
        return state.content, None if rig is None else rig.content, self._line(folder=state.job)

    async def _seen(self, opened: OpenTeaching) -> JobSeen:
        """Wait for the result of the present content. Raises `TeachError` with the reason if none."""
        self.refresh(opened)
        await opened.ended.wait()
        if opened.seen is None:
            raise opened.trouble or TeachError("nothing is learnt")
        return opened.seen

    async def _run_look(self, opened: OpenTeaching, progress: Progress) -> None:
        failed = 0
        try:
            while True:
                try:
                    await self._propose(opened)
                    if opened.seen_of == (wanted := self._wanted(opened)):
                        break
                    opened.seen = await self._looked(opened, progress)
                    opened.seen_of, opened.trouble = wanted, None
                except EdgedError as error:
                    failed += isinstance(error, TaskFailed)
                    failed += isinstance(error, TaskTooLarge)  # not tried again
                    if failed == 1 and isinstance(error, TaskFailed):  # the worker process was ended: retry
                        continue
                    opened.seen, opened.seen_of = None, self._wanted(opened)
                    opened.trouble = error
                    if isinstance(error, TaskFailed):
                        raise
                if opened.seen_of != self._wanted(opened):
                    self.drafts.publish(opened)
        finally:
            opened.ended.set()
            # later, when the task has ended and no longer counts as proposing
            asyncio.get_running_loop().call_soon(self.drafts.publish, opened)

    async def _propose(self, opened: OpenTeaching) -> None:
        """Propose the initial region, unless one is set already."""
        if opened.draft.state.content.shapes is not None:
            return
        corners = await self._worker.run("propose_region", opened.draft.pictures)
        async with self.drafts.changing(opened):
            if opened.draft.state.content.shapes is None:
                shapes: list[JsonValue] = [] if corners is None else [polygon(corners)]
                await asyncio.to_thread(opened.draft.propose, shapes)
        self.drafts.publish(opened)

    async def _looked(self, opened: OpenTeaching, progress: Progress) -> JobSeen:
        rig, draft = self._cell.needed_rig(), opened.draft
        former = await asyncio.to_thread(self._former, draft)
        order = LearningOrder(draft.pictures, draft.state.content, rig, former)
        seen: JobSeen = await self._worker.run("see", order, progress=progress)
        return seen

    def _former(self, draft: TeachingDraft) -> FormerFiles | None:
        """The replaced job as it is now; None if it is gone or cannot be read."""
        if draft.state.job is None:
            return None
        folder = self._cell.job_lines().folder / draft.state.job
        try:
            files = read_job(folder)
        except FileFormatError:
            return None
        return FormerFiles(files[TEXT], files[SHAPE], folder, draft.state.is_same_pair)

    # --- the topic of `drafts` -------------------------------------------------------------------

    def opened(self, draft: TeachingDraft) -> OpenTeaching:
        """Open a draft for work; note its job if the process was killed right after its activation."""
        self._note_job(draft)
        return OpenTeaching(draft)

    def refresh(self, opened: OpenTeaching) -> None:
        """Start learning if the inputs have changed."""
        if not self._tasks.is_running(opened.task) and opened.seen_of != self._wanted(opened):
            opened.ended.clear()
            opened.task = self._tasks.start("teach", partial(self._run_look, opened))

    async def stop(self, opened: OpenTeaching) -> None:
        """Stop learning."""
        if self._tasks.is_running(opened.task):
            await self._tasks.cancel(str(opened.task))

    def summary(self, state: TeachState) -> dict[str, Any]:
        """A draft in the list."""
        about = {"name": state.content.name, "number": state.content.number, "job": state.job}
        return {**about, "active": self._is_active(state)}

    def _is_active(self, state: TeachState) -> bool:
        """Whether the job that was made from it is active in the cell, unchanged."""
        return state.activated is not None and self._line(digest=state.activated) is not None

    def document(self, opened: OpenTeaching) -> TeachingDocument:
        """Full document of a draft."""
        state, content, place = opened.draft.state, opened.draft.state.content, opened.draft.state.id
        shapes, drawing = list(content.shapes or ()), content.drawing
        return TeachingDocument(
            **state.head,
            name=content.name,
            number=content.number,
            job=state.job,
            width=state.width,
            height=state.height,
            pictures=PicturePaths.below(f"{PLACE}/{place}"),
            shapes=shapes,
            region=[shape for shape in shapes if shape.add],
            exclude=[shape for shape in shapes if not shape.add],
            drawing=drawing
            and DrawingDocument(name=drawing.name, depth_mm=drawing.depth_mm, outlines=len(drawing.outlines)),
            proposing=opened.task if self._tasks.is_running(opened.task) else None,
            trouble=trouble_in(opened.trouble),
            tilt_deg=content.tilt_deg,
            further=list(content.further),
            active=self._is_active(state),
            **self._shown(opened),
        )

    def _shown(self, opened: OpenTeaching) -> Mapping[str, Any]:
        """Fields of a `TeachingDocument` that come from the pair, as far as they are known already."""
        seen, rig, content = opened.seen, self._cell.rig(), opened.draft.state.content
        if seen is None or rig is None:
            return NOTHING_SEEN
        left_out = {nearest(mark, seen.marks) for mark in content.left_out}
        features = []
        for feature in seen.features:
            is_there = seen.job.kind_of(feature.key) is not None or not left_out
            taken = feature.key not in left_out and is_there
            features.append(feature.model_copy(update={"taken": taken}))
        same = {name: getattr(seen, name) for name in NOTHING_SEEN.keys() - {"features", "gripping", "tray"}}
        gripping = gripping_in(content.gripping, seen, rig.stereo())
        tray = seen.job.picking.tray
        shown = None if tray is None else TraySection.of(tray)
        return {**same, "features": features, "gripping": gripping, "tray": shown}
