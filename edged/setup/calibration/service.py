"""Drafts of calibrations in a running cell: live pairs are looked at, views taken, and solved in the worker.

The loop of the cell and the stream of pictures never wait for any of it: a live pair that comes while the
worker is busy is not looked at.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from edged import __version__
from edged.cell.lease.notices import Notices
from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.errors import CalibrationError, EdgedError, FileFormatError, SetupRefused
from edged.setup.calibration.documents import (
    DraftDocument,
    DraftLine,
    DraftList,
    shown_in,
    sigma,
    solved_in,
    suggestions_in,
    trouble_in,
    views_in,
)
from edged.setup.calibration.drafts import Draft, Drafts, Looks, Solution
from edged.setup.calibration.guidance import (
    FIRST_SHARE,
    Ghost,
    Guided,
    first_ghosts,
    held_share,
    nearness,
    waits_for,
)
from edged.setup.calibration.model import DraftState, ViewState
from edged.setup.calibration.shown import Stillness, Watched
from edged.setup.jobs.tasks import Tasks
from edged.setup.jobs.worker import Worker
from edged.setup.pairs import Progress
from edged.vision.boards.board import NominalBoard
from edged.vision.boards.detection import agreed_board, of_size
from edged.vision.calibration.lenschoice import LensWish

log = logging.getLogger(__name__)

FUNCTIONS = {
    name: f"edged.setup.calibration.work:{name}"
    for name in ("watch", "keep", "look_again", "guide", "solve", "check_board", "check_part")
}
OTHERS_EVERY_S = 2.0
LOOKS_THAT_AGREE = 2
"""Live pairs that must show the same board before it is the draft's."""
PLACE = "/api/v1/calibrations"


@dataclass(eq=False, slots=True)
class _Open:
    """A draft that is worked on. looks : what its kept pairs show, as far as it is known."""

    draft: Draft
    looks: dict[str, Looks] = field(default_factory=dict)
    guided: Guided | None = None
    guided_of: tuple[object, ...] = ()  # what `guided` was made of
    guiding: asyncio.Task[None] | None = None
    watched: Watched | None = None
    still: bool = False
    waits: str = "no_board"
    stillness: Stillness = field(default_factory=Stillness)
    recognised: list[NominalBoard] = field(default_factory=list)
    task: str | None = None
    fault: Exception | None = None
    looked_for_others_s: float = -math.inf
    share: float | None = None  # how large the board was when it was first held
    auto: str | None = None  # the token of who wants pairs to be taken by themselves
    is_gone: bool = False  # discarded: what is still under way for it is told nobody

    @property
    def wanted(self) -> tuple[object, ...]:
        """What suggestions depend on."""
        return self.draft.state.used, self.draft.state.boards, self.draft.state.goal_um

    @property
    def ghost(self) -> Ghost | None:
        """Where the board is wanted."""
        return self.guided.ghosts[0] if self.guided is not None and self.guided.ghosts else None

    @property
    def outlines(self) -> list[FloatArray]:
        """(2, 4, 2) of the views in use."""
        views = [self.draft.state.views[name] for name in self.draft.state.used]
        return [_outlines(view) for view in views if view.left.outline and view.right.outline]


class Calibrations:
    """All drafts of a cell; used on its event loop.

    capture : an exposure, for the token of who has the cell. renew : raises `SetupRefused` for another token.
    rig : the file of the rig in use. is_active : whether a calibration is the one in use.
    """

    def __init__(
        self,
        folder: Path,
        worker: Worker,
        tasks: Tasks,
        notices: Notices,
        capture: Callable[[str], Awaitable[FramePair]],
        renew: Callable[[str], None],
        rig: Callable[[], Path],
        is_active: Callable[[str], bool],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._drafts = Drafts(folder)
        self._worker = worker
        self._tasks = tasks
        self._notices = notices
        self._capture = capture
        self._renew = renew
        self._rig = rig
        self._is_active = is_active
        self._clock_s = clock_s
        self._open: dict[str, _Open] = {}
        self._current: str | None = None
        self._taking = asyncio.Lock()
        self._watching: asyncio.Task[None] | None = None

    async def close(self) -> None:
        """Nothing is done any more; drafts are on disc."""
        running = [one.guiding for one in self._open.values() if one.guiding is not None]
        running += [] if self._watching is None else [self._watching]
        await cancel_and_await(*running)

    # --- what is asked -----------------------------------------------------------------------

    async def begin(
        self, author: str, boards: tuple[str, ...], mm: float | None, goal_um: float | None, lens: LensWish
    ) -> DraftDocument:
        """A new draft. Raises `CalibrationError` for what is no board, `OSError` for a disc that refuses."""
        now = datetime.now(UTC)
        draft = await asyncio.to_thread(self._drafts.create, author, boards, goal_um, lens, now, mm)
        self._open = {name: one for name, one in self._open.items() if one.task or one.guiding}
        self._open[draft.state.id] = _Open(draft)
        return await self.go_on(draft.state.id)

    async def go_on(self, identity: str) -> DraftDocument:
        """Let it be the one that live pairs are looked at for. Raises as `document`."""
        one = await self._opened(identity)
        for other in self._open.values():
            if other is not one:
                other.auto = None
        self._current = identity
        return self._tell(one)

    async def remove(self, identity: str) -> None:
        """Discard a draft, and what is under way for it. Raises `KeyError`."""
        async with self._taking:  # a view that is being kept is kept before
            await asyncio.to_thread(self._drafts.remove, identity)
            one = self._open.pop(identity, None)
        if self._current == identity:
            self._current = None
        self._notices.publish("draft", {"id": identity, "gone": True})
        if one is not None:
            one.is_gone = True
            if self._tasks.is_running(one.task):
                await self._tasks.cancel(str(one.task))
            if one.guiding is not None:
                await cancel_and_await(one.guiding)

    async def listed(self) -> DraftList:
        """All of them."""
        states = await asyncio.to_thread(self._drafts.states)
        return DraftList(calibrations=[self._line(*one) for one in states])

    async def document(self, identity: str) -> DraftDocument:
        """One of them. Raises `KeyError`, and `FileFormatError` for one that cannot be read."""
        one = await self._opened(identity)
        self._current = self._current or identity
        return self._document(one)

    async def add(self, identity: str, token: str) -> DraftDocument:
        """Take a pair. Raises `SetupRefused`, `CaptureError`, `CalibrationError`."""
        one = await self._opened(identity)
        self._current = identity
        if not one.draft.state.boards:
            raise CalibrationError("which board is it? State it, or hold it before both cameras")
        pair = await self._capture(token)
        await self._take(one, pair.left.image, pair.right.image)
        return self._document(one)

    async def change(self, identity: str, change: Callable[[Draft], None]) -> DraftDocument:
        """Anything else that a draft can. Raises what it raises."""
        one = await self._opened(identity)
        self._current = identity
        async with self._taking:
            _check_there(one)
            await asyncio.to_thread(change, one.draft)
        self._guide(one)
        return self._tell(one)

    async def take_by_itself(self, identity: str, token: str, *, on: bool) -> DraftDocument:
        """Take live pairs when the board is held still, for as long as this token's owner has the cell."""
        one = await self._opened(identity)
        self._current, one.auto = identity, token if on else None
        return self._tell(one)

    async def solve(self, identity: str) -> str:
        """Begin to solve it; returns the task. Raises `CalibrationError` while it is being solved."""
        one = await self._opened(identity)
        if self._tasks.is_running(one.task):
            raise CalibrationError("it is being solved")
        if not one.draft.state.used:
            raise CalibrationError("there are no views yet")
        one.task = self._tasks.start("solve", partial(self._solve, one))
        self._tell(one)
        return one.task

    async def solution(self, identity: str) -> tuple[Draft, bytes]:
        """A draft and the rig that it was solved to. Raises as `Draft.rig`, and `KeyError`."""
        draft = (await self._opened(identity)).draft
        return draft, await asyncio.to_thread(draft.rig)

    async def draft(self, identity: str) -> Draft:
        """Raises `KeyError`, and `FileFormatError` for one that cannot be read."""
        return (await self._opened(identity)).draft

    async def tell(self, identity: str) -> None:
        """Tell every page how a draft is now: whether it is active is not its own doing."""
        self._tell(await self._opened(identity))

    # --- live pairs ------------------------------------------------------------------------------

    def offer(self, _number: int, pair: FramePair) -> None:
        """Look at a live pair, unless something else is being done."""
        if self._current is not None and self._watching is None and not self._worker.is_busy:
            self._watching = asyncio.create_task(self._watch(self._current, pair), name="watch")

    async def _watch(self, identity: str, pair: FramePair) -> None:
        try:
            await self._look(await self._opened(identity), pair.left.image, pair.right.image)
        except KeyError:  # somebody discarded it, or removed its folder
            if self._current == identity:
                self._current = None
        except SetupRefused:  # somebody else has the cell by now
            if identity in self._open:
                self._open[identity].auto = None
        except (EdgedError, OSError) as error:
            log.warning("a live pair cannot be looked at: %s", error)
            if identity in self._open:
                self._open[identity].fault = error
                self._tell(self._open[identity])
        finally:
            self._watching = None

    async def _look(self, one: _Open, left: Image, right: Image) -> None:
        state, now_s = one.draft.state, self._clock_s()
        boards = state.board_models
        # a board that was seen once is not another one; and looking for any takes longer than for one
        others = not state.used and now_s - one.looked_for_others_s > OTHERS_EVERY_S
        one.watched = watched = await self._worker.run("watch", left, right, boards, others)
        if others:
            one.looked_for_others_s = now_s
        one.still, one.fault = one.stillness.look(self._clock_s(), watched), None
        if watched.recognised is not None and not boards:
            await self._recognise(one, watched.recognised)
        if one.draft.state.boards and not one.draft.state.used:
            if one.share is None and watched.is_seen:
                one.share, one.guided = held_share(watched), None
            if one.guided is None:
                board, share = one.draft.state.board_models[0], one.share or FIRST_SHARE
                one.guided = Guided(None, first_ghosts(board, watched.size, 0, share))
        one.waits = self._waits(one)
        if one.auto is not None and not one.waits:
            self._renew(one.auto)
            await self._take(one, left, right)
            one.stillness = Stillness()
        self._tell(one)

    def _waits(self, one: _Open) -> str:
        if not one.draft.state.boards:
            return "board_unknown"
        if one.guiding is not None or self._tasks.is_running(one.task):
            return "busy"
        return waits_for(one.watched, still=one.still, ghost=one.ghost, others=one.outlines)

    async def _recognise(self, one: _Open, seen: NominalBoard) -> None:
        one.recognised = [*one.recognised[1 - LOOKS_THAT_AGREE :], seen]
        agreed = agreed_board(one.recognised) if len(one.recognised) == LOOKS_THAT_AGREE else None
        mm = one.draft.state.mm
        if agreed is not None and mm is not None:
            await asyncio.to_thread(one.draft.set_boards, [str(of_size(agreed, mm))])
            self._guide(one)

    # --- views -----------------------------------------------------------------------------------

    async def _take(self, one: _Open, left: Image, right: Image) -> None:
        """Keep a pair as the next view."""
        async with self._taking:
            _check_there(one)
            draft = one.draft
            name = draft.next_view
            looks, *seen = await self._worker.run(
                "keep", draft.folder, name, left, right, draft.state.board_models
            )
            await asyncio.to_thread(draft.add, name, *seen)
            one.looks[name] = looks
        self._guide(one)
        self._tell(one)

    async def _known(self, one: _Open, progress: Progress | None = None) -> dict[str, Looks]:
        """What the views in use show; pairs of before a restart are looked at again."""
        draft = one.draft
        unknown = [name for name in draft.state.used if name not in one.looks]
        if unknown:
            more = {} if progress is None else {"progress": progress}
            boards = draft.state.board_models
            one.looks |= await self._worker.run("look_again", draft.pictures, unknown, boards, **more)
        return {name: one.looks[name] for name in draft.state.used}

    def _guide(self, one: _Open) -> None:
        """See to it that what is suggested is for the views in use."""
        if one.guiding is None and one.guided_of != one.wanted:
            one.guiding = asyncio.create_task(self._run_guide(one), name="guide")

    async def _run_guide(self, one: _Open) -> None:
        try:
            while one.guided_of != one.wanted:
                wanted, state = one.wanted, one.draft.state
                try:
                    guided = None
                    if state.used:
                        looks = await self._known(one)
                        arguments = (
                            state.board_models,
                            looks,
                            state.lens,
                            state.goal_um,
                            one.outlines,
                            one.share or FIRST_SHARE,
                        )
                        guided = await self._worker.run("guide", one.draft.pictures, *arguments)
                except EdgedError as error:
                    guided = Guided(error, ())
                one.guided, one.guided_of = guided, wanted
        finally:
            one.guiding = None
            self._tell(one)

    async def _solve(self, one: _Open, progress: Progress) -> None:
        draft = one.draft
        state = draft.state
        looks = await self._known(one, progress)
        made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}"
        about = {"pictures": str(draft.pictures), "made": made}
        arguments = (draft.pictures, state.board_models, looks, state.lens, self._rig(), about)
        solution: Solution = await self._worker.run("solve", *arguments, progress=progress)
        async with self._taking:
            _check_there(one)
            if draft.state.used != state.used:
                raise CalibrationError("views came or went meanwhile: solve it again")
            await asyncio.to_thread(draft.solve, solution)
        self._tell(one)

    # --- telling ---------------------------------------------------------------------------------

    async def _opened(self, identity: str) -> _Open:
        if identity not in self._open:
            draft = await asyncio.to_thread(self._drafts.load, identity)
            if identity not in self._open:  # nobody was quicker
                self._open[identity] = _Open(draft)
                self._guide(self._open[identity])
        return self._open[identity]

    def _line(self, identity: str, state: DraftState | FileFormatError) -> DraftLine:
        if isinstance(state, FileFormatError):
            return DraftLine(id=identity, trouble=str(state))
        return DraftLine(
            id=identity,
            boards=list(state.boards),
            views=len(state.used),
            created=state.created,
            author=state.author,
            active=state.solved is not None and self._is_active(state.solved.calibration_id),
            current=identity == self._current,
        )

    def _tell(self, one: _Open) -> DraftDocument:
        document = self._document(one)
        if not one.is_gone:
            self._notices.publish("draft", document.model_dump(mode="json"))
        return document

    def _document(self, one: _Open) -> DraftDocument:
        state, guided = one.draft.state, one.guided
        suggestions = suggestions_in(() if guided is None else guided.ghosts)
        return DraftDocument(
            id=state.id,
            revision=state.revision,
            created=state.created,
            author=state.author,
            boards=list(state.boards),
            goal_um=state.goal_um,
            auto=one.auto is not None,
            waits=one.waits or None,
            views=views_in(one.draft, guided, f"{PLACE}/{state.id}"),
            shown=shown_in(one.watched),
            still=one.still,
            in_ghost=round(nearness(one.watched, one.ghost), 3) if one.watched and one.ghost else 0.0,
            sigma_um=None if guided is None else sigma(guided.sigma_um),
            trouble=trouble_in(one.fault or (None if guided is None else guided.trouble)),
            suggestion=suggestions[0] if suggestions else None,
            suggestions=suggestions,
            more_views=None if guided is None else guided.more_views,
            guiding=one.guiding is not None,
            can_undo=state.can_undo,
            can_redo=state.can_redo,
            task=one.task if self._tasks.is_running(one.task) else None,
            solved=solved_in(one.draft),
            active=state.solved is not None and self._is_active(state.solved.calibration_id),
            current=state.id == self._current,
        )


def _check_there(one: _Open) -> None:
    """Raises `KeyError` for a draft that was discarded meanwhile."""
    if one.is_gone:
        raise KeyError(one.draft.state.id)


def _outlines(view: ViewState) -> FloatArray:
    return np.array([view.left.outline, view.right.outline], dtype=np.float64)
