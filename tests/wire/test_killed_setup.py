"""kill -9 of the page, its worker and their link at every step of setting up: cell and PLC never notice.

Answered changes exist, unfinished ones do not, and the next page shows the state on disk.
"""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from helpers.browsersession import PASSWORD
from helpers.cells import small_rig
from helpers.plcwitness import Witness
from helpers.stagecell import Newcomer, staged
from helpers.waiting import until

from edged.commands.stage import USER
from edged.files.rig import load_rig, save_rig
from edged.link.cellend import CellEnd
from edged.plc.registers import StatusBit
from edged.sim.stage import stage_board
from edged.sim.views import calibration_poses

pytestmark = pytest.mark.slow
BOARD = "chessboard:11x8:4"
POSES = list(calibration_poses(small_rig(), stage_board(), 5))


def processes(module: str, parent: int | str = "self") -> list[int]:
    """Descendants of a process that run a given module of edged."""
    found: list[int] = []
    for task in Path(f"/proc/{parent}/task").glob("*/children"):
        with suppress(OSError):
            for child in task.read_text().split():
                if module.encode() in Path(f"/proc/{child}/cmdline").read_bytes():
                    found.append(int(child))
                found += processes(module, child)
    return found


@dataclass
class Cell:
    """A stage, and a user who sets it up.

    setups : periods of SETUP, in which nothing may be VALID. measuring : periods in which no cycle may be
    lost. kept : drafts that steps share.
    """

    folder: Path
    runner: asyncio.Runner
    newcomer: Newcomer
    setups: list[list[float]] = field(default_factory=list)
    measuring: list[list[float]] = field(default_factory=list)
    kept: dict[str, str] = field(default_factory=dict)

    async def ask(self, method: str, path: str, document: Any = None, expected: int = 200) -> Any:
        """Make a request to the current page."""
        return await self.newcomer.ask(method, path, document, expected)

    async def take(self) -> None:
        """Enter SETUP: the lease belongs to a session, and sessions to a page."""
        await self.newcomer.take()
        if not self.setups or self.setups[-1][1]:
            self.setups.append([time.monotonic(), 0.0])

    async def give_back(self) -> None:
        """End SETUP; its period is noted as ended just before."""
        self.setups[-1][1] = time.monotonic()
        await self.ask("DELETE", "setup", self.newcomer.token, 204)

    async def kill(self, victim: str) -> None:
        """Kill it, and wait for its replacement; a worker is started when needed."""
        if victim == "worker":
            for worker in processes("edged.setup.jobs.workerprocess"):
                os.kill(worker, signal.SIGKILL)
            return
        (before,) = processes("edged.app.page")
        if victim == "page":
            os.kill(before, signal.SIGKILL)
        else:
            for end in [found for found in gc.get_objects() if isinstance(found, CellEnd)]:
                with suppress(OSError):  # one that has ended
                    end._connection.shutdown(socket.SHUT_RDWR)  # noqa: SLF001  (as a kernel that closes it)
        await until(lambda: processes("edged.app.page") not in ([], [before]))
        await self.newcomer.browser.log_in_once_it_listens(USER, PASSWORD, lambda: True)

    async def asked_while_killed(self, victim: str, *request: Any) -> tuple[int, Any]:
        """Answer to a request that is under way when something is killed; status 0 without one."""
        asking = asyncio.create_task(self.newcomer.browser.ask(*request))
        await asyncio.sleep(0.05)
        await self.kill(victim)
        with suppress(aiohttp.ClientError):
            return await asking
        return 0, None

    async def shows_cycle(self, at_least: int) -> int:
        """Wait until the page shows this cycle or a later one, and return its number."""
        while True:
            _, status = await self.newcomer.browser.ask("GET", "/status.json")
            if status["result"] is not None and status["result"]["cycle"] >= at_least:
                return int(status["result"]["cycle"])
            await asyncio.sleep(0.1)

    async def task_of(self, place: str, document: Any) -> Any:
        """Run a task and return its document once it has ended."""
        task = (await self.ask("POST", place, document, 202))["task"]
        return await self.newcomer.until(f"tasks/{task}", lambda told: told["state"] != "running")

    def rig_on_disc(self) -> str:
        """Calibration id of the rig on disk."""
        return load_rig(self.folder / "rig.json").calibration_id


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """One cell for all tests, and a PLC that polls all the time; at the end its observations are checked."""
    folder = tmp_path_factory.mktemp("killed")
    save_rig(folder / "rig.json", replace(small_rig(), robot_from_rig=None), {"board": BOARD})
    with asyncio.Runner() as runner:
        stack = AsyncExitStack()
        newcomer = runner.run(stack.enter_async_context(staged(folder, gige=False, page_is_here=False)))
        plc = newcomer.daemon.loaded.cell.config.modbus
        assert plc is not None
        made = Cell(folder, runner, newcomer)
        with Witness(plc.port) as witness:
            runner.run(made.take())
            yield made
        runner.run(stack.aclose())
    assert {} == witness.report.wrong
    for start_s, end_s in made.setups:
        sights = witness.report.between(start_s, end_s or time.monotonic())
        assert not any(sight.valid for sight in sights)
    for start_s, end_s in made.measuring:
        sights = witness.report.between(start_s, end_s)
        assert all(StatusBit.READY in sight.bits for sight in sights)
        cycles = sorted({sight.cycle for sight in sights if sight.exposed_ns})
        assert [*range(cycles[0], cycles[-1] + 1)] == cycles


async def view(cell: Cell, draft: str, number: int) -> list[Any]:
    """Move the board to one of the calibration poses; returns the request that takes a view of it."""
    await cell.ask("PUT", "stage", {"showing": "board", "still": True})
    await cell.ask("PUT", "stage/hand", {"rig_from_board": POSES[number].tolist()})
    await cell.newcomer.until("stage", lambda told: not told["moving"])
    return ["POST", f"/api/v1/{draft}/views", cell.newcomer.token]


async def taken(cell: Cell, *request: Any) -> None:
    """Take a view; repeated if a busy machine has not rendered the picture in time."""
    status = 503
    while status == 503:
        status, answer = await cell.newcomer.browser.ask(*request)
    assert 201 == status, answer


async def calibration(cell: Cell) -> str:
    """A draft with enough views to solve, shared by the tests."""
    if "calibration" not in cell.kept:
        begun = await cell.ask("POST", "calibrations", {"boards": [BOARD], "lens": "division"}, 201)
        draft = cell.kept["calibration"] = f"calibrations/{begun['id']}"
        for number in range(len(POSES)):
            await taken(cell, *await view(cell, draft, number))
    return cell.kept["calibration"]


async def teaching(cell: Cell) -> str:
    """A draft of a job, shared by the tests."""
    if "teaching" not in cell.kept:
        await cell.ask("PUT", "stage", {"showing": "part"})
        draft = f"teachings/{(await cell.ask('POST', 'teachings', cell.newcomer.token, 201))['id']}"
        await cell.newcomer.until(draft, lambda told: told["proposing"] is None)
        cell.kept["teaching"] = draft
    return cell.kept["teaching"]


@pytest.mark.long
@pytest.mark.parametrize("victim", ["page", "link"])
async def test_a_view_is_taken_or_is_not(cell: Cell, victim: str) -> None:
    """After the kill, each view that the next page lists has both its pictures."""
    await cell.take()
    draft = f"calibrations/{(await cell.ask('POST', 'calibrations', {'boards': [BOARD]}, 201))['id']}"
    await taken(cell, *await view(cell, draft, 0))
    status, _ = await cell.asked_while_killed(victim, *await view(cell, draft, 1))
    views = (await cell.ask("GET", draft))["views"]
    assert len(views) in ((2,) if status == 201 else (1, 2))
    for each in views:
        for place in each["thumbnails"].values():
            assert 200 == (await cell.newcomer.browser.ask("GET", place))[0]
    assert "SETUP" == (await cell.ask("GET", "cell"))["state"]


@pytest.mark.long
@pytest.mark.parametrize("victim", ["worker", "page"])
async def test_a_calibration_that_was_not_solved_is_not(cell: Cell, victim: str) -> None:
    """After the kill, the draft has its views, no result and no task."""
    await cell.take()
    draft = await calibration(cell)
    before = await cell.ask("GET", draft)
    task = (await cell.ask("POST", f"{draft}/solve", {}, 202))["task"]
    await cell.newcomer.until(f"tasks/{task}", lambda told: told["text"] != "waits for its turn")
    await cell.kill(victim)
    if victim == "worker":
        ended = await cell.newcomer.until(f"tasks/{task}", lambda told: told["state"] != "running")
        assert "SIGKILL" in ended["problem"]["detail"]
    told = await cell.newcomer.until(draft, lambda draft: draft["task"] is None)
    was, now = ([(view["name"], view["used"]) for view in one["views"]] for one in (before, told))
    assert (None, was) == (told["solved"], now)


@pytest.mark.long
@pytest.mark.parametrize("victim", ["page", "link"])
async def test_a_rig_is_the_cells_or_is_not(cell: Cell, victim: str) -> None:
    """After the kill, the next page shows the calibration that is on disk."""
    draft = await calibration(cell)
    await cell.take()
    if (await cell.ask("GET", draft))["solved"] is None:
        assert "done" == (await cell.task_of(f"{draft}/solve", {}))["state"]
    note = {**cell.newcomer.token, "note": "killed"}
    status, answer = await cell.asked_while_killed(victim, "POST", f"/api/v1/{draft}/activate", note)
    told = await cell.newcomer.until("cell", lambda told: told["rig"]["id"] == cell.rig_on_disc())
    assert status != 200 or answer["rig"] == told["rig"]["id"]
    await active_release_is_the_cells(cell)


@pytest.mark.long
@pytest.mark.parametrize("victim", ["worker", "page"])
async def test_a_part_that_is_being_looked_at_is_looked_at_again(cell: Cell, victim: str) -> None:
    """After the kill, a draft has its proposal or a reason why not, and does not wait for ever."""
    await cell.take()
    await cell.ask("PUT", "stage", {"showing": "part"})
    draft = f"teachings/{(await cell.ask('POST', 'teachings', cell.newcomer.token, 201))['id']}"
    await cell.kill(victim)
    told = await cell.newcomer.until(draft, lambda told: told["proposing"] is None)
    assert told["features"] or told["trouble"]


@pytest.mark.long
@pytest.mark.parametrize("victim", ["worker", "page"])
async def test_a_trial_goes_on_or_is_off(cell: Cell, victim: str) -> None:
    """A trial survives a replaced worker, and is off after the page was replaced."""
    await cell.take()
    draft = (await teaching(cell)).removeprefix("teachings/")
    await cell.ask("PUT", "trials", {**cell.newcomer.token, "teaching": draft, "on": True})
    await cell.kill(victim)
    assert (victim == "worker") == (await cell.ask("GET", "trials"))["on"]
    await cell.take()
    await cell.ask("PUT", "trials", {**cell.newcomer.token, "on": False})


@pytest.mark.long
@pytest.mark.parametrize("victim", ["page", "link"])
async def test_a_job_is_the_cells_or_is_not(cell: Cell, victim: str) -> None:
    """After the kill, the jobs on disk and the active release agree."""
    await cell.take()
    draft = await teaching(cell)
    note = {**cell.newcomer.token, "note": "killed"}
    status, _ = await cell.asked_while_killed(victim, "POST", f"/api/v1/{draft}/activate", note)
    jobs = sorted(file.name for file in cell.folder.glob("jobs/*"))
    assert status != 200 or jobs
    await active_release_is_the_cells(cell)
    if not jobs:
        await cell.take()
        await cell.ask("POST", f"{draft}/activate", {**cell.newcomer.token, "note": "again"})


@pytest.mark.long
@pytest.mark.parametrize("victim", ["page", "link"])
async def test_a_cell_that_measures_measures_on(cell: Cell, victim: str) -> None:
    """Results continue after the kill, and the next page shows the newest."""
    await cell.take()
    await cell.ask("PUT", "stage", {"showing": "part"})
    await cell.give_back()
    await cell.newcomer.until("cell", lambda told: told["state"] == "READY")
    cell.measuring.append([time.monotonic(), 0.0])
    cycle = await cell.shows_cycle(0)
    await cell.kill(victim)
    await cell.shows_cycle(cycle + 3)
    cell.measuring[-1][1] = time.monotonic()


async def active_release_is_the_cells(cell: Cell) -> None:
    """The release shown as active has the rig on disk."""
    listed = (await cell.ask("GET", "releases"))["releases"]
    active = [release for release in listed if release["active"]]
    assert len(active) <= 1
    for release in active:
        assert cell.rig_on_disc() == release["rig"]
