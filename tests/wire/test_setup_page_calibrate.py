"""Calibration and its check on the setup page, with the virtual stage's board moved by hand."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.boardcell import BoardCell, with_views
from helpers.boardpairs import SPEC
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.cells import small_rig
from helpers.needs import needs
from helpers.setuppage import (
    SMALL_TARGETS,
    TOO_WIDE,
    UNTRANSLATED,
    discard,
    go,
    log_in,
    press,
    said,
    take_over,
)
from helpers.stagecell import Newcomer, staged
from helpers.waiting import WHOLE_S

from edged.commands.stage import USER
from edged.files.rig import save_rig

pytestmark = [pytest.mark.slow, needs("chromium")]

VIEWS = 'document.querySelectorAll(".strip li").length'
USED = 'document.querySelectorAll(".strip li:not(.unused)").length'
OUTLINE = 'document.querySelectorAll(".seen polygon").length === 2'
GHOST = 'document.querySelector(".ghost polygon")'

FOLLOWS = """[...document.querySelectorAll(".stage [aria-pressed=true]")]
  .some((button) => button.textContent.trim() === "Follow the dashed place")"""
GAUGES = '[...document.querySelectorAll(".gauge")].map((one) => one.getAttribute("class"))'
CHECK_STEP = """document.querySelector('a[href="#/check"] .state').textContent.trim()"""


async def ask_for_a_board(page: Browser, newcomer: Newcomer) -> None:
    """Open the calibration page with the cell taken, where it asks for the board."""
    await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
    await take_over(page)
    await go(page, "calibrate")
    await page.until(said("Which board?"))


@pytest.mark.long
async def test_views_are_taken_left_out_and_found_again_after_a_reload(tmp_path: Path) -> None:
    """Pictures show the board and its next place, views can be left out, and a reload keeps the draft."""
    async with staged(tmp_path, gige=False) as newcomer:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with browser() as page:
            await ask_for_a_board(page, newcomer)
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


@pytest.mark.long
async def test_the_hand_follows_until_something_else_is_laid_there(tmp_path: Path) -> None:
    """The hand stops following the drawn place once a part is laid before the cameras."""
    async with staged(tmp_path, gige=False) as newcomer:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with browser() as page:
            await ask_for_a_board(page, newcomer)
            await page.click(".choice:nth-child(2)")
            await page.type("[name=mm]", "4")
            await press(page, "Begin")
            await page.until(GHOST)
            await page.click(".stage summary")
            await press(page, "Follow the dashed place")
            await page.until(FOLLOWS)
            await press(page, "Lay the part")
            await page.until(f"!({FOLLOWS})")
            await newcomer.until("stage", lambda told: told["showing"] == "part")
            await page.value("new Promise((done) => setTimeout(done, 5000))")  # the hand looks every 4 s
            assert "part" == (await newcomer.ask("GET", "stage"))["showing"]
            assert [] == page.complaints


@pytest.mark.long
async def test_a_wrongly_chosen_board_is_put_right(tmp_path: Path) -> None:
    """After another calibration with the right board is begun, the first one is not opened again by
    itself."""
    async with staged(tmp_path, gige=False) as newcomer:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with browser() as page:
            await ask_for_a_board(page, newcomer)
            await page.click(".choice:nth-child(2)")
            await page.type("[name=columns]", "9")
            await page.type("[name=mm]", "4")
            await press(page, "Begin")
            await page.until(said("The pictures show another board than the one stated"))
            await press(page, "Take views automatically")
            await page.until(said("Stop taking views"))

            await press(page, "Begin another calibration")
            await page.until(said("Which board?"))
            (wrong,) = (await newcomer.ask("GET", "calibrations"))["calibrations"]
            assert not (await newcomer.ask("GET", f"calibrations/{wrong['id']}"))["auto"]
            await overtaken(newcomer, page, wrong["id"])
            assert await page.value(said("Which board?"))
            await page.ask("Page.reload")
            await page.until(said("Begun before"))
            assert await page.value(said("Which board?"))
            assert [] == await page.violations()
            await page.type("[name=columns]", "11")
            await press(page, "Begin")
            await page.until(said("chessboard:11x8:4"))
            await page.until(OUTLINE)
            await page.until(GHOST)
            assert [] == page.complaints


@pytest.mark.long
async def test_what_was_begun_is_gone_on_with_or_discarded(tmp_path: Path) -> None:
    """Drafts can be continued or discarded on either screen, and a later calibration contains nothing of
    them."""
    async with staged(tmp_path, gige=False) as newcomer:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        first = await newcomer.ask("POST", "calibrations", {"boards": ["chessboard:9x8:4"]}, 201)
        second = await newcomer.ask("POST", "calibrations", {"boards": ["chessboard:11x8:4"]}, 201)
        async with browser() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await take_over(page)
            await go(page, "calibrate")
            await page.until(OUTLINE)
            await discard(page)
            await page.until(said("Which board?"))
            await newcomer.ask("GET", f"calibrations/{second['id']}", expected=404)
            await press(page, "Continue")
            await page.until(said("The pictures show another board than the one stated"))
            await newcomer.ask("DELETE", f"calibrations/{first['id']}", {}, 204)
            await page.until(said("Which board?"))
            await page.until(f"!{said('Begun before')}")
            await page.click(".choice:nth-child(2)")
            await page.type("[name=mm]", "4")
            await press(page, "Begin")
            await page.until(said("chessboard:11x8:4"))
            await press(page, "Take this view now")
            await page.until(f"{VIEWS} === 1")
            assert [] == page.complaints


async def overtaken(newcomer: Newcomer, page: Browser, identity: str) -> None:
    """Wait until the page has received what was published about a draft."""
    await page.value(
        """import("/static/setup/shared/live.js")
          .then((live) => { live.told("mark"); globalThis.live = live; })"""
    )
    for goal_um in (2.0, 3.0):
        await newcomer.ask("PUT", f"calibrations/{identity}", {"goal_um": goal_um})
        newcomer.pages[-1].notices.publish("mark", {"id": goal_um})  # comes after it
        await page.until(f'live.told("mark").value?.id === {goal_um}')


@pytest.mark.long
async def test_another_calibration_is_begun_when_one_is_in_use(tmp_path: Path) -> None:
    """Another one can be begun at once, both on the page that activated the first and on one opened later."""
    cell = BoardCell(tmp_path)
    async with asyncio.timeout(WHOLE_S), cell.running(), browser() as page:
        place, token = await with_views(cell, 6)
        _, begun = await cell.ask("POST", f"{place}/solve", {})
        assert "done" == (await cell.done(begun["task"]))["state"]
        origin = f"http://127.0.0.1:{cell.port}"
        await log_in(page, origin, "Anna", PASSWORD, "/setup", (1280, 900))
        await go(page, "calibrate")
        await page.until(f"{VIEWS} === 6")
        status, _ = await cell.ask("PUT", f"{place}/auto", {"token": token, "on": True})
        assert 200 == status
        status, _ = await cell.ask("POST", f"{place}/activate", {"token": token, "note": "the first"})
        assert 200 == status
        assert not (await cell.ask("GET", place))[1]["auto"]
        await page.until(said("Take views automatically"))
        await take_over(page)
        await press(page, "Begin another calibration")
        await page.until(said("Which board?"))
        await go(page, "welcome")
        await go(page, "calibrate")
        await page.until(said("Which board?"))
        await page.type("[name=mm]", "6")
        await press(page, "Begin")
        await page.until(said(SPEC))  # the board is recognised in live pairs
        await press(page, "Take this view now")
        await page.until(f"{VIEWS} === 1")
        await discard(page)
        await page.until(said("Which board?"))
        await page.ask("Page.reload")
        await page.until(said("Which board?"))
        assert [] == page.complaints


@pytest.mark.long
async def test_another_calibration_is_begun_after_a_stop(tmp_path: Path) -> None:
    """After a restart the earlier draft is still there, can be put aside or discarded, and hinders
    nothing."""
    cell = BoardCell(tmp_path)
    async with asyncio.timeout(WHOLE_S), browser() as page:
        async with cell.running():
            await with_views(cell, 3)
        for end in ("put aside", "thrown away"):
            async with cell.running():
                await log_in(page, f"http://127.0.0.1:{cell.port}", "Anna", PASSWORD, "/setup", (1280, 900))
                await go(page, "calibrate")
                if end == "put aside":
                    await page.until(f"{VIEWS} === 3")
                    await press(page, "Begin another calibration")
                    await page.until(said("Which board?"))
                    await page.type("[name=mm]", "6")
                    await press(page, "Begin")
                    await page.until(said("Hold the board before both cameras"))
                    page.complaints.clear()  # about a socket whose cell has stopped
                else:
                    await page.until(said("Hold the board before both cameras"))
                    await discard(page)
                    await page.until(said("Which board?"))
                    await discard(page)
                    await page.until(f"!{said('Begun before')}")
                    await page.type("[name=mm]", "7")
                    await press(page, "Begin")
                    await page.until(said("Hold the board before both cameras"))


@pytest.mark.long
async def test_a_check_says_in_words_and_shapes_whether_the_calibration_holds(tmp_path: Path) -> None:
    """The board is asked for once, a wrong calibration has a remedy, and only the verdict ticks the step."""
    true = small_rig()
    relation = true.right_from_left.copy()
    relation[:3, 3] *= 1.005
    save_rig(tmp_path / "rig.json", replace(true, right_from_left=relation, calibration_id="wide"))
    async with staged(tmp_path, gige=False) as newcomer:
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
            await newcomer.browser.reload(newcomer.daemon)
            await page.ask("Page.reload")
            await page.until(said("That was a calibration other than the one in use"))
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
