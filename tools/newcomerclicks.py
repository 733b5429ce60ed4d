"""A newcomer's set-up on the page, by clicks and digits alone, in a real browser (`tools/bench newcomer`).

The hands are those of the stage, at the foot of each page, and their clicks count like all others.
"""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Protocol

from pymodbus.client import ModbusTcpClient

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from helpers.browser import Browser, browser
from helpers.engines import Opener
from helpers.setuppage import DIALOG, STATE, said
from helpers.setuppage import press as press_now

from edged.plc.registers import RESULT, Flag, decode

SIZE = (1280, 900)
SQUARE_MM = "4.0"
LEAST_S = 4.0
"""Time after which a press without an effect is repeated."""
LIMIT_S = 900.0
SAY_S = 30.0
"""Interval of messages about what is waited for."""
TOUCHES = 6
PLACES = 'document.querySelectorAll(".covered").length'
VIEWS = 'document.querySelectorAll(".strip li").length'
REACHED = '/reached/.test(document.querySelector(".big.figure")?.innerText ?? "")'
ASKED = 'document.querySelector("dialog[open] [type=password]")'
PICTURES = 'document.querySelector(".pair")?.scrollIntoView({ block: "center" })'
"""Scrolls to where a person looks meanwhile."""
BORROWED = """document.querySelector("[name=pasted]").value"""


TROUBLE = (
    """[...document.querySelectorAll(".trouble, .wrong[role=alert]")].find((e) => e.checkVisibility())"""
)
"""The message beside a button whose work failed."""
WATCH = """window.spent = {}, new PerformanceObserver((list) => {
  for (const { interactionId, duration } of list.getEntries())
    if (interactionId) spent[interactionId] = Math.max(spent[interactionId] ?? 0, duration);
}).observe({ type: "event", durationThreshold: 16 })"""
"""Records ms from a press to the picture that answers it, by the browser's own clock; not below 16 ms."""


class Watcher(Protocol):
    """Makes a film of the clicks."""

    def see(self, png: bytes, click: tuple[float, float] | None = None) -> None:
        """Take a picture, with the place of the click that comes next."""

    def is_due(self) -> bool:
        """Whether a picture is wanted though nobody clicks."""

    def end(self, step: str) -> None:
        """End a step."""


Then = Callable[[Browser, "Clicks"], Awaitable[dict[str, Any]]]


class Clicks:
    """Counts the clicks of each step; a field that is typed into counts as one, as it is clicked first."""

    def __init__(self, page: Browser, film: Watcher | None) -> None:
        self._page, self.by_step = page, dict[str, int]()
        self._begun_s = time.monotonic()
        self._before = 0
        self._film = film
        if film is not None:
            page.on_click = self._see

    def end(self, step: str) -> None:
        """End a step."""
        self.by_step[step] = self._page.clicks - self._before
        self._before = self._page.clicks
        after_s = time.monotonic() - self._begun_s
        print(f"{after_s:6.1f} s: {step}, {self.by_step[step]} clicks", file=sys.stderr)
        if self._film is not None:
            self._film.end(step)

    async def wait(self) -> None:
        """Let some time pass; a film may take a picture."""
        if self._film is not None and self._film.is_due():
            await self._page.value(PICTURES)
            self._film.see(await self._page.picture())
        await pause(self._page, 0.1)

    async def _see(self, x: float, y: float) -> None:
        if self._film is not None:
            self._film.see(await self._page.picture(), (x, y))


async def set_up(
    origin: str,
    user: tuple[str, str],
    modbus: int,
    goal_um: float,
    tried: int,
    opened: Opener = browser,
    film: Watcher | None = None,
    then: Then | None = None,
) -> dict[str, Any]:
    """Set a cell up from an empty folder until a PLC reads a VALID result; return figures by name.

    user : name and password. modbus : the cell's port. goal_um : of the calibration. tried : places.
    then : further clicks on the same page; returns their figures.
    opened : the browser. Without click durations from it, the figure is left out.
    """
    begun_s = time.monotonic()
    async with opened() as page:
        clicks = Clicks(page, film)
        await log_in(page, origin, *user)
        await page.value(WATCH)
        clicks.end("log in")
        await press(page, "Take the cell")
        await page.until('document.querySelector(".lease.mine")')
        clicks.end("take the cell")
        await page.click(".stage summary")
        clicks.end("open the stage")
        await wave(page)
        clicks.end("cameras")
        await light(page)
        clicks.end("light")
        views = await calibrate(page, clicks, goal_um, user[1])
        clicks.end("calibrate")
        calibrated_s = time.monotonic() - begun_s
        await check(page)
        clicks.end("check")
        await teach(page, user[1])
        clicks.end("teach")
        good = await try_out(page, tried)
        clicks.end("try")
        await register(page, user[1])
        clicks.end("robot")
        await go_live(page, modbus)
        if film is not None:
            film.see(await page.picture())
        clicks.end("go live")
        more = {} if then is None else await then(page, clicks)
        spent_ms = sorted(await page.value("Object.values(window.spent)"))
        complaints = page.complaints
    whole_s = time.monotonic() - begun_s
    return {
        "clicks": sum(clicks.by_step.values()),
        "clicks_of": clicks.by_step,
        "views": views,
        "calibrated_s": round(calibrated_s, 1),
        "tried_good": good,
        "whole_s": round(whole_s, 1),
        "click_ms": {
            share: _quantile(spent_ms, share, page.clicks) for share in (0.5, 0.95, 1.0) if spent_ms
        },
        "complaints": complaints,
        **more,
    }


def _quantile(spent_ms: list[float], share: float, clicks: int) -> float:
    """Quantile over all clicks; those without a recorded time took less than 16 ms."""
    all_ms = [16.0] * max(clicks - len(spent_ms), 0) + spent_ms
    return all_ms[max(math.ceil(share * len(all_ms)) - 1, 0)]


async def log_in(page: Browser, origin: str, name: str, password: str) -> None:
    """Log in by the form, to which the page leads."""
    await page.open(f"{origin}/setup", *SIZE)
    await page.until('document.querySelector("#password")')
    await page.type("#name", name)
    await page.type("#password", password)
    await page.click("button")
    await page.until('document.querySelector("main[data-page] h1")')  # the form has a heading, too
    page.complaints.clear()  # the form complains that it was typed into before it had the focus


async def follow(page: Browser, step: str) -> None:
    """Open a step by its link; from a page that is no step by way of *Set up*."""
    if not await page.value("Boolean(document.querySelector('.steps'))"):
        await page.click('a[href="#/welcome"]')
    await page.click(f'.steps a[href="#/{step}"]')
    await page.until(f"""document.querySelector('main[data-page="{step}"] h1')""")


async def release(page: Browser, text: str, password: str) -> None:
    """Press a button, and answer its question with yes and with the note that is there, or one word.

    Repeated if nothing happens, because the button was disabled for a moment. password : asked for again if
    the last time is long ago, as on a busy machine.
    """

    async def again() -> None:
        await press(page, text)
        await soon(page, DIALOG)

    await long(page, DIALOG, again)
    if not await page.value('document.querySelector("dialog[open] [name=note]").value'):
        await page.type("dialog[open] [name=note]", "first")
    await page.click("dialog[open] .primary")
    await confirm(page, password)


async def confirm(page: Browser, password: str, until: str = "true") -> None:
    """Answer further dialogs: a request for the password, and one for a signature, in any order.

    until : condition that must be met. The password may be requested some time after a dialog has closed.
    """
    signed = 'document.querySelector("dialog[open] [name=signed]")'

    async def answer() -> None:
        if await page.value(f"Boolean({ASKED})"):
            await page.type("dialog[open] [type=password]", password)
            await page.click("dialog[open] .wake .primary")
            await long(page, f"!{ASKED}")
        elif await page.value(f"{signed}?.value === ''"):
            await page.type("dialog[open] [name=signed]", "it is another one")
            await page.click("dialog[open] .primary")
        await pause(page, 0.1)

    await long(page, f"!{DIALOG} && {until}", answer)


async def wave(page: Browser) -> None:
    """Wave before the left camera, and only there."""
    await follow(page, "cameras")
    await waved(page, "The left picture moved")


async def waved(page: Browser, seen: str) -> None:
    """Wave until the page reports what it has seen; begin again if that was nothing."""
    begin = 'document.querySelector("#wave ~ .actions button")'

    async def again() -> None:
        if await page.value(f"{begin}.disabled === false"):
            await page.click_on(begin)
        await press(page, "Wave before the left camera")
        await pause(page, LEAST_S)

    await long(page, said(seen), again)


async def light(page: Browser) -> None:
    """Set the light with the board, as the page advises."""
    await press(page, "Hold the board")
    await follow(page, "light")
    if await page.value(said("It is there")):
        await press(page, "It is there")
    await long(page, 'document.querySelectorAll(".quality").length === 2')


async def calibrate(page: Browser, clicks: Clicks, goal_um: float, password: str) -> int:
    """Hold the board, take views to reach the goal, solve, activate; return the number of views."""
    await follow(page, "calibrate")
    await page.type("[name=mm]", SQUARE_MM)
    if goal_um != float(await page.value('document.querySelector("[name=goal]").value')):
        await page.type("[name=goal]", f"{goal_um:g}")
    return await to_release(page, clicks, password)


async def to_release(page: Browser, clicks: Clicks, password: str) -> int:
    """Take views of the board where it is drawn to reach the goal, solve, activate; return their number."""
    await press(page, "Begin, and take views automatically")
    await press(page, "Follow the dashed place")
    await long(page, REACHED, clicks.wait)
    views = int(await page.value(VIEWS))
    await press(page, "Solve")
    await long(page, 'document.querySelector("#solve").parentElement.querySelector("dl")')
    await release(page, "Use this calibration", password)
    await long(page, said("In use, as release"))
    return views


async def press(page: Browser, text: str) -> None:
    """Press a button, by its text, once it is enabled, however busy the machine is."""
    button = f"""[...document.querySelectorAll("button")].find((b) => b.textContent.trim() === {text!r})"""
    await long(page, f"{button}?.disabled === false")
    await press_now(page, text)


async def long(
    page: Browser, expression: str, meanwhile: Callable[[], Awaitable[None]] | None = None
) -> None:
    """Wait for something that takes the cell longer than a page may, and report what it is.

    meanwhile : called between two checks. Raises RuntimeError with the page's text if it never comes.
    """
    begun_s = told_s = time.monotonic()
    while not await page.value(f"Boolean({expression})"):
        if (now_s := time.monotonic()) - begun_s > LIMIT_S:
            raise RuntimeError(f"never true: {expression}: {await page.value('document.body.innerText')}")
        if now_s - told_s > SAY_S:
            told_s = now_s
            print(f"waits {now_s - begun_s:.0f} s for {expression}", file=sys.stderr)
        await (pause(page, 0.2) if meanwhile is None else meanwhile())


async def done(page: Browser, text: str, expression: str) -> None:
    """Press a button until it has an effect: the cameras of a busy machine may give no pair."""

    async def again() -> None:
        if await page.value(f"Boolean({TROUBLE})"):
            print(f"again: {text}: {await page.value(f'{TROUBLE}?.innerText')}", file=sys.stderr)
            if await page.value(said("Understood")):
                await press(page, "Understood")
            await press(page, text)
        await pause(page, 0.2)

    await press(page, text)
    await long(page, expression, again)


async def soon(page: Browser, expression: str) -> None:
    """Wait briefly for something that may not come."""
    begun_s = time.monotonic()
    while not await page.value(f"Boolean({expression})") and time.monotonic() - begun_s < LEAST_S:
        await pause(page, 0.1)


async def pause(page: Browser, least_s: float) -> None:
    """Let some time pass."""
    await page.value(f"new Promise((done) => setTimeout(done, {1e3 * least_s}))")


async def check(page: Browser) -> None:
    """Check the calibration with the same board."""
    await follow(page, "check")
    await done(page, "Check now", f"!{said('Measuring')} && !{TROUBLE}")
    if not await page.value(said("The calibration holds")):
        raise RuntimeError(await page.value('document.querySelector(".checked").innerText'))


async def teach(page: Browser, password: str) -> None:
    """Take one pair, and use the proposal."""
    await press(page, "Lay the part")
    await follow(page, "teach")
    await done(
        page, "Take the pair", 'document.querySelectorAll("[data-side=left] .feature.taken").length > 3'
    )
    await press(page, "Where the part is")
    await press(page, "Tap")
    await page.click("[data-side=left] .feature[data-key=c0]")
    await long(page, '!document.querySelector("progress") && document.querySelector(".feature.taken")')
    await release(page, "Use this job", password)
    await long(page, said("is in use, as release"))


async def try_out(page: Browser, tried: int) -> int:
    """Lay the part at several places; return at how many of them the page shows it as good."""
    await press(page, "Lay the part")
    await follow(page, "try")
    await press(page, "Try it live")
    await long(page, f"{PLACES} > 0")
    for _ in range(tried):
        before = await page.value(PLACES)
        await press(page, "Lay the part somewhere else")
        await soon(page, f"{PLACES} !== {before}")
    good = int(await page.value(PLACES)) - 1
    await done(page, "Hold still, 30 pictures", 'document.querySelector("main .verdict .shape")')
    return good


async def register(page: Browser, password: str) -> None:
    """Register by touching points of the board, verified by one more."""
    await press(page, "Hold the board")
    await follow(page, "robot")
    await press(page, "Begin")
    await done(page, "Take a picture of it", 'document.querySelectorAll(".robot-look .place").length > 5')
    for count in range(1, TOUCHES + 1):
        await press(page, "Stage: what the virtual robot shows")
        await long(page, BORROWED)
        await press(page, "Add this point")
        await long(page, f"{BORROWED} === '' && {said(f'Points and poses ({count})')}")
        if await page.value(said("All of them agree.")) and count >= TOUCHES - 1:
            break
    await press(page, "Keep this registration")
    await long(page, said("The check: go to this place"))
    await press(page, "Stage: what the virtual robot shows")
    await press(page, "How far was it off?")
    await long(page, said("Off by "))
    await release(page, "Use this registration", password)
    await long(page, said("In use, as release"))


async def go_live(page: Browser, modbus: int) -> None:
    """Give the cell back, and let a PLC read."""
    await press(page, "Lay the part")
    await follow(page, "plc")
    await page.click("main .primary.big")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await long(page, f'["READY", "BUSY"].includes({STATE})')
    await valid(page, modbus)


async def valid(page: Browser, modbus: int) -> dict[str, Any]:
    """Wait until a PLC reads a VALID result; return its fields by name."""
    with ModbusTcpClient("127.0.0.1", port=modbus, timeout=5) as plc:
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < LIMIT_S:
            # the cell is in this process: its loop must answer meanwhile
            read = await asyncio.to_thread(plc.read_input_registers, RESULT.address, count=RESULT.words)
            found = decode(RESULT, read.registers)
            if int(found["FLAGS"]) & Flag.VALID:
                return found
            await pause(page, 0.1)
    raise RuntimeError(f"no VALID result over Modbus: {found}")
