"""Acceptance on the page: pictures of each test are taken, then the cell is judged by them."""

from __future__ import annotations

import asyncio
import shutil
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Literal

from edged.errors import SetupRefused, UserError
from edged.files.atomic import make_folders, write_atomically
from edged.setup.acceptance.accepting import TOUCHED_NAME
from edged.setup.acceptance.verdicts import LEAST_LENGTHS, LEAST_POSES, LEAST_STILL, LEAST_TOUCHED
from edged.setup.documents import Frozen, LastDocument, Message, now_text
from edged.setup.inuse import CellInUse
from edged.setup.pairs import Progress, write_sides
from edged.vision.part.job import Job

FUNCTIONS = {name: f"edged.setup.acceptance.work:{name}" for name in ("accept_cell", "measure_size")}
PicturedTest = Literal["still", "pose", "length"]
TestName = Literal["still", "pose", "length", "robot"]
NEEDED: dict[TestName, int] = {
    "still": LEAST_STILL,
    "pose": LEAST_POSES,
    "length": LEAST_LENGTHS,
    "robot": LEAST_TOUCHED,
}
MOST = 100
"""Most pairs of pictures of a test."""


class TestedDocument(Frozen):
    """One test. good : null if it is undecided. why : reason, in English. figures : by name."""

    name: TestName
    good: bool | None
    why: Message
    figures: dict[str, str]


class LastAcceptance(Frozen):
    """The last acceptance on the page. due : until when it is valid."""

    at: str
    by: str
    calibration: str
    passed: bool
    due: str
    tests: list[TestedDocument]


class CountedTest(Frozen):
    """Number of pictures, or lines, taken for a test, and how many are needed."""

    name: TestName
    taken: int
    needed: int


class AcceptanceDocument(Frozen):
    """State of the acceptance. is_current : the last one was of the calibration in use."""

    tests: list[CountedTest]
    last: LastAcceptance | None
    is_current: bool


class Accepting:
    """Acceptance of a cell; used on the event loop only."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._folder = cell.folder / "acceptance"
        self._kept = LastDocument(cell.folder / "accepted.json", LastAcceptance, "the last acceptance")
        self._task: str | None = None

    async def document(self) -> AcceptanceDocument:
        """State of the acceptance."""
        last = await asyncio.to_thread(self._kept.read)
        counts = await asyncio.to_thread(self._counts)
        tests = [CountedTest(name=name, taken=counts[name], needed=NEEDED[name]) for name in NEEDED]
        is_current = last is not None and last.calibration == self._cell.calibration_id
        return AcceptanceDocument(tests=tests, last=last, is_current=is_current)

    def _counts(self) -> dict[TestName, int]:
        counts: dict[TestName, int] = {
            name: len(list((self._folder / name).glob("*_left.png"))) for name in NEEDED if name != "robot"
        }
        table = self._folder / "robot" / TOUCHED_NAME
        lines = table.read_text("utf-8").splitlines() if table.is_file() else []
        return {**counts, "robot": sum(bool(line.strip()) for line in lines)}

    async def take(self, token: str, test: PicturedTest, count: int) -> str:
        """Start to take pictures of a test, and return the task. Raises `SetupRefused`."""
        await self._begin(token)
        self._cell.needed_rig("to accept")
        self._task = self._cell.tasks.start("pictures", partial(self._take, token, test, count))
        return self._task

    async def _begin(self, token: str) -> None:
        await self._cell.session.renew_setup(token)
        if self._cell.tasks.is_running(self._task):
            raise SetupRefused("an acceptance is at work")

    async def _take(self, token: str, test: PicturedTest, count: int, progress: Progress) -> None:
        folder = self._folder / test
        await asyncio.to_thread(make_folders, folder)
        for number in range(count):
            progress("take pictures", number, count)
            first = (await asyncio.to_thread(self._counts))[test]
            if first >= MOST:
                raise UserError(f"{MOST} pictures of a test are enough: begin it anew")
            pair = await self._cell.session.capture(token)
            images = pair.images
            await asyncio.to_thread(write_sides, folder, f"view_{first:03d}_{{side}}.png", images)

    async def touched(self, token: str, table: str) -> AcceptanceDocument:
        """Keep the robot's touched points: lines of rig x, y, z and robot x, y, z. Raises `SetupRefused`."""
        await self._begin(token)
        path = self._folder / "robot" / TOUCHED_NAME
        await asyncio.to_thread(make_folders, path.parent)
        await asyncio.to_thread(write_atomically, path, table.encode())
        return await self.document()

    async def clear(self, token: str, test: TestName) -> AcceptanceDocument:
        """Discard the pictures of a test. Raises `SetupRefused`."""
        await self._begin(token)
        await asyncio.to_thread(shutil.rmtree, self._folder / test, ignore_errors=True)
        return await self.document()

    async def accept(self, token: str, author: str, job: str, length: tuple[str, float] | None) -> str:
        """Start to judge the cell by what was taken; return the task. Raises `SetupRefused`, `UserError`."""
        await self._begin(token)
        part = self._cell.job(job)
        self._task = self._cell.tasks.start("accept", partial(self._accept, token, author, part, length))
        return self._task

    async def _accept(
        self, token: str, author: str, part: Job, length: tuple[str, float] | None, progress: Progress
    ) -> None:
        rig = self._cell.needed_rig()
        await asyncio.to_thread(make_folders, self._folder)
        found = await self._cell.worker.run(
            "accept_cell", rig, self._folder, part, length, author, progress=progress
        )
        await self._cell.running.keep_beside("acceptance", found["document"], token)
        await asyncio.to_thread(write_atomically, self.report, found["html"])
        last = LastAcceptance(
            at=now_text(),
            by=author,
            calibration=rig.calibration_id,
            passed=found["passed"],
            due=datetime.fromtimestamp(found["due_ns"] / 1e9, UTC).isoformat(timespec="seconds"),
            tests=[TestedDocument.model_validate(test) for test in found["tests"]],
        )
        await asyncio.to_thread(self._kept.write, last)

    @property
    def report(self) -> Path:
        """Path of the report page to sign, of the last acceptance."""
        return self._cell.folder / "accepted.html"
