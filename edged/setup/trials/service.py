"""Tries a job on live pairs: they are measured in the worker process and shown at once, without blocking.

While a job is tried, the same pairs are not searched for a board. Pairs that arrive while the worker is busy
are skipped, so that the newest one is always shown.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import FloatArray
from edged.domain.frames import FramePair
from edged.errors import EdgedError, SetupRefused, UserError
from edged.setup.documents import LastDocument, now_text
from edged.setup.drafts import trouble_in
from edged.setup.inuse import CellInUse
from edged.setup.jobs.messages import encode_message
from edged.setup.pairs import Progress
from edged.setup.trials.documents import (
    MapDocument,
    StillDocument,
    TrialDocument,
    map_document,
    still_document,
)
from edged.setup.trials.sigmamap import SigmaMap
from edged.setup.trials.stilltest import StillResult, StillSample
from edged.setup.trials.tried import TriedPair
from edged.setup.trials.work import TrialSetup
from edged.vision.part.expected import Scatters
from edged.vision.part.job import Job

log = logging.getLogger(__name__)

FUNCTIONS = {name: f"edged.setup.trials.work:{name}" for name in ("try_pair", "stand", "still", "sigmas")}
MOST_COVERED = 2000
"""Most places that are sent: a trail of many minutes."""
MOST_KNOWN = 4
"""Number of jobs whose trail and map are kept."""
APART_MM = 0.5
"""Least distance of two places in the trail, so that a part that lies still leaves only one."""


@dataclass(frozen=True, slots=True)
class What:
    """Subject of a trial: a job of the cell by its name, or a teaching draft by its id."""

    job: str | None = None
    teaching: str | None = None


@dataclass(eq=False, slots=True)
class _Trial:
    """State of a trial of a job with a rig. content : the encoded job, as it is sent to the worker."""

    what: What
    job: Job
    content: bytes
    calibration: str
    number: int = 0
    tried: TriedPair | None = None
    trouble: EdgedError | OSError | None = None
    scatters: Scatters = field(default_factory=dict)
    places: list[FloatArray] = field(default_factory=list)
    visited: set[int] = field(default_factory=set)
    map: SigmaMap | None = None
    map_measured: bool = False

    @property
    def covered_share(self) -> float | None:
        """Share of the measurable places of the map that were visited; None without a map."""
        if self.map is None or not self.map.seen.any():
            return None
        return len(self.visited & set(np.flatnonzero(self.map.seen).tolist())) / int(self.map.seen.sum())

    def document(self, *, on: bool) -> TrialDocument:
        """Document of the trial."""
        tried = self.tried
        return TrialDocument(
            on=on,
            job=self.what.job,
            teaching=self.what.teaching,
            name=self.job.name,
            number=self.number,
            status=None if tried is None else tried.status,
            words_code=None if tried is None else next(iter(tried.reasons), "OK"),
            reasons=[] if tried is None else list(tried.reasons),
            targets=[] if tried is None else list(tried.parts),
            limit_um=1e3 * self.job.limits.max_sigma_mm,
            covered=[[round(float(value), 2) for value in place] for place in self.places],
            covered_share=self.covered_share,
            trouble=trouble_in(self.trouble),
        )

    def note(self, number: int, tried: TriedPair) -> None:
        """Record the result of a pair."""
        self.number, self.tried, self.trouble = number, tried, None
        self.scatters = tried.scatters or self.scatters
        for place in tried.places_mm:
            self._visit(place)
            near = (float(np.linalg.norm(place - known)) < APART_MM for known in reversed(self.places))
            if len(self.places) < MOST_COVERED and not any(near):
                self.places.append(place)

    def chart(self, found: SigmaMap, *, measured: bool) -> None:
        """Set the map of the expected sigma; earlier places count as visited in it."""
        self.map, self.map_measured = found, measured
        self.visited.clear()
        for place in self.places:
            self._visit(place)

    def _visit(self, place: FloatArray) -> None:
        cell = None if self.map is None else self.map.cell_of(place)
        if cell is not None:
            self.visited.add(cell)


class Trials:
    """Trials of jobs in a cell; used on the event loop only.

    draft : returns the job of a teaching draft by its id; raises `KeyError`.
    """

    def __init__(self, cell: CellInUse, draft: Callable[[str], Awaitable[Job]]) -> None:
        self._cell = cell
        self._kept = LastDocument(cell.folder / "still.json", StillDocument, "the last still test")
        self._draft = draft
        self._known: dict[What, _Trial] = {}  # in the order of last use
        self._tried = What()  # the present or last subject
        self._token: str | None = None  # of the lease, while live pairs are measured
        self._trying: asyncio.Task[None] | None = None
        self._still: str | None = None

    @property
    def is_on(self) -> bool:
        """Whether live pairs are measured with a job; then nothing else analyses them."""
        return self._token is not None

    async def close(self) -> None:
        """Stop trying."""
        if self._trying is not None:
            await cancel_and_await(self._trying)

    # --- requests ----------------------------------------------------------------------------

    async def turn(self, token: str, what: What, *, on: bool) -> TrialDocument:
        """Start or stop measuring each live pair with a job.

        Raises `SetupRefused`, `UserError`, and `KeyError` for an unknown draft.
        """
        await self._cell.session.renew_setup(token)
        if on:
            self._tried = (await self._trial_of(what)).what
        self._token = token if on else None
        return self._tell()

    async def document(self) -> TrialDocument:
        """State of the trial."""
        return self._document()

    async def map(self, what: What) -> MapDocument:
        """Expected sigma of a job in its working volume. Raises as `turn`, and `TaskFailed`."""
        trial = await self._trial_of(what)
        measured = bool(trial.scatters)
        if trial.map is None or measured != trial.map_measured:
            found = await self._cell.worker.run("sigmas", self._setup(trial), trial.scatters)
            trial.chart(found, measured=measured)
        assert trial.map is not None
        return map_document(trial.job.name, trial.map, measured=trial.map_measured)

    async def start_still_test(self, token: str, what: What, pictures: int, author: str) -> str:
        """Start a still test, and return the task. Raises as `turn`."""
        await self._cell.session.renew_setup(token)
        if self._cell.tasks.is_running(self._still):
            raise SetupRefused("a still test is running")
        trial = await self._trial_of(what)
        self._still = self._cell.tasks.start(
            "still", partial(self._hold_still, trial, token, pictures, author)
        )
        return self._still

    async def last_still(self) -> StillDocument | None:
        """The last still test; None if there was none yet."""
        return await asyncio.to_thread(self._kept.read)

    # --- live pairs ------------------------------------------------------------------------------

    def offer(self, number: int, pair: FramePair) -> None:
        """Measure a live pair, unless the worker is busy."""
        busy = self._cell.worker.is_busy or self._cell.tasks.is_running(self._still)
        if self._token is not None and self._trying is None and not busy:
            self._trying = asyncio.create_task(
                self._try(self._tried, self._token, number, pair), name="trial"
            )

    async def _try(self, what: What, token: str, number: int, pair: FramePair) -> None:
        trial = self._known.get(what)
        try:
            await self._cell.session.renew_setup(token)
            trial = await self._trial_of(what)
            images = pair.images
            trial.note(number, await self._cell.worker.run("try_pair", self._setup(trial), images))
        except (SetupRefused, KeyError):  # the lease has ended, or the draft is gone
            self._token = None
        except (EdgedError, OSError) as error:
            if trial is not None:
                if str(trial.trouble) != str(error):  # once, not with every pair
                    log.warning("a live pair cannot be tried: %s", error)
                trial.number, trial.tried, trial.trouble = number, None, error
        finally:
            self._trying = None
        if what == self._tried:
            self._tell()

    async def _trial_of(self, what: What) -> _Trial:
        """The trial of a subject, or of the present one for `What()`; a new one if job or rig changed."""
        what = self._tried if what == What() else what
        job, rig = await self._job(what), self._cell.needed_rig()
        trial = self._known.pop(what, None)
        if trial is None or trial.calibration != rig.calibration_id:
            trial = _Trial(what, job, encode_message(job), rig.calibration_id)
        elif trial.job is not job and trial.content != (content := encode_message(job)):
            before, trial = trial, _Trial(what, job, content, rig.calibration_id)
            trial.scatters = before.scatters  # the light is the same
        self._known[what] = trial
        while len(self._known) > MOST_KNOWN:
            oldest = next(known for known in self._known if known != self._tried)
            del self._known[oldest]
        return trial

    async def _job(self, what: What) -> Job:
        if what.teaching is not None:
            return await self._draft(what.teaching)
        if what.job is None:
            raise UserError("which job is to be tried?")
        return self._cell.job(what.job)

    def _setup(self, trial: _Trial) -> TrialSetup:
        rig, bounds = self._cell.needed_rig(), self._cell.files.config.limits.bounds()
        return TrialSetup(rig.content, rig.path, trial.content, bounds, self._cell.convention)

    def _document(self) -> TrialDocument:
        trial = self._known.get(self._tried)
        return TrialDocument(on=False) if trial is None else trial.document(on=self.is_on)

    def _tell(self) -> TrialDocument:
        document = self._document()
        self._cell.notices.publish("trial", document.model_dump(mode="json"))
        return document

    # --- still test ------------------------------------------------------------------------------

    async def _hold_still(
        self, trial: _Trial, token: str, pictures: int, author: str, progress: Progress
    ) -> None:
        stands: list[StillSample | None] = []
        for number in range(pictures):
            progress(f"picture {number + 1} of {pictures}", number, pictures)
            pair = await self._cell.session.capture(token)
            images = pair.images
            stands.append(await self._cell.worker.run("stand", self._setup(trial), images))
            if stands[-1] is None:
                break
        judged: StillResult = await self._cell.worker.run("still", self._setup(trial), stands)
        now = now_text()
        found = still_document(judged, trial.job.name, trial.calibration, now, author)
        await asyncio.to_thread(self._kept.write, found)
        self._cell.notices.publish("still", {"id": "last", **found.model_dump(mode="json")})
