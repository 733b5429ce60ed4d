"""A calibration, and its check, on the page that sets a cell up, with the virtual stage's board in a hand."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from browser import browser
from browsersession import PASSWORD
from setuppage import SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, go, log_in, press, said, take_over
from stagecell import Newcomer, run

from edged.commands.stage import USER
from edged.files.rig import save_rig
from edged.sim.cell import demo_rig

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium"),
]

VIEWS = 'document.querySelectorAll(".strip li").length'
USED = 'document.querySelectorAll(".strip li:not(.unused)").length'
OUTLINE = 'document.querySelectorAll(".seen polygon").length === 2'
GHOST = 'document.querySelector(".ghost polygon")'

GAUGES = '[...document.querySelectorAll(".gauge")].map((one) => one.getAttribute("class"))'
CHECK_STEP = """document.querySelector('a[href="#/check"] .state').textContent.trim()"""


def test_views_are_taken_left_out_and_found_again_after_a_reload(tmp_path: Path) -> None:
    """The seen board and the next one are drawn over the pictures; what was begun goes on anywhere."""

    async def test(newcomer: Newcomer) -> None:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with browser() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await take_over(page)
            await go(page, "calibrate")
            await page.until(said("Which board?"))
            assert [] == await page.violations()
            await page.click(".choice:nth-child(2)")
            await page.type("[name=mm]", "4,0")
            await press(page, "Begin")
            await page.until(said("chessboard:11x8:4"))
            await page.until(OUTLINE)
            await page.until(GHOST)
            await press(page, "Take this view now")
            await page.until(f"{VIEWS} === 1")
            await page.until(
                '[...document.querySelectorAll(".strip img")].every((image) => image.naturalWidth)'
            )
            await press(page, "Leave out")
            await page.until(f"{USED} === 0")
            assert 1 == await page.value(VIEWS)
            await press(page, "Undo")
            await page.until(f"{USED} === 1")
            assert [] == await page.violations()
            assert [] == await page.value(SMALL_TARGETS)

            await page.open(f"{newcomer.origin}/setup?pseudo#/calibrate", 360, 740)
            await page.until(f"{USED} === 1")
            await page.until(OUTLINE)
            assert [] == await page.value(UNTRANSLATED)
            assert 0 == await page.value(TOO_WIDE)
            assert [] == page.complaints

    run(tmp_path, test, gige=False)


def test_a_check_says_in_words_and_shapes_whether_the_calibration_holds(tmp_path: Path) -> None:
    """The board is stated once; what is wrong has a remedy; the step is ticked by the verdict alone."""
    true = demo_rig()
    relation = true.right_from_left.copy()
    relation[:3, 3] *= 1.005
    save_rig(tmp_path / "rig.json", replace(true, right_from_left=relation, calibration_id="wide"))

    async def test(newcomer: Newcomer) -> None:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with browser() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await take_over(page)
            await go(page, "check")
            await page.type("[name=mm]", "4,0")
            await press(page, "Check now")
            await page.until(said("The calibration does not hold."))
            assert await page.value(said("First measure the squares of the board"))
            assert ["gauge ok", "gauge not_ok"] == await page.value(GAUGES)
            assert "look again" == await page.value(CHECK_STEP)

            save_rig(tmp_path / "rig.json", true)
            assert await newcomer.daemon.reload()
            await page.ask("Page.reload")
            await page.until(said("That was another calibration than the one in use"))
            assert "not known here" == await page.value(CHECK_STEP)
            await press(page, "Check now")
            await page.until(said("The calibration holds."))
            assert ["gauge ok", "gauge ok"] == await page.value(GAUGES)
            assert "done" == await page.value(CHECK_STEP)
            assert [] == await page.violations()
            assert [] == await page.value(SMALL_TARGETS)

            await page.open(f"{newcomer.origin}/setup?pseudo#/check", 360, 740)
            await page.until('document.querySelector(".checked .gauge")')
            assert [] == await page.value(UNTRANSLATED)
            assert 0 == await page.value(TOO_WIDE)
            assert [] == page.complaints

    run(tmp_path, test, gige=False)
