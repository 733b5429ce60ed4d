"""Reference marks on the setup page: taught, checked in each state, and in the audit."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.boardcell import BoardCell
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.markedplate import AT, MIDDLE, pair, taught
from helpers.setuppage import SMALL_TARGETS, TOO_WIDE, log_in, press

from edged.domain.arrays import SIDES, Image
from edged.files.marks import marks_file, marks_of, save_marks
from edged.files.rig import save_rig
from edged.sim.cell import demo_rig
from edged.sim.inprocess import InProcessCamera
from edged.sim.marksplate import marks_plate
from edged.sim.render.scene import PlacedPart
from edged.vision.geometry.rigid import transform
from edged.vision.marks.frame import parse_frame

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium"),
]
Images = tuple[Image, Image]


class MarkedBoardCell(BoardCell):
    """The demo's rig before a plate of marks. taught : they are beside the rig already."""

    def __init__(self, folder: Path, *, taught_before: bool) -> None:
        super().__init__(folder)
        save_rig(self.rig, demo_rig())
        if taught_before:
            save_marks(marks_file(self.rig), replace(taught(), rig=demo_rig()))
        self.config.write_text(self.config.read_text().replace('job = "none"\n', ""))
        self.world.shown = pair(AT, 0)
        expose = self.world._exposure  # noqa: SLF001 -- of a helper, for larger pictures
        self.world.in_process_cameras = lambda: tuple(
            InProcessCamera(side, expose(index), width=1280, height=960) for index, side in enumerate(SIDES)
        )


@asynccontextmanager
async def on_page(cell: MarkedBoardCell, size: tuple[int, int] = (1280, 1500)) -> AsyncIterator[Browser]:
    """The page of the marks, with the cell taken."""
    async with cell.running(), browser() as page:
        await log_in(page, f"http://127.0.0.1:{cell.port}", "Anna", PASSWORD, "/setup#/marks", size)
        await page.click(".lease .primary")  # a cell without jobs asks no question
        await page.until('document.querySelector(".lease.mine")')
        yield page


def covered(images: Images, marks: range) -> Images:
    """Cover some marks with a dark sheet."""
    found = [image.copy() for image in images]
    for index, image in enumerate(found):
        for mark in marks:
            x, y = taught().pixels[index, mark].round().astype(int)
            cv2.rectangle(image, (int(x) - 60, int(y) - 60), (int(x) + 60, int(y) + 60), 30, -1)
    return found[0], found[1]


def displaced(images: Images, mark: int, px: int) -> Images:
    """Move one mark: copy its surroundings beside its place."""
    found = [image.copy() for image in images]
    for index, image in enumerate(found):
        x, y = taught().pixels[index, mark].round().astype(int)
        patch = images[index][y - 45 : y + 45, x - 45 : x + 45]
        image[y - 45 : y + 45, x - 45 + px : x + 45 + px] = patch
    return found[0], found[1]


@dataclass(frozen=True)
class Sight:
    """A view of the cameras, and what the page says about it. rows : marks that agree, disagree, are
    unseen."""

    images: Callable[[], Images]
    says: str
    results: str
    rows: tuple[int, int, int]


def elsewhere(x_mm: float) -> Images:
    """The plate (or the rig) moved along x."""
    return pair(transform(np.eye(3), np.add(MIDDLE, (x_mm, 0.0, 0.0))), 25)


def mirrored(images: Images) -> Images:
    """Both images mirrored."""
    left, right = (np.ascontiguousarray(image[:, ::-1]) for image in images)
    return left, right


def larger(size: float) -> Images:
    """Codes of this cell on a plate of another size."""
    return pair(AT, 26, instead=PlacedPart(marks_plate(parse_frame("60x52:8:2:40"), size), AT))


SIGHTS = {
    "good": Sight(lambda: pair(AT, 20), "The marks agree", "Results are given", (8, 0, 0)),
    "shifted": Sight(lambda: elsewhere(0.05), "The marks agree", "Results are given", (8, 0, 0)),
    "knocked": Sight(lambda: elsewhere(4.0), "A camera, the rig or the plate", "No results", (8, 0, 0)),
    "doubtful": Sight(
        lambda: displaced(pair(AT, 22), 3, 1), "Marks contradict each other", "Results are given", (7, 1, 0)
    ),
    "covered": Sight(
        lambda: covered(pair(AT, 23), range(5)), "Too few marks are seen", "Results are given", (3, 0, 5)
    ),
    "another cell's": Sight(
        lambda: pair(AT, 21, first=100), "Marks contradict each other", "No results", (0, 0, 8)
    ),
    "mirrored": Sight(
        lambda: mirrored(pair(AT, 27)), "Too few marks are seen", "Results are given", (0, 0, 8)
    ),
    "larger": Sight(lambda: larger(1.02), "Marks contradict each other", "No results", (0, 8, 0)),
    "two plates": Sight(
        lambda: pair(
            AT,
            24,
            PlacedPart(
                marks_plate(parse_frame("60x52:8:2:40")),
                transform(np.eye(3), np.add(MIDDLE, (9.0, 4.0, -0.2))),
            ),
        ),
        "The marks agree",
        "Results are given",
        (7, 0, 1),
    ),
    "all covered": Sight(
        lambda: covered(pair(AT, 28), range(8)), "Too few marks are seen", "Results are given", (0, 0, 8)
    ),
}


@pytest.mark.long
async def test_each_state_is_said_and_drawn(tmp_path: Path) -> None:
    """Good, shifted, knocked, one mark moved, covered, and foreign plates each have their texts and results;
    EDGED_SHOTS keeps pictures of them."""
    cell = MarkedBoardCell(tmp_path, taught_before=True)
    async with on_page(cell) as page:
        await page.until('document.querySelector("main .primary:not([disabled])")')
        for name, sight in SIGHTS.items():
            cell.world.shown = sight.images()
            await page.value('document.querySelector("main [role=status]")?.setAttribute("data-old", "")')
            await press(page, "Look at the marks now")
            await page.until('document.querySelector("main .big.figure")?.innerText.length')
            await page.until(f"document.querySelector('main').innerText.includes({sight.says!r})")
            await page.until(f"document.querySelector('main').innerText.includes({sight.results!r})")
            rows = await page.value(
                "[...document.querySelectorAll('table.marks tbody tr')]"
                ".map((row) => row.lastElementChild.innerText.trim())"
            )
            words = "agrees", "disagrees, left out", "not seen"
            assert sight.rows == tuple(rows.count(word) for word in words), name
            if shots := os.environ.get("EDGED_SHOTS"):
                await asyncio.sleep(1.0)  # wait for the live picture
                (Path(shots) / f"marks-{name.replace(' ', '-')}.png").write_bytes(await page.picture())
        assert not await page.value(TOO_WIDE)
        assert [] == await page.value(SMALL_TARGETS)
        assert [] == await page.violations()
        assert [] == page.complaints


@pytest.mark.long
async def test_marks_are_taught_by_the_page_and_stand_in_the_audit(tmp_path: Path) -> None:
    """Marks are in use at once and equal those of the command; a picture without marks teaches none and keeps
    the old ones."""
    cell = MarkedBoardCell(tmp_path, taught_before=False)
    async with on_page(cell) as page:
        await page.until("document.querySelector('main').innerText.includes('No marks of this calibration')")
        blank = np.full((960, 1280), 90, np.uint8)
        shown, cell.world.shown = cell.world.shown, (blank, blank)
        await press(page, "Take 50 pictures and teach")
        await page.until("document.querySelector('main').innerText.includes('The marks were not taught')")
        assert "0 reference marks are in both pictures" in await page.value("document.body.innerText")
        assert not marks_file(cell.rig).exists()
        cell.world.shown = shown
        await press(page, "Take 50 pictures and teach")
        await page.until("document.querySelector('progress')?.value > 0.5")  # twice: beside much else
        await page.until("document.querySelector('main').innerText.includes('8 marks taught')")
        await page.until("document.querySelector('main').innerText.includes('Results are corrected by')")
        found = marks_of(marks_file(cell.rig).read_bytes(), marks_file(cell.rig), demo_rig())
        assert found is not None
        np.testing.assert_allclose(found.pixels, taught().pixels, atol=0.05)
        await press(page, "Look at the marks now")
        await page.until("document.querySelector('main').innerText.includes('The marks agree')")
        _, told = await cell.ask("GET", "/audit")
        deeds = [
            (one["user"], one["verb"], one["outcome"]) for one in told["records"] if "marks" in one["object"]
        ]
        assert [("Anna", "POST", "ok")] * 2 == deeds[:2]
