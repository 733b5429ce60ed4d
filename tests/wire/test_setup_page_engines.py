"""The pages in other browsers than Chromium."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from helpers.browser import Gone
from helpers.browsersession import PASSWORD
from helpers.engines import BROWSERS, Opener
from helpers.setuppage import DIALOG, STEPS, TOO_WIDE, log_in, press, said
from helpers.stagecell import staged

from edged.commands.stage import USER

pytestmark = pytest.mark.slow
OTHERS = pytest.mark.parametrize("opened", BROWSERS[1:])
OUTLINED = (
    'document.querySelectorAll(".seen polygon").length === 2 && document.querySelector(".ghost polygon")'
)
LIVE = 'document.querySelectorAll(".view canvas:not([hidden])").length === 2'


@OTHERS
async def test_a_person_logs_in_takes_the_cell_and_sees_every_page(tmp_path: Path, opened: Opener) -> None:
    """Live pictures come, a view is taken, no page is too wide for a phone, and its console says nothing."""
    async with staged(tmp_path, gige=False) as newcomer:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        async with opened() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await press(page, "Take over")
            await page.until(DIALOG)
            await page.click("dialog[open] .primary")
            await page.until('document.querySelector(".lease.mine")')
            for step in STEPS:
                await page.value(f'location.hash = "#/{step}"')
                await page.until(f"""document.querySelector('main[data-page="{step}"] h1')""")
                await page.resize(360, 740)
                assert 0 == await page.value(TOO_WIDE), step
                await page.resize(1280, 900)
            await page.click('.steps a[href="#/welcome"], header a[href="#/welcome"]')
            await page.click('.steps a[href="#/calibrate"]')
            await page.until(said("Which board?"))
            await page.until(LIVE)
            await page.type("[name=mm]", "4,0")
            await press(page, "Begin")
            await page.until(OUTLINED)
            await press(page, "Take this view now")
            await page.until('document.querySelectorAll(".strip li").length === 1')
            await page.until(
                '[...document.querySelectorAll(".strip img")].every((image) => image.naturalWidth)'
            )
            assert [] == page.complaints


@OTHERS
async def test_what_leaving_a_page_breaks_off_is_no_error(tmp_path: Path, opened: Opener) -> None:
    """Leaving pages while their texts or requests are loading logs no error."""
    async with staged(tmp_path, gige=False) as newcomer, opened() as page:
        await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
        for place in ("/setup", "/"):
            for wait_ms in range(0, 200, 10):
                await page.value(f"location.assign('{place}?{wait_ms}#/welcome'), 0")
                with contextlib.suppress(Gone):  # as WebKit says it of a page that is left
                    await page.value(f"new Promise((done) => setTimeout(done, {wait_ms}))")
            await page.until(f"location.pathname === '{place}' && document.querySelector('main')")
        # about an event stream not yet open Firefox says that it cannot connect
        assert [] == [one for one in page.complaints if not one.endswith("/events.")]
