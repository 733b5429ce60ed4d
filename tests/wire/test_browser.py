"""The status page in a real browser: clicking, zooming and reading, on a screen and on a phone."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from helpers.browser import Browser, browser
from helpers.cells import flange, frame_pair
from helpers.needs import needs
from helpers.setuppage import TOO_WIDE, UNTRANSLATED, come_back, freeze, leave, thaw
from helpers.snapshots import make_snapshot, make_target
from wire.test_web import sources

from edged.adapters.web import WebPublisher, WebSettings
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import ExposureDone
from edged.domain.measurement import Match, Nearest, NearMiss, NotMeasured, Reject, Status
from edged.payload import translatable
from edged.plc.registers import BLOCKS
from edged.vision.geometry.rectification import make_rectification

pytestmark = needs("chromium")

BOX = 'document.querySelector("#largeleft").getAttribute("viewBox").split(" ").map(Number)'
FACTS = {
    "Software": {"version": "1.2.3", "configuration": "12ab"},
    "Cameras": {
        "source": "gige",
        "left": [
            translatable("temperature", "41.5 °C", value="41.5"),
            translatable("clock-ptp", "clock: PTP"),
        ],
    },
    "Calibration": {"rows, mean": translatable("figure", "0.120 px", value="0.120", unit="px"), "id": "demo"},
    "Recorder": {"problem": translatable("own-words", "No space left on device")},
}
REGISTERS = [
    (register, 1)
    for block in BLOCKS
    for register in block.registers
    if not re.match(r"[TJ](?!0_)\d+_", register.name)
]
"""Of rows that are alike, only the first."""
OPEN = 'document.querySelector("#viewer").open'


def fill(web: WebPublisher) -> None:
    """Publish six good cycles, two alike that were refused, and one with a long reason."""
    pair = frame_pair(flange().left, flange().right)
    web.announce(CellState(CellPhase.READY, True, True, "flange", 1, 0))
    for cycle in range(1, 10):
        bad = cycle in (3, 4)
        targets = (make_target(Reject.SIGMA_LIMIT),) if bad else None
        web.announce(ExposureDone(cycle, None, pair))
        status = Status.LOW_QUALITY if bad else Status.OK
        web.announce(make_snapshot(cycle, status, targets))
    web.announce(replace(make_snapshot(10, Status.NO_TARGET), exposed_ns=0, published_ns=1))
    web.announce(ExposureDone(11, None, pair))
    web.announce(make_snapshot(11))


@asynccontextmanager
async def on_the_page(
    width: int = 1400, height: int = 900, limit_mm: float = 0.2, query: str = ""
) -> AsyncIterator[tuple[Browser, WebPublisher]]:
    """A filled page; fails if it violates its security policy or logs an error."""
    rectification = make_rectification(flange().rig)
    asked = replace(
        sources(),
        rectification=lambda: rectification,
        limits=lambda: {1: limit_mm},
        facts=lambda: FACTS,
        known_registers=lambda: REGISTERS,
    )
    web = WebPublisher("cell", WebSettings(port=0), asked)
    await web.start()
    try:
        fill(web)
        async with browser() as page:
            await page.open(f"http://127.0.0.1:{web.port}/{query}", width, height)
            await page.until('document.querySelector("#left image[href]")')
            yield page, web
            assert [] == page.complaints
    finally:
        await web.close()


@pytest.mark.slow
async def test_thumbnails_open_and_zoom_with_wheel_buttons_and_keys() -> None:
    """A click enlarges a cycle with both pictures in step, the next cycle keeps the zoom, Escape closes."""
    async with on_the_page() as (page, _):
        await page.until('document.querySelectorAll("#recent img").length === 8')
        await page.click("#recent li:nth-child(3) button")
        await page.until(OPEN)
        assert "cycle 8" in await page.value('document.querySelector("#viewed").textContent')
        whole = await page.value(BOX)

        await page.wheel("#largeleft", -400)
        await page.until(f"{BOX}[2] < {whole[2]} / 2")
        box = await page.value(BOX)
        assert box[0] + box[2] / 2 == pytest.approx(whole[2] / 2, abs=0.01 * whole[2])
        assert box == await page.value(BOX.replace("largeleft", "largeright"))
        assert "/picture/8/left/full" == await page.value(
            'document.querySelector("#largeleft image").getAttribute("href")'
        )

        await page.click("#newer")
        await page.until('document.querySelector("#viewed").textContent.includes("cycle 9")')
        assert box == await page.value(BOX)
        await page.press("ArrowRight")
        assert (await page.value(BOX))[0] > box[0]
        await page.press("+")
        assert (await page.value(BOX))[2] == pytest.approx(box[2] / 1.5)
        await page.press("0")
        assert whole == await page.value(BOX)
        await page.click("#larger")
        assert (await page.value(BOX))[2] == pytest.approx(whole[2] / 1.5)
        await page.click("#smaller")
        await page.press("ArrowLeft")  # nothing to move: the cycle before
        await page.until('document.querySelector("#viewed").textContent.includes("cycle 8")')
        await page.ask("Input.dispatchKeyEvent", type="keyDown", key="Escape", windowsVirtualKeyCode=27)
        await page.until(f"!{OPEN}")


async def test_the_tray_says_which_pocket_is_next_and_which_are_empty() -> None:
    """The tray's text names the next and the empty pockets; without a good part no pocket is next."""
    text = '(document.querySelector("#reading .tray")?.textContent ?? "")'
    async with on_the_page() as (page, web):
        assert "" == await page.value(text)
        found = tuple(replace(make_target(), pocket=pocket) for pocket in (2, 4))
        web.announce(replace(make_snapshot(12, targets=found), pockets=5))
        await page.until(f"{text}.length > 0")
        told = await page.value(text)
        assert "tray: 2 of 5 pockets have a part; next: 2; without a part: 1, 3, 5" == told
        web.announce(replace(make_snapshot(13, Status.NO_TARGET), pockets=2))
        await page.until(f'{text}.includes("0 of 2")')
        assert "next: –; without a part: 1, 2" in await page.value(text)


@pytest.mark.slow
async def test_a_fault_opens_with_its_reason_and_its_count() -> None:
    """A fault opens its first occurrence with count and reason, and the live picture opens as the newest."""
    async with on_the_page() as (page, web):
        assert "2 times" in await page.value('document.querySelector("#faults").textContent')
        await page.click("#faults button")
        await page.until(OPEN)
        assert "cycle 3" in await page.value('document.querySelector("#viewed").textContent')
        assert "sigma" in await page.value('document.querySelector("#viewedwhy").textContent')
        await page.click("#close")
        await page.until(f"!{OPEN}")
        await page.click("#right")
        await page.until(OPEN)
        assert "cycle 11" in await page.value('document.querySelector("#viewed").textContent')
        assert await page.value('document.querySelector("#newer").disabled')
        web.announce(ExposureDone(12, None, frame_pair(flange().left, flange().right)))
        web.announce(make_snapshot(12))
        await page.until('!document.querySelector("#newer").disabled')
        await page.click("#newer")
        await page.until('document.querySelector("#viewed").textContent.includes("cycle 12")')


@pytest.mark.slow
async def test_the_sigma_has_a_bar_with_a_remedy_for_each_part() -> None:
    """Each sigma has a bar of its length, split by share of the variance, and an exceeded limit is named."""
    target = make_target()
    x, y, z = 1e3 * np.sqrt(np.diag(target.covariance)[:3])
    known = replace(target, by_edges=0.36 * target.covariance)
    async with on_the_page(limit_mm=(y + z) / 2000.0) as (page, web):
        assert await page.value('document.querySelector("#budget").hidden')
        web.announce(make_snapshot(12, Status.OK, (known,)))
        await page.until('document.querySelectorAll("#budget .bars svg").length === 3')
        told = f"Z: {z:.1f} µm, beyond the limit: edges {0.6 * z:.1f}, calibration {0.8 * z:.1f}, "
        assert f"{told}registration 0.0, doubt 0.0" == await page.value(
            'document.querySelectorAll("#budget .bars svg")[2].getAttribute("aria-label")'
        )
        widths = await page.value(
            '[...document.querySelectorAll("#budget .bars rect")].map((one) => +one.getAttribute("width"))'
        )
        edges, calibration = widths[8:10]
        assert edges / calibration == pytest.approx(0.36 / 0.64)
        assert (edges + calibration) / sum(widths[:4]) == pytest.approx(z / x)
        assert "more views of the board" in await page.value('document.querySelector("#budget").textContent')


def fail(web: WebPublisher) -> None:
    """Publish every kind of failure that has a text of its own."""
    match, pair = Match(512.0, 300.4, 0.1, 1.0, 1.0, 0.91), frame_pair(flange().left, flange().right)
    nothing = make_snapshot(20, Status.NO_TARGET)
    web.announce(replace(nothing, dismissed=(NotMeasured(match, Reject.LEFT_RIGHT_MISMATCH),)))
    web.announce(replace(nothing, cycle=21, nearest=Nearest(lambda: NearMiss(match, 0.95))))
    web.announce(ExposureDone(22, None, pair))
    web.announce(make_snapshot(22, Status.LOW_QUALITY, (make_target(Reject.SIGMA_LIMIT | Reject.KEEP_OUT),)))
    error = {"error": "camera left: no image within 200 ms", "error_code": 104}
    web.announce(replace(make_snapshot(23, Status.CAPTURE_FAULT), **error))


def words(text: str) -> set[str]:
    """Words of three letters or more."""
    return set(re.findall(r"[^\W\d_]{3,}", text))


CODES = {
    code
    for one, _ in REGISTERS
    for names in re.findall(r"\d+ ([A-Z0-9_]+)", one.help)
    for code in words(names)
}
"""Names of bits and values, which need no translation."""
READ = """(() => {
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [...document.querySelectorAll("[aria-label]")].map((e) => e.getAttribute("aria-label"));
  for (let node; (node = texts.nextNode()); )
    if (!node.parentElement.closest("[translate=no], script, noscript")) found.push(node.textContent);
  return [...found, document.querySelector("#find").placeholder].join("\\n"); })()"""
"""All readable or spoken text, except names, values and quoted messages of the cell."""
STRETCHED = 'document.querySelector("#find").placeholder.includes("⟦")'
TEXTS = """fetch("/static/%s.ftl").then((answer) => answer.text())"""


@pytest.mark.slow
async def test_it_speaks_german_throughout() -> None:
    """After choosing German, also after a reload, every readable word is in the German texts and numbers have
    commas; in English the same holds for the English texts.
    """
    async with on_the_page() as (page, web):
        fail(web)
        web.announce(CellState(CellPhase.FAULT, False, False, "flange", 1, 0, "camera left: late", 104))
        await page.value('document.querySelector("#registers").open = true')
        await page.until('document.querySelector("#words tr")')
        for tag, badge, count in (("en", "FAULT", "41.5 °C"), ("de", "FEHLER", "41,5 °C")):
            await page.choose("#language", tag)
            await page.until(f'document.querySelector("#badge").textContent === "{badge}"')
            heals = {"en": "with the next good pair it measures again", "de": "Mit dem nächsten guten Paar"}
            await page.until(f'document.querySelector("#headline").textContent.includes("{heals[tag]}")')
            if tag == "de":
                await page.ask("Page.reload")
                await page.until(
                    'document.querySelector("#badge")?.textContent === "FEHLER"'
                    ' && document.querySelectorAll("#faults li").length > 5'
                )
            assert tag == await page.value("document.documentElement.lang")
            if tag == "de":
                await page.value('document.querySelector("#registers").open = true')
            await page.until('document.querySelectorAll("#words tr").length > 200')
            named = [one % tag for one in ("setup/%s", "run/run.%s", "run/registers.%s")]
            texts = "".join([await page.value(TEXTS % name) for name in named])
            read = await page.value(READ)
            assert len(words(read)) > 80
            assert set() == words(read) - words(texts) - CODES
            assert ("cycle number" in read) == (tag == "en")
            assert count in read


@pytest.mark.long
@pytest.mark.parametrize("width", [390, 1280])
async def test_no_word_is_written_into_the_page(width: int) -> None:
    """With marked and stretched texts, all readable text carries the mark and fits, for a good result, a bad
    one and a fault, with a cycle enlarged, and axe finds no violation.
    """
    known = replace(make_target(), by_edges=0.36 * make_target().covariance)
    async with on_the_page(width, 844, query="?pseudo") as (page, web):
        web.announce(make_snapshot(12, Status.OK, (known,)))
        await page.until('document.querySelectorAll("#budget .bars svg").length === 3')
        await page.value('document.querySelectorAll("details").forEach((one) => (one.open = true))')
        await page.until(f'document.querySelector("#words tr") && {STRETCHED}')
        assert [] == await page.value(UNTRANSLATED)
        await page.type("#find", "result")  # axe reports the same for few rows as for all
        await page.until('document.querySelectorAll("#words tr").length < 20')
        await page.until('document.querySelector("#left text")')
        assert 0 == await page.value('document.querySelectorAll("button text").length')  # none is called so
        fail(web)
        await page.until('document.querySelector("#faults").textContent.includes("200 ms")')
        assert [] == await page.value(UNTRANSLATED)
        assert 0 == await page.value(TOO_WIDE)
        assert [] == await page.violations()
        await page.click("#recent button")
        await page.until(OPEN)
        assert [] == await page.value(UNTRANSLATED)
        assert [] == await page.violations()


@pytest.mark.slow
async def test_texts_that_come_while_a_language_is_chosen_are_in_it() -> None:
    """Register texts are shown in the chosen language, whether the texts or the choice arrive first."""
    async with on_the_page() as (page, _):
        for tag, told in (("de", "Nummer des Zyklus"), ("en", "cycle number")):
            await page.choose("#language", tag)
            await page.value("""document.querySelector("#registers").open = true""")
            await page.until(f'document.querySelector("#words").textContent.includes("{told}")')


@pytest.mark.slow
async def test_a_lost_cell_is_not_shown_as_present() -> None:
    """The badge shows the lost connection, also after the language is changed."""
    async with on_the_page() as (page, web):
        await page.choose("#language", "de")
        await page.until('document.documentElement.lang === "de"')
        await web.close()
        await page.until('document.querySelector("#badge").textContent === "keine Verbindung"')
        await page.choose("#language", "en")
        await page.until('document.querySelector("#badge").textContent === "no connection"')
        page.complaints.clear()  # about the lost connection


@pytest.mark.long
@pytest.mark.parametrize("way", ["leave", "freeze"])
async def test_a_page_that_comes_back_from_the_browsers_memory_is_live_again(way: str) -> None:
    """After leaving or freezing, the page shows no connection until it returns and receives live results."""
    async with on_the_page() as (page, web):
        await page.until('document.querySelector("#badge").textContent === "OK"')
        await (leave if way == "leave" else freeze)(page)
        assert "no connection" == await page.value('document.querySelector("#badge").textContent')
        web.announce(make_snapshot(12, Status.NO_TARGET))
        await (come_back if way == "leave" else thaw)(page)
        await page.until('document.querySelector("#badge").textContent === "no target"')


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 768, 1400])
async def test_nothing_is_wider_than_the_window(width: int) -> None:
    """Neither the page nor the enlarged pictures, which pinch to zoom, are wider than the window."""
    overflow = "Math.max(document.documentElement.scrollWidth - innerWidth, 0)"
    async with on_the_page(width, 844) as (page, _):
        await page.value('document.querySelector("#registers").open = true')
        await page.until('document.querySelector("#words tr")')
        assert 0 == await page.value(overflow)
        await page.click("#recent button")
        await page.until(OPEN)
        assert 0 == await page.value(overflow)
        parts = "[...document.querySelectorAll('#viewer :not(svg *)')]"
        assert 0 == await page.value(
            f"{parts}.filter((e) => e.getBoundingClientRect().right > innerWidth).length"
        )
        whole = await page.value(BOX)
        await page.pinch("#largeleft", (40.0, 100.0))
        await page.until(f"{BOX}[2] < {whole[2]}")
        assert (await page.value(BOX))[2] == pytest.approx(whole[2] / 2.5, rel=0.05)
