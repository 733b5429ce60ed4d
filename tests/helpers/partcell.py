"""A daemon with a rig and no jobs whose cameras see a drawn part, and a browser session that teaches it."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from edged.domain.arrays import Image
from edged.files.rig import save_rig
from edged.sim.cell import demo_part
from helpers.boardcell import BoardCell
from helpers.cells import flange, pictures, pose, scene


@functools.cache
def turned(turn_deg: float) -> tuple[Image, Image]:
    """Pair of the flange in another place, turned by this angle; read-only."""
    return pictures(flange().rig, scene((demo_part(), pose((4.0, 3.0, 205.0), turn_deg))), seed=5)


class PartCell(BoardCell):
    """A cell with the flange before its cameras."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        save_rig(self.rig, flange().rig)
        self.config.write_text(self.config.read_text().replace('job = "none"\n', ""))
        self.world.shown = flange().left, flange().right

    async def take(self) -> dict[str, str]:
        """Enter setup and return the lease's token."""
        _, entered = await self.ask("POST", "/setup", {"name": "Anna"})
        return {"token": entered["token"]}

    async def begun(self, **how: Any) -> dict[str, Any]:
        """Create a draft and wait for its proposal."""
        status, draft = await self.ask("POST", "/teachings", how)
        assert 201 == status, draft
        return await self.learnt(draft["id"])

    async def learnt(self, identity: str) -> dict[str, Any]:
        """Wait until the proposal of a draft is complete, and return it."""
        return dict(await self.until(f"/teachings/{identity}", lambda draft: draft["proposing"] is None))

    async def change(self, method: str, draft: dict[str, Any], path: str, body: Any) -> dict[str, Any]:
        """Make a change that must be accepted, and return the draft once it has been processed."""
        status, answer = await self.ask(method, f"/teachings/{draft['id']}{path}", body)
        assert 200 == status, answer
        return await self.learnt(draft["id"])
