"""Cameras, light and focus on the set-up page."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.browser import browser
from helpers.browsersession import PASSWORD
from helpers.needs import needs, needs_aravis
from helpers.setuppage import SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, go, log_in, press, said, take_over
from helpers.stagecell import staged

from edged.commands.stage import USER

pytestmark = [pytest.mark.slow, needs_aravis(), needs("chromium")]

TILES = '[...document.querySelectorAll(".tile")].map((tile) => tile.innerText.replaceAll("\\n", " "))'
PICTURE = 'document.querySelector(".view canvas:not([hidden])")'
STRIPED = """(() => { const canvas = document.querySelector(".stripes");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let red = 0;
  for (let i = 0; i < data.length; i += 4) red += data[i] > 200 && data[i + 1] < 50 && data[i + 3] > 200;
  return red; })()"""
UNREAD = """(() => { const whole = (window.whole = fetch);
  window.fetch = (path, ...more) => {
    if (!String(path).includes("cameras/settings")) return whole(path, ...more);
    window.fetch = whole;
    window.refused = true;
    return Promise.resolve(new Response('{"code": "capture", "detail": ""}', { status: 503 }));
  }; })()"""
"""Make reading the cameras' settings fail once, as if none is chosen yet."""
LEFT_EXPOSURE = "document.querySelector('[name=left-exposure_us]').value"
RIGHT_EXPOSURE = "document.querySelector('[name=right-exposure_us]').value"
ADVICE = r"/px wide|Exposure is good|Set \d/.test(document.body.innerText)"  # "Set up" is a tab of the page


@pytest.mark.long
async def test_cameras_are_told_apart_by_a_wave_and_set_with_their_own_limits(tmp_path: Path) -> None:
    """A user assigns the cameras by a wave, sets exposure within their limits, and sees light and focus;
    axe finds nothing, and all fits a phone."""
    async with staged(tmp_path) as newcomer, browser() as page:
        await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
        await press(page, "Take over")
        await page.until('document.querySelector("dialog[open]")')
        await page.click("dialog[open] .primary")
        await page.until('document.querySelector(".lease.mine")')

        await go(page, "cameras")
        await page.until(f"{TILES}.length === 2")
        assert "EDGED-VIRTUAL-L" in (await page.value(TILES))[0]
        assert "left camera" in (await page.value(TILES))[0]
        await page.until(PICTURE)
        await page.value(UNREAD)
        await press(page, "Search again")
        await page.until("window.refused && fetch === window.whole")
        await page.value("new Promise((done) => setTimeout(done, 2500))")
        assert not await page.value('Boolean(document.querySelector(".trouble"))')
        await newcomer.ask("PUT", "stage", {"waving": "right"})
        await press(page, "I wave now")
        await page.until(said("left and right have been exchanged"))
        await page.until(f'{TILES}[0].includes("right camera")')
        await newcomer.ask("PUT", "stage", {"waving": "none", "showing": "board", "still": True})
        await press(page, "Take a test pair")
        await page.until(said("ms between the two exposures"))
        await page.until('[...document.querySelectorAll(".pair img")].every((image) => image.complete)')
        await page.until(said("packets of "))
        assert "firmware" in (await page.value(TILES))[0]
        await press(page, "Test the packets")
        await page.until(said("10 of 10 pairs came."))
        await page.until(said("bytes, none lost"))
        assert await page.value(said("edged triggers each camera by a command"))
        assert [] == await page.violations()
        assert [] == await page.value(SMALL_TARGETS)

        await go(page, "light")
        await page.until(said("First put a board or a part"))
        await page.until("document.querySelector('[name=left-exposure_us]')?.value === '2000'")
        assert not await page.value(ADVICE)
        await press(page, "It is there")
        await page.until(said("px wide"))
        await page.until("document.querySelector('[name=left-exposure_us]')?.value === '2000'")
        await page.type("[name=left-exposure_us]", "0,5")
        await page.until(said("A number from 10 to 1000000 µs"))
        await page.type("[name=left-exposure_us]", "60000,0")
        await page.until(f"{LEFT_EXPOSURE} === '60000'")
        await page.until(said("Set 24000 µs"))  # of what was read back
        await page.until(f"{STRIPED} > 100")
        await page.until(said("Something is clipped"))
        await press(page, "Same settings for the right camera")
        await page.until(f"{RIGHT_EXPOSURE} === '60000'")
        await page.value(
            "document.querySelector('[aria-label=\"Settings of the left camera\"] [type=range]').focus()"
        )
        await page.ask("Input.dispatchKeyEvent", type="keyDown", key="Home", windowsVirtualKeyCode=36)
        await page.until(f"{LEFT_EXPOSURE} === '10'")
        assert [] == await page.violations()
        assert [] == await page.value(SMALL_TARGETS)

        await newcomer.ask("PUT", "stage", {"showing": "nothing"})  # its pictures are quicker
        for step in ("cameras", "light"):
            await page.open(f"{newcomer.origin}/setup?pseudo#/{step}", 360, 740)
            await page.until(PICTURE)
            assert [] == await page.value(UNTRANSLATED), step
            assert 0 == await page.value(TOO_WIDE), step
        assert [] == page.complaints


async def test_no_picture_stays_when_the_cell_is_given_back(tmp_path: Path) -> None:
    """The last live pair is not left there like a present one: the page says what shows the next."""
    async with staged(tmp_path, gige=False) as newcomer, browser() as page:
        await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
        await take_over(page)
        await go(page, "light")
        await page.until(PICTURE)
        await press(page, "It is there")
        await page.until(ADVICE)
        await press(page, "Give it back")
        await page.click("dialog[open] .primary")
        await page.until(said("No picture: take the cell to see its cameras."))
        assert not await page.value(f"Boolean({PICTURE})")
        assert not await page.value(ADVICE)
        assert await page.value(said("Take the cell to set exposure and gain: its cameras are needed."))
        assert not await page.value(said("the camera reports no limits"))
        await go(page, "cameras")
        assert not await page.value(f"Boolean({PICTURE})")
