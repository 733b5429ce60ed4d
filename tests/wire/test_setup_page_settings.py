"""Other configuration settings, chosen on the page in a real browser, and their effect."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.browser import Browser
from helpers.engines import BROWSERS, Opener
from helpers.setuppage import (
    SMALL_TARGETS,
    TOO_WIDE,
    UNTRANSLATED,
    go,
    log_in,
    press,
    put_in_force,
    said,
    take_over,
)
from helpers.stagecell import PASSWORD, Newcomer, run

from edged.commands.stage import USER

pytestmark = pytest.mark.slow
PERIOD = '[name="cycle.period_s"]'
DRAFT = 'document.querySelector("#settings-draft")'
CHOSEN = 'document.querySelectorAll(".setting button").length'


async def use(page: Browser) -> None:
    """Put the entered settings in force."""
    await page.until(DRAFT)
    await put_in_force(page)


@pytest.mark.long
@pytest.mark.parametrize("opened", BROWSERS)
def test_a_setting_is_chosen_and_goes_back(tmp_path: Path, opened: Opener) -> None:
    """A setting is changed twice and reset, failures change nothing, and choosing connections keeps it."""

    async def test(newcomer: Newcomer) -> None:
        def config():  # type: ignore[no-untyped-def]  # the daemon's, as it is now
            return newcomer.daemon.loaded.cell.config

        async with opened() as page:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await take_over(page)
            await go(page, "settings")
            await page.until(f"document.querySelector('{PERIOD}')")
            assert not await page.value("""document.querySelector('[name="cameras.trigger.line"]')""")
            await page.type(PERIOD, "-1")
            await page.until(said("Not a value for this"))
            await page.type(PERIOD, "1,5")
            await page.choose('[name="cameras.ptp"]', "false")
            await page.until(said("cycle.period_s: 0.2 → 1.5"))
            await page.until(said("in force: 0.2"))
            await page.until("document.querySelector('.foot .primary')?.textContent === 'Use these settings'")
            assert [] == await page.violations()
            assert [] == await page.value(SMALL_TARGETS)
            assert 0.2 == config().cycle.period_s
            await page.open(f"{newcomer.origin}/setup#/settings", 1280, 900)
            await page.until(said("cycle.period_s: 0.2 → 1.5"))
            await use(page)
            await page.until(f"{CHOSEN} === 2")
            assert (1.5, False) == (config().cycle.period_s, config().cameras.ptp)

            await page.value("document.querySelectorAll('form details').forEach((one) => (one.open = true))")
            await page.type('[name="drift.warn_rows_px"]', "9")
            await page.until(said("warn_rows_px 9 is beyond invalid_rows_px 1"))
            # beside both settings that it names, and in the draft
            assert 3 == await page.value("document.querySelectorAll('.wrong').length")
            assert await page.value(f"{DRAFT}.parentElement.querySelector('.primary').disabled")
            assert (1.5, 0.5) == (config().cycle.period_s, config().drift.warn_rows_px)
            await press(page, "Discard")
            await page.until(f"!{DRAFT}")

            await press(page, "As in the file: 0.2")
            await page.until(f"{CHOSEN} === 1")
            await use(page)
            await page.until(f"{CHOSEN} === 1")
            assert (0.2, False) == (config().cycle.period_s, config().cameras.ptp)

            await go(page, "plc")
            await page.until('document.querySelector("#plc-settings ~ details")')
            await page.value('document.querySelector("#plc-settings ~ details").open = true')
            await page.type("[name=writers]", "127.0.0.1/32")
            await press(page, "Check these connections")
            await page.until(said("As chosen on this page"))
            await use(page)
            await press(page, "As in the configuration file")
            await page.until(said("As in the configuration file."))
            await use(page)
            assert config().cameras.ptp is False

            await page.open(f"{newcomer.origin}/setup?pseudo#/settings", 360, 740)
            await page.until(f"document.querySelector('{PERIOD}')")
            await page.value("document.querySelectorAll('form details').forEach((one) => (one.open = true))")
            assert [] == await page.value(UNTRANSLATED)
            assert 0 == await page.value(TOO_WIDE)
            assert [] == page.complaints

    run(tmp_path, test, gige=False)
