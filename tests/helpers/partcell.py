"""A daemon with a rig and no jobs before a drawn part, and a browser that teaches it."""

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
    """The flange elsewhere, turned by so much; not to be changed."""
    return pictures(flange().rig, scene((demo_part(), pose((4.0, 3.0, 205.0), turn_deg))), seed=5)


class PartCell(BoardCell):
    """The flange lies before its cameras."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        save_rig(self.rig, flange().rig)
        self.config.write_text(self.config.read_text().replace('job = "none"\n', ""))
        self.world.shown = flange().left, flange().right

    async def take(self) -> dict[str, str]:
        """The token of who has the cell."""
        _, entered = await self.ask("POST", "/setup", {"name": "Anna"})
        return {"token": entered["token"]}

    async def begun(self, **how: Any) -> dict[str, Any]:
        """A new draft whose proposal is there."""
        status, draft = await self.ask("POST", "/teachings", how)
        assert 201 == status, draft
        return await self.learnt(draft["id"])

    async def learnt(self, identity: str) -> dict[str, Any]:
        """A draft that nothing is learnt for any more."""
        return dict(await self.until(f"/teachings/{identity}", lambda draft: draft["proposing"] is None))

    async def change(self, method: str, draft: dict[str, Any], path: str, body: Any) -> dict[str, Any]:
        """The draft after a change that is taken, once that is looked at."""
        status, answer = await self.ask(method, f"/teachings/{draft['id']}{path}", body)
        assert 200 == status, answer
        return await self.learnt(draft["id"])
