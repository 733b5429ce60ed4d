"""Recorded cycles in a real browser: a failed one beside a good one, what-if trials, a test before use."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.needs import needs
from helpers.recordedcell import RecordingCell, exposures, record
from helpers.setuppage import DIALOG, SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, go, log_in, press, said
from helpers.smallcell import SmallCell

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.files.golden import golden_file, load_golden
from edged.files.images import load_image
from edged.files.recording import find, load_picture
from edged.files.rig import rig_text
from edged.setup.calibration.drafts import Drafts, Solution
from edged.setup.cellfiles import read_cell

pytestmark = [pytest.mark.slow, needs("chromium")]
VIEWS = """[...document.querySelectorAll(".recorded")]
  .map((e) => e.getAttribute("viewBox").split(" ").map(Number))"""
ROWS = """[...document.querySelectorAll(".features tbody tr")]
  .map((e) => e.innerText.replaceAll(/\\s+/g, " "))"""
VERDICTS = """[...document.querySelectorAll(".scroll.wide .status")].map((e) => e.innerText.trim())"""
LINES = """[...document.querySelectorAll(".cycles .status")].map((e) => e.innerText.trim())"""
THUMBNAILS = """[...document.querySelectorAll(".cycle .small")]
  .map((e) => e.querySelector("img")?.naturalWidth ?? 0)"""
GOOD = 3
"""Number of good cycles; they are followed by one with too large a sigma, one without a part, one without
pictures."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Callable[[], RecordingCell]:
    """Makes a cell with five recorded cycles, and a draft of a rig with another baseline."""
    folder = tmp_path_factory.mktemp("cycles")
    small = SmallCell(folder / "template", source="virtual-inprocess")
    job = small.config.parent / "jobs" / "flange" / "job.toml"
    job.write_text(job.read_text().replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.02"))
    files, pairs = read_cell(small.config), exposures(small.virtual, GOOD)
    rng = np.random.default_rng(1)

    def noisy(image: Image, share: float) -> Image:
        return np.clip(image * share + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)

    def pair(share: float) -> FramePair:
        left, right = (replace(one, image=noisy(one.image, share)) for one in (pairs[0].left, pairs[0].right))
        return FramePair(left, right)

    record(folder / "recordings", files, [*pairs, pair(0.15), pair(0.02), None])
    relation = files.rig.right_from_left.copy()
    relation[:3, 3] *= 1.02
    wide = replace(files.rig, right_from_left=relation, calibration_id="wide")
    number = iter(range(100))

    def made() -> RecordingCell:
        one = RecordingCell(folder / f"cell{next(number)}", small.config.parent, folder / "recordings", pairs)
        draft = Drafts(one.state / "drafts").create(
            "Anna", ("chessboard:11x8:4",), None, "brown", datetime.now(UTC)
        )
        figures = {
            "stereo_rms_px": 0.1,
            "held_out": None,
            "sigma_um": None,
            "grade": "good",
            "moved_um": None,
        }
        draft.solve(Solution(wide.calibration_id, rig_text(wide), b"<html>", figures))
        return one

    return made


@asynccontextmanager
async def on_the_page(
    made: Callable[[], RecordingCell],
    width: int = 1280,
    height: int = 900,
    place: str = "/setup#/cycles",
    there: str = 'document.querySelector(".cycle")',
) -> AsyncIterator[tuple[Browser, RecordingCell]]:
    """Anna's page; fails if its console shows any error."""
    async with made().running() as cell, browser() as page:
        await log_in(page, f"http://127.0.0.1:{cell.port}", "Anna", PASSWORD, place, (width, height))
        await page.until(there)
        yield page, cell
        assert [] == page.complaints


async def look(page: Browser, status: str) -> None:
    """Open the newest cycle with this status."""
    await page.value(
        f"""(() => {{ const all = [...document.querySelectorAll(".cycle")];
        all.find((e) => e.innerText.includes({status!r})).click(); }})()"""
    )
    await page.until('document.querySelector("#cycle")')


@pytest.mark.long
async def test_a_failed_cycle_is_understood_and_a_rig_tested_before_its_use(
    cell: Callable[[], RecordingCell],
) -> None:
    """A failed cycle is shown beside a good one at the same zoom, feature by feature; a remedy is tried at
    once, and a reload shows the same cycle. A rig is tested on all cycles, naming good ones that become
    bad with their pictures, and used only with a signed reason, after which no job is taught from older
    cycles.
    """
    async with on_the_page(cell) as (page, cell):
        assert ["No pictures", "No part", "Not good", "OK", "OK", "OK"] == await page.value(LINES)
        await page.until(f"({THUMBNAILS}).join() === '0,160,160,160,160,160'")
        when = await page.value('[...document.querySelectorAll(".cycle .figure")].map((e) => e.innerText)')
        assert all(re.search(r"\d:\d\d:\d\d", one) for one in when), when
        await page.choose('select[name="reason"]', "SIGMA_LIMIT")
        await page.until(f"({LINES}).length === 1")
        await look(page, "Not good")
        await page.until(f"({VIEWS}).length === 4")
        views = await page.value(VIEWS)
        assert 1 == len({(round(w, 3), round(h, 3)) for _, _, w, h in views})
        assert all(w < 320 for _, _, w, _ in views)
        (row,) = await page.value(ROWS)
        assert row.startswith("c0 circle 28.0")
        await page.click("button.quiet")
        await page.until('document.querySelectorAll(".feature.lit").length === 4')
        await press(page, "Whole picture")
        await page.until(f"({VIEWS}).every(([x, y, w]) => w === 320)")

        await press(page, "What would have helped?")
        await page.until('document.querySelector(".tile h4")')
        assert await page.value(said("instead of 20.0 µm"))
        await press(page, "Try this")
        await page.until(f"({VERDICTS}).join() === 'Not good,OK'")
        await page.value("window.isOld = true")
        await page.ask("Page.reload")
        await page.until('!window.isOld && document.querySelector("#cycle")')
        assert await page.value(said("too uncertain"))
        await press(page, "Close")

        before = cell.rig.read_bytes()
        await page.until('document.querySelector(".lines li button")')
        await press(page, "Test on all cycles")
        await page.until('document.querySelector("#result")')
        assert await page.value(said(f"{GOOD} good cycles become bad."))
        await page.until('[...document.querySelectorAll(".changed img")].some((e) => e.naturalWidth === 320)')
        await press(page, "Use it")
        await page.until(DIALOG)
        assert await page.value(said(f"{GOOD} recorded cycles that were good would become bad."))
        await page.type("dialog[open] [name=note]", "another board")
        assert await page.value('document.querySelector("dialog[open] .primary").disabled')
        await page.type("dialog[open] [name=signed]", "these parts are gone")
        await press(page, "Sign: Use it")
        await page.until('!document.querySelector(".use")')
        assert before != cell.rig.read_bytes()
        await go(page, "system")
        await page.until(said("another board"))
        await press(page, "What differs")
        await page.until(said("Calibration demo → wide"))

        await go(page, "cycles")
        await look(page, "OK")
        await page.until(said("it was measured with another calibration than the present one"))
        button = (
            '[...document.querySelectorAll("button")].find((e) => e.innerText === "Teach from this cycle")'
        )
        assert await page.value(f"{button}.disabled")


async def test_a_job_is_taught_from_a_recorded_cycle(cell: Callable[[], RecordingCell]) -> None:
    """The new draft has the cycle's pair exactly, and the Teach page opens it, also after a reload."""
    async with on_the_page(cell) as (page, cell):
        await look(page, "OK")
        count = int(await page.value('document.querySelector("#cycle").textContent.match(/[0-9]+/)[0]'))
        await press(page, "Teach from this cycle")
        await page.until("""document.querySelector('main[data-page="teach"] .editor')""")
        (folder,) = (cell.state / "teachings").iterdir()
        assert folder.name == await page.value('localStorage.getItem("edged.teaching")')
        taken = load_image(folder / "pictures" / "left.png")
        recorded = find(cell.config.parent / "recordings", count)
        assert recorded is not None
        assert np.array_equal(load_picture(recorded.path, "left"), taken)
        await page.value("window.isOld = true")
        await page.ask("Page.reload")
        await page.until("""!window.isOld && document.querySelector('main[data-page="teach"] .editor')""")


@pytest.mark.long
async def test_whoever_renames_a_job_that_an_editor_has_changed_signs_for_it(
    cell: Callable[[], RecordingCell],
) -> None:
    """Renaming alone needs no signature, but activating another editor's change with it does, in the same
    dialog, which is accessible and shows other errors.
    """
    async with on_the_page(cell, place="/setup#/jobs", there='document.querySelector(".job")') as (
        page,
        cell,
    ):
        job = cell.config.parent / "jobs" / "flange" / "job.toml"
        text = job.read_text()
        dialog = 'document.querySelector("dialog[open]").innerText'
        await press(page, "Name and number")
        await page.until(DIALOG)
        await page.type("dialog[open] [name=number]", "7")
        await page.type("dialog[open] [name=note]", "as the plant counts")
        await page.click("dialog[open] .primary")
        await page.until(f"!{DIALOG} && document.querySelector('.job .count').textContent === '7'")

        for count, note in (("1", "not after all"), ("7", "after all")):  # undone and redone
            await press(page, "Undo")
            await page.until(f"{DIALOG}.querySelector('[name=number]').value === '{count}'")
            await page.type("dialog[open] [name=note]", note)
            await page.click("dialog[open] .primary")
            await page.until(f"!{DIALOG} && document.querySelector('.job .count').textContent === '{count}'")

        job.write_text(job.read_text().replace("max_sigma_mm = 0.02", "max_sigma_mm = 0.0001"))
        await press(page, "Duplicate")
        await page.until(DIALOG)
        await page.type("dialog[open] [name=job]", "flange")
        await page.type("dialog[open] [name=note]", "one more")
        await page.click("dialog[open] .primary")
        await page.until(f"{dialog}.includes('There is a job flange already')")
        await page.click("dialog[open] .actions button")
        await page.until(f"!{DIALOG}")

        await press(page, "Name and number")
        await page.until(DIALOG)
        await page.type("dialog[open] [name=number]", "9")
        await page.type("dialog[open] [name=note]", "as the plant counts")
        await page.click("dialog[open] .primary")
        await page.until(f"{dialog}.includes('It was not tested on the 5 recorded cycles that it concerns.')")
        assert [] == await page.violations()
        assert [] == await page.value(SMALL_TARGETS)
        assert await page.value('document.querySelector("dialog[open] .primary").disabled')
        await page.type("dialog[open] [name=signed]", "tighter from now on")
        await press(page, "Sign: Name and number")
        await page.until(f"!{DIALOG} && document.querySelector('.job .count').textContent === '9'")
        assert text != job.read_text()
        await go(page, "system")
        await page.until(said("tighter from now on"))
        assert ["422", "409"] == [one.partition("status of ")[2][:3] for one in page.complaints]
        page.complaints.clear()  # the browser's own word for what was refused


@pytest.mark.long
async def test_everybody_can_use_it(cell: Callable[[], RecordingCell]) -> None:
    """With all that it may show, narrow and wide: axe finds nothing, all fits, fingers find every target, and
    no word is written into the page.
    """
    async with on_the_page(cell, 360, 740, "/setup?pseudo#/cycles") as (page, _):
        await page.value('document.querySelectorAll(".cycle")[2].click()')
        await page.until('document.querySelector("#cycle")')
        await page.click("main .primary")
        await page.until('document.querySelector(".tile .actions")')
        await page.click(".tile .actions button")
        await page.until('document.querySelector(".scroll.wide")')
        await page.value('document.querySelectorAll("main details").forEach((e) => (e.open = true))')
        await page.until('document.querySelector(".lines li button")')
        await page.click(".lines li button")
        await page.until('document.querySelector("#result")')
        assert [] == await page.value(UNTRANSLATED)
        for width, height in ((360, 740), (1280, 900)):
            await page.ask(
                "Emulation.setDeviceMetricsOverride",
                width=width,
                height=height,
                deviceScaleFactor=1,
                mobile=False,
            )
            assert [] == await page.violations()
            assert 0 == await page.value(TOO_WIDE)
            assert [] == await page.value(SMALL_TARGETS)


async def test_a_button_beside_a_job_keeps_where_its_part_lies(cell: Callable[[], RecordingCell]) -> None:
    """The page says that it is kept, or why not; the page stays fit for everybody."""
    async with on_the_page(cell, place="/setup#/jobs", there='document.querySelector(".job")') as (
        page,
        cell,
    ):
        place = golden_file(cell.config.with_name("rig.json"), 1)
        place.parent.write_text("in the way")
        dialog = 'document.querySelector("dialog[open]").innerText'
        await press(page, "Golden part")
        await page.until(DIALOG)
        await page.click("dialog[open] .primary")
        await page.until(f"{dialog}.includes('cannot be')")
        page.complaints.clear()  # of the refusal
        place.parent.unlink()
        await page.click("dialog[open] .primary")
        await page.until(f"{dialog}.includes('is kept')")
        assert "flange" == load_golden(place).job
        assert [] == await page.violations()
        assert ([], 0) == (await page.value(SMALL_TARGETS), await page.value(TOO_WIDE))
