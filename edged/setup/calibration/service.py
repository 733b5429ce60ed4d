"""Calibration drafts in a running cell: live pairs are analysed, views taken, and solved in the worker.

The cell's event loop and the stream of pictures never wait for it: live pairs that arrive while the worker is
busy are skipped.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np

from edged import __version__
from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.errors import CalibrationError, EdgedError, FileFormatError, SetupRefused
from edged.setup.calibration.documents import DraftDocument, guided_in, shown_in
from edged.setup.calibration.drafts import Draft, Drafts, Looks, Solution
from edged.setup.calibration.guidance import (
    FIRST_SHARE,
    Ghost,
    GhostSelector,
    Guided,
    first_ghosts,
    held_share,
    nearness,
    wait_reason,
)
from edged.setup.calibration.model import DraftState, ViewState
from edged.setup.calibration.shown import Stillness, Watched, corners_in_space
from edged.setup.documents import DraftHead
from edged.setup.drafts import Latest, OpenDrafts, trouble_in
from edged.setup.inuse import CellInUse
from edged.setup.pairs import Progress
from edged.vision.boards.board import NominalBoard
from edged.vision.boards.detection import agreed_board, of_size
from edged.vision.calibration.lenschoice import LensWish
from edged.vision.geometry.camera import StereoRig

log = logging.getLogger(__name__)

FUNCTIONS = {
    "watch": "edged.setup.calibration.shown:watch",
    **{name: f"edged.setup.calibration.drafts:{name}" for name in ("keep_pair", "look_again")},
    **{
        name: f"edged.setup.calibration.work:{name}"
        for name in ("guide", "solve", "check_board", "check_part")
    },
}
OTHERS_EVERY_S = 2.0
LOOKS_THAT_AGREE = 2
"""Number of live pairs that must show the same board before the draft takes it."""


@dataclass(eq=False, slots=True)
class OpenCalibration:
    """An open draft. looks : the boards found in its stored pairs, as far as known.

    share : as `held_share` when the board was first seen.  auto : token of the lease under which pairs are
    taken automatically; None if they are not.
    """

    draft: Draft
    guide: Latest[Guided | None] = field(init=False)
    looks: dict[str, Looks] = field(default_factory=dict)
    watched: Watched | None = None
    still: bool = False
    waits: str = "no_board"
    stillness: Stillness = field(default_factory=Stillness)
    patience: GhostSelector = field(default_factory=GhostSelector)
    recognised: list[NominalBoard] = field(default_factory=list)
    task: str | None = None
    fault: Exception | None = None
    looked_for_others_s: float = -math.inf
    share: float | None = None
    auto: str | None = None
    is_gone: bool = False

    @property
    def is_busy(self) -> bool:
        """Whether it is being solved, or suggestions are being computed."""
        return self.task is not None or self.guide.is_running

    @property
    def guided_by(self) -> tuple[object, ...]:
        """Inputs that the suggestions depend on."""
        return self.draft.state.used, self.draft.state.boards, self.draft.state.goal_um

    @property
    def ghost(self) -> Ghost | None:
        """The ghost that is offered."""
        guided = self.guide.value
        return None if guided is None else self.patience.offered(guided.ghosts)

    @property
    def outlines(self) -> list[FloatArray]:
        """Outlines (2, 4, 2) of each view in use."""
        views = [self.draft.state.views[name] for name in self.draft.state.used]
        return [_outlines(view) for view in views if view.left.outline and view.right.outline]


class Calibrations:
    """All drafts of a cell; used on its event loop."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._worker = cell.worker
        self._tasks = cell.tasks
        self._folders = Drafts(cell.folder / "drafts")
        self.drafts = OpenDrafts("draft", cell.notices, self._folders, self)
        self._watching: asyncio.Task[None] | None = None

    async def close(self) -> None:
        """Stop all work under way; drafts are on disc."""
        if self._watching is not None:
            await cancel_and_await(self._watching)
        await self.drafts.close()

    def boards_in_space(self, rig: StereoRig) -> list[tuple[str, bool, FloatArray]]:
        """Boards of the newest draft with any: name of the view, whether used, corners (4, 3), rig frame.

        In mm, as triangulated with this rig; boards whose rays do not meet are left out.
        """
        for _, state in self._folders.states():
            if isinstance(state, FileFormatError):
                continue
            found = [
                (name, name in state.used, corners_in_space(rig, _outlines(view)))
                for name, view in state.views.items()
                if view.left.outline and view.right.outline
            ]
            if seen := [(name, used, corners) for name, used, corners in found if np.isfinite(corners).all()]:
                return seen
        return []

    # --- requests ------------------------------------------------------------------------------

    async def begin(
        self, author: str, boards: tuple[str, ...], mm: float | None, goal_um: float | None, lens: LensWish
    ) -> DraftHead:
        """Begin a draft. Raises `CalibrationError` for an invalid board, and `OSError`."""
        about = (author, boards, goal_um, lens, datetime.now(UTC))
        opened = await self.drafts.begin(partial(self._folders.create, *about, mm=mm))
        return await self.go_on(opened.draft.state.id)

    async def go_on(self, identity: str) -> DraftHead:
        """Analyse live pairs for this draft from now on. Raises as `OpenDrafts.get`."""
        opened = await self.drafts.get(identity)
        for other in self.drafts.open.values():
            other.auto = other.auto if other is opened else None
        self.drafts.current = identity
        return self.drafts.publish(opened)

    async def add(self, identity: str, token: str) -> DraftHead:
        """Take a pair. Raises `SetupRefused`, `CaptureError`, `CalibrationError`."""
        opened = await self.drafts.get(identity)
        self.drafts.current = identity
        if not opened.draft.state.boards:
            raise CalibrationError("which board is it? State it, or hold it before both cameras")
        pair = await self._cell.session.capture(token)
        await self._take(opened, *pair.images)
        return self.document(opened)

    async def set_auto_capture(self, identity: str, token: str, *, on: bool) -> DraftHead:
        """Take live pairs when the board is held still, as long as the lease of this token lasts."""
        opened = await self.drafts.get(identity)
        self.drafts.current, opened.auto = identity, token if on else None
        return self.drafts.publish(opened)

    def stop_auto_capture(self, identity: str) -> None:
        """Stop taking pairs automatically for a draft; unknown ones are ignored."""
        opened = self.drafts.open.get(identity)
        if opened is not None and opened.auto is not None:
            opened.auto = None
            self.drafts.publish(opened)

    async def solve(self, identity: str) -> str:
        """Start to solve a draft, and return the task. Raises `CalibrationError` if it is being solved."""
        opened = await self.drafts.get(identity)
        if self._tasks.is_running(opened.task):
            raise CalibrationError("it is being solved")
        if not opened.draft.state.used:
            raise CalibrationError("there are no views yet")
        opened.auto = None  # no further views are needed once it is solved
        opened.task = self._tasks.start("solve", partial(self._solve, opened))
        self.drafts.publish(opened)
        return opened.task

    async def solution(self, identity: str) -> bytes:
        """Content of the rig file that a draft was solved to. Raises as `Draft.rig`, and `KeyError`."""
        return await asyncio.to_thread((await self.drafts.get(identity)).draft.rig)

    # --- live pairs ------------------------------------------------------------------------------

    def offer(self, _number: int, pair: FramePair) -> None:
        """Analyse a live pair, unless the worker is busy."""
        current = self.drafts.current
        if current is not None and self._watching is None and not self._worker.is_busy:
            self._watching = asyncio.create_task(self._watch(current, pair), name="watch")

    async def _watch(self, identity: str, pair: FramePair) -> None:
        try:
            await self._look(await self.drafts.get(identity), *pair.images)
        except KeyError:  # discarded, or its folder was removed
            if self.drafts.current == identity:
                self.drafts.current = None
        except SetupRefused:  # the lease has ended
            if (opened := self.drafts.open.get(identity)) is not None:
                opened.auto = None
        except (EdgedError, OSError) as error:
            log.warning("a live pair cannot be analysed: %s", error)
            if (opened := self.drafts.open.get(identity)) is not None:
                opened.fault = error
                self.drafts.publish(opened)
        finally:
            self._watching = None

    async def _look(self, opened: OpenCalibration, left: Image, right: Image) -> None:
        state, now_s = opened.draft.state, time.monotonic()
        boards = state.board_models
        # once views are in use the board is known; looking for any board takes longer than for one
        others = not state.used and now_s - opened.looked_for_others_s > OTHERS_EVERY_S
        opened.watched = watched = await self._worker.run("watch", left, right, boards, others)
        if others:
            opened.looked_for_others_s = now_s
        opened.still, opened.fault = opened.stillness.look(time.monotonic(), watched), None
        if watched.recognised is not None and not boards:
            await self._recognise(opened, watched.recognised)
        if opened.draft.state.boards and not opened.draft.state.used:
            if opened.share is None and watched.is_seen:
                opened.share, opened.guide.value = held_share(watched), None
            if opened.guide.value is None:
                board, share = opened.draft.state.board_models[0], opened.share or FIRST_SHARE
                opened.guide.set(Guided(None, first_ghosts(board, watched.size, 0, share)))
        opened.waits = self._waits(opened)
        if opened.guide.value is not None and opened.waits != "busy":
            opened.patience.look(now_s, opened.guide.value.ghosts, watched, still=opened.still)
        if opened.auto is not None and not opened.waits:
            await self._cell.session.renew_setup(opened.auto)
            await self._take(opened, left, right)
            opened.stillness = Stillness()
        self.drafts.publish(opened)

    def _waits(self, opened: OpenCalibration) -> str:
        if not opened.draft.state.boards:
            return "board_unknown"
        if opened.guide.is_running or self._tasks.is_running(opened.task):
            return "busy"
        return wait_reason(opened.watched, still=opened.still, ghost=opened.ghost, others=opened.outlines)

    async def _recognise(self, opened: OpenCalibration, seen: NominalBoard) -> None:
        opened.recognised = [*opened.recognised[1 - LOOKS_THAT_AGREE :], seen]
        agreed = agreed_board(opened.recognised) if len(opened.recognised) == LOOKS_THAT_AGREE else None
        mm = opened.draft.state.mm
        if agreed is not None and mm is not None:
            await asyncio.to_thread(opened.draft.set_boards, [str(of_size(agreed, mm))])
            opened.guide.refresh()

    # --- views -----------------------------------------------------------------------------------

    async def _take(self, opened: OpenCalibration, left: Image, right: Image) -> None:
        """Store a pair as the next view."""
        async with self.drafts.changing(opened):
            draft = opened.draft
            name = draft.next_view
            order = (draft.folder, name, left, right, draft.state.board_models)
            looks, *seen = await self._worker.run("keep_pair", *order)
            await asyncio.to_thread(draft.add, name, *seen)
            opened.looks[name] = looks
        self.drafts.publish(opened)

    async def _known(self, opened: OpenCalibration, **progress: Progress) -> dict[str, Looks]:
        """Boards found in the views in use; pairs from before a restart are analysed again."""
        draft = opened.draft
        unknown = [name for name in draft.state.used if name not in opened.looks]
        if unknown:
            order = (draft.pictures, unknown, draft.state.board_models)
            opened.looks |= await self._worker.run("look_again", *order, **progress)
        return {name: opened.looks[name] for name in draft.state.used}

    async def _guided(self, opened: OpenCalibration) -> Guided | None:
        state = opened.draft.state
        if not state.used:
            return None
        try:
            views = (opened.draft.pictures, state.board_models, await self._known(opened))
            wanted = (state.lens, state.goal_um, opened.outlines, opened.share or FIRST_SHARE)
            guided: Guided = await self._worker.run("guide", *views, *wanted)
        except EdgedError as error:
            return Guided(error, ())
        return guided

    async def _solve(self, opened: OpenCalibration, progress: Progress) -> None:
        draft, state = opened.draft, opened.draft.state
        looks = await self._known(opened, progress=progress)
        made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}"
        about = {"pictures": f"{len(looks)} pairs, taken on the page", "made": made}
        order = (draft.pictures, state.board_models, looks, state.lens, self._cell.rig(), about)
        solution: Solution = await self._worker.run("solve", *order, progress=progress)
        async with self.drafts.changing(opened):
            if draft.state.used != state.used:
                raise CalibrationError("the views have changed meanwhile: solve it again")
            await asyncio.to_thread(draft.solve, solution)
        self.drafts.publish(opened)

    # --- the topic of `drafts` -------------------------------------------------------------------

    def opened(self, draft: Draft) -> OpenCalibration:
        """Open a draft for work."""
        opened = OpenCalibration(draft)
        compute, tell = partial(self._guided, opened), partial(self.drafts.publish, opened)
        opened.guide = Latest(None, lambda: opened.guided_by, compute, tell)
        if not draft.state.used:
            opened.guide.set(None)
        return opened

    def refresh(self, opened: OpenCalibration) -> None:
        """Update the suggestions if the views in use have changed."""
        opened.guide.refresh()

    async def stop(self, opened: OpenCalibration) -> None:
        """Stop computing suggestions and solving."""
        if self._tasks.is_running(opened.task):
            await self._tasks.cancel(str(opened.task))
        await opened.guide.stop()

    def summary(self, state: DraftState) -> dict[str, Any]:
        """A draft in the list."""
        solved = state.solved is not None
        about = {"boards": list(state.boards), "views": len(state.used), "solved": solved}
        return {**about, "active": self._is_active(state), "current": state.id == self.drafts.current}

    def _is_active(self, state: DraftState) -> bool:
        rig, solved = self._cell.rig(), state.solved
        return rig is not None and solved is not None and rig.calibration_id == solved.calibration_id

    def document(self, opened: OpenCalibration) -> DraftDocument:
        """Full document of a draft."""
        state, guided, watched, ghost = opened.draft.state, opened.guide.value, opened.watched, opened.ghost
        return DraftDocument(
            **state.head,
            **guided_in(state, guided, ghost),
            auto=opened.auto is not None,
            waits=opened.waits or None,
            shown=shown_in(watched),
            still=opened.still,
            in_ghost=round(nearness(watched, ghost), 3) if watched and ghost else 0.0,
            trouble=trouble_in(opened.fault or (None if guided is None else guided.trouble)),
            guiding=opened.guide.is_running,
            task=opened.task if self._tasks.is_running(opened.task) else None,
            active=self._is_active(state),
            current=state.id == self.drafts.current,
        )


def _outlines(view: ViewState) -> FloatArray:
    return np.array([view.left.outline, view.right.outline], dtype=np.float64)
