"""kill -9 of a daemon during setup, step by step: the next one has everything that was answered."""

from __future__ import annotations

import asyncio
import re
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from helpers.browsersession import BrowserSession, Visitor, browsing
from helpers.ports import free_port
from helpers.waiting import WHOLE_S

from edged.commands.stage import USER
from edged.files.rig import load_rig
from edged.sim.cell import demo_rig
from edged.sim.stage import stage_board
from edged.sim.views import calibration_poses

BOARD = "chessboard:11x8:4"
POSES = list(calibration_poses(demo_rig(), stage_board(), 5))


class Stage(Visitor):
    """A user at a daemon of its own."""

    async def view(self, place: str, number: int) -> Any:
        """Hold the board at one of the careful person's poses, and take a pair."""
        await self.ask("PUT", "stage/hand", {"rig_from_board": POSES[number].tolist()})
        await self.until("stage", lambda one: not one["moving"])
        status = 503
        while status == 503:  # a picture that a busy machine has not drawn in time is taken again
            status, view = await self.browser.ask("POST", f"/api/v1/{place}/views", self.token)
        assert 201 == status, view
        return view


@asynccontextmanager
async def stage(folder: Path, ports: tuple[int, int, int]) -> AsyncIterator[Stage]:
    """The daemon, killed at the end. ports : web, Modbus, Zenoh."""
    given = [f"--{name}-port={port}" for name, port in zip(("web", "modbus", "zenoh"), ports, strict=True)]
    command = ["-m", "edged", "demo", "--stage", "--in-process", "--folder", str(folder), *given]
    process = await asyncio.create_subprocess_exec(
        sys.executable, *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL
    )
    try:
        assert process.stdout is not None
        while (said := re.search(r"password (\S+)", (await process.stdout.readline()).decode())) is None:
            pass
        async with browsing(f"http://127.0.0.1:{ports[0]}") as session:
            cell = Stage(BrowserSession(session))
            await cell.browser.log_in_once_it_listens(USER, said[1], lambda: process.returncode is None)
            yield cell
    finally:
        process.kill()
        await process.wait()


@pytest.mark.long
async def test_what_was_answered_is_there_after_each_kill(tmp_path: Path) -> None:
    """Views, draft and activated calibration survive kills while views are taken, while it is solved and
    afterwards; the cell stays in SETUP, unattended.
    """
    kept: dict[str, Any] = {}

    async def taking(cell: Stage) -> None:
        await cell.take()
        await cell.ask("PUT", "stage", {"showing": "board", "still": True})
        draft = await cell.ask("POST", "calibrations", {"boards": [BOARD], "lens": "division"}, 201)
        kept["place"] = f"calibrations/{draft['id']}"
        for number in range(3):
            kept["draft"] = await cell.view(kept["place"], number)

    async def solving(cell: Stage) -> None:
        draft = await cell.ask("GET", kept["place"])
        for name in ("revision", "boards", "views"):
            of_views = [[view["name"], view["used"]] for view in draft["views"]]
            assert [[view["name"], view["used"]] for view in kept["draft"]["views"]] == of_views
            assert name == "views" or kept["draft"][name] == draft[name]
        now = await cell.ask("GET", "cell")
        assert ("SETUP", True) == (now["state"], now["setup"]["unattended"])
        await cell.take()
        await cell.ask("PUT", "stage", {"showing": "board", "still": True})
        for number in (3, 4):
            await cell.view(kept["place"], number)
        task = (await cell.ask("POST", f"{kept['place']}/solve", {}, 202))["task"]
        await cell.until(f"tasks/{task}", lambda one: one["text"] != "waits for its turn")

    async def activating(cell: Stage) -> None:
        draft = await cell.ask("GET", kept["place"])
        assert (None, None, 5) == (draft["solved"], draft["task"], len(draft["views"]))
        assert not (tmp_path / "cell" / "rig.json").exists()
        await cell.take()
        task = (await cell.ask("POST", f"{kept['place']}/solve", {}, 202))["task"]
        ended = await cell.until(f"tasks/{task}", lambda one: one["state"] != "running")
        assert ("done", None) == (ended["state"], ended["problem"])
        kept["release"] = await cell.ask("POST", f"{kept['place']}/activate", {**cell.token, "note": "first"})

    async def running(cell: Stage) -> None:
        now = await cell.ask("GET", "cell")
        assert (kept["release"]["rig"], ["jobs"]) == (now["rig"]["id"], now["missing"])
        assert kept["release"]["rig"] == load_rig(tmp_path / "cell" / "rig.json").calibration_id
        listed = (await cell.ask("GET", "releases"))["releases"]
        assert [(1, True)] == [(one["number"], one["active"]) for one in listed]
        assert (await cell.ask("GET", kept["place"]))["active"]
        assert None is (await cell.ask("GET", "audit?most=1"))["problem"]

    ports = free_port(), free_port(), free_port()
    for one in (taking, solving, activating, running):
        async with asyncio.timeout(WHOLE_S), stage(tmp_path / "cell", ports) as cell:
            await one(cell)
