"""The status page in a real browser: what can be clicked, zoomed and read, on a screen and on a phone."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Awaitable, Callable
from dataclasses import replace

import numpy as np
import pytest
from browser import Browser, browser
from cells import flange, frame_pair
from snapshots import make_snapshot, make_target
from wire.test_web import sources

from edged.adapters.web import WebPublisher, WebSettings
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import ExposureDone
from edged.domain.measurement import Reject, Status
from edged.vision.geometry.rectification import make_rectification

pytestmark = pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium")

BOX = 'document.querySelector("#largeleft").getAttribute("viewBox").split(" ").map(Number)'
OPEN = 'document.querySelector("#viewer").open'


def fill(web: WebPublisher) -> None:
    """Six good cycles, two alike that were refused, and one with a long reason."""
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


def on_the_page(
    test: Callable[[Browser, WebPublisher], Awaitable[None]],
    width: int = 1400,
    height: int = 900,
    limit_mm: float = 0.2,
) -> None:
    """Run a test on a filled page; nothing may be refused by its own security policy, or fail unseen."""

    async def bounded() -> None:
        rectification = make_rectification(flange().rig)
        asked = replace(sources(), rectification=lambda: rectification, limits=lambda: {1: limit_mm})
        web = WebPublisher("cell", WebSettings(port=0), asked)
        await web.start()
        try:
            fill(web)
            async with asyncio.timeout(60), browser() as page:
                await page.open(f"http://127.0.0.1:{web.port}/", width, height)
                await page.until('document.querySelector("#left image[href]")')
                await test(page, web)
                assert [] == page.complaints
        finally:
            await web.close()

    asyncio.run(bounded())


def test_thumbnails_open_and_zoom_with_wheel_buttons_and_keys() -> None:
    """A click enlarges a cycle; both pictures show the same part; the next cycle keeps it; Escape closes."""

    async def test(page: Browser, _web: WebPublisher) -> None:
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

    on_the_page(test)


def test_a_fault_opens_with_its_reason_and_its_count() -> None:
    """The first of two alike has its pictures; the live picture opens, too, and what comes later is newer."""

    async def test(page: Browser, web: WebPublisher) -> None:
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

    on_the_page(test)


def test_the_sigma_has_a_bar_with_a_remedy_for_each_part() -> None:
    """As long as the sigma, each part by its share of the variance; what is beyond the limit is said."""
    target = make_target()
    x, y, z = 1e3 * np.sqrt(np.diag(target.covariance)[:3])
    known = replace(target, by_edges=0.36 * target.covariance)

    async def test(page: Browser, web: WebPublisher) -> None:
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

    on_the_page(test, limit_mm=(y + z) / 2e3)


@pytest.mark.parametrize("width", [390, 768, 1400])
def test_nothing_is_wider_than_the_window(width: int) -> None:
    """Neither the page nor the enlarged pictures, which two fingers zoom."""
    overflow = "Math.max(document.documentElement.scrollWidth - innerWidth, 0)"

    async def test(page: Browser, _web: WebPublisher) -> None:
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

    on_the_page(test, width, 844)
