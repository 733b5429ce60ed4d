"""A robot's program on the pages: its steps go to the draft of their own registration."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from edged.setup.inuse import CellInUse
from edged.setup.registration.program import MOST_WAITING, RobotProgram
from edged.setup.registration.service import Registrations


class SlowDrafts:
    """Drafts whose first one takes until `may_begin` is set; poses : draft of each pose that was added."""

    def __init__(self) -> None:
        self.may_begin = asyncio.Event()
        self.asked, self.posed = asyncio.Event(), asyncio.Event()
        self.begun: list[str] = []
        self.poses: list[str] = []

    async def adopt(self, *_: object) -> str:
        """Begin a draft, and give its name."""
        self.asked.set()
        await self.may_begin.wait()
        self.begun.append(f"draft {len(self.begun)}")
        return self.begun[-1]

    async def adopt_pose(self, draft: str, *_: object) -> None:
        """Add a pose to a draft."""
        self.poses.append(draft)
        self.posed.set()


async def test_a_registration_that_begins_while_steps_wait_has_a_draft_of_its_own() -> None:
    """With a full queue its beginning is not dropped, and no pose of it goes to the former draft."""
    drafts = SlowDrafts()
    cell = cast(CellInUse, SimpleNamespace(brand="fanuc"))
    program = RobotProgram(cast(Registrations, drafts), cell)
    nothing: Any = None
    try:
        program.begun("fixed", "poses", "", 1.0)
        await drafts.asked.wait()
        for _ in range(MOST_WAITING + 5):
            program.posed(nothing, np.eye(4))
        program.begun("fixed", "poses", "", 1.0)
        program.posed(nothing, np.eye(4))
        await asyncio.sleep(0)
        drafts.may_begin.set()
        await drafts.posed.wait()
        assert (["draft 0", "draft 1"], {"draft 1"}) == (drafts.begun, set(drafts.poses))
    finally:
        await program.close()
