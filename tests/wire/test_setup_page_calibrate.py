"""A calibration on the page that sets a cell up, with the virtual stage's board in a hand."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from browser import browser
from setuppage import SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, go, log_in, press, said
from stagecell import PASSWORD, Newcomer, run

from edged.commands.stage import USER

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium"),
]

VIEWS = 'document.querySelectorAll(".strip li").length'
USED = 'document.querySelectorAll(".strip li:not(.unused)").length'
OUTLINE = 'document.querySelectorAll(".seen polygon").length === 2'
GHOST = 'document.querySelector(".ghost polygon")'


def test_views_are_taken_left_out_and_found_again_after_a_reload(tmp_path: Path) -> None:
    """The seen board and the next one are drawn over the pictures; what was begun goes on anywhere."""

    async def test(newcomer: Newcomer) -> None:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with browser() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await press(page, "Take over")
            await page.until('document.querySelector("dialog[open]")')
            await page.click("dialog[open] .primary")
            await page.until('document.querySelector(".lease.mine")')

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
