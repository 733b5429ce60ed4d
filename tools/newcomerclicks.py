"""The way of a newcomer on the page, by clicks and digits alone, in a real browser (`tools/bench newcomer`).

What hands do in a cell, those of the stage do: they wave, hold the board where the page draws it, lay parts.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from helpers.browser import Browser, browser
from helpers.setuppage import DIALOG, STATE, go, log_in, press, said

Ask = Callable[..., Awaitable[Any]]
SIZE = (1280, 900)
SQUARE_MM = "4.0"
LEAST_S = 4.0
"""Who sees that the board is not where it should be moves it."""
LIMIT_S = 900.0
GHOSTS = """[...document.querySelectorAll(".pair .view svg")].map((view) =>
  view.querySelector(".ghost polygon")?.getAttribute("points").trim().split(" ")
    .map((point) => point.split(",").map((value) => Number(value) - 0.5)) ?? [])"""
"""As drawn: four corners in each picture, raw px; a pixel's middle is half a unit inside the drawing."""
PLACES = 'document.querySelectorAll(".covered").length'
VIEWS = 'document.querySelectorAll(".strip li").length'


async def set_up(origin: str, user: tuple[str, str], ask: Ask, goal_um: float, tried: int) -> dict[str, Any]:
    """From an empty folder to a cell that is READY with a job; figures by their names.

    user : name and password. ask : the stage's hands. goal_um : of the calibration. tried : places.

    Raises RuntimeError where there is no chromium.
    """
    if shutil.which("chromium") is None:
        raise RuntimeError("no chromium")
    begun_s = time.monotonic()
    async with browser() as page:
        await log_in(page, origin, *user, "/setup", SIZE)
        await page.click(".lease .primary")
        await page.until('document.querySelector(".lease.mine")')
        await wave(page, ask)
        views = await calibrate(page, ask, goal_um)
        calibrated_s = time.monotonic() - begun_s
        await check(page, ask)
        await teach(page, ask)
        good = await try_out(page, ask, tried)
        await page.click(".lease button")
        await confirm(page)
        await page.until(f'["READY", "BUSY"].includes({STATE})')
        complaints = len(page.complaints)
    whole_s = time.monotonic() - begun_s
    return {
        "views": views,
        "calibrated_s": round(calibrated_s, 1),
        "tried_good": good,
        "whole_s": round(whole_s, 1),
        "complaints": complaints,
    }


async def confirm(page: Browser, text: str = "") -> None:
    """Answer a question with yes, and a note where it wants one."""
    await page.until(DIALOG)
    if text:
        await page.type("dialog[open] input", text)
    await page.click("dialog[open] .primary")
    await page.until(f"!{DIALOG}")


async def wave(page: Browser, ask: Ask) -> None:
    """Before the left camera, and only there."""
    await go(page, "cameras")
    await ask("PUT", "stage", {"showing": "nothing"})
    await press(page, "I wave now")
    await page.until('document.querySelector(".pulse")')
    await ask("PUT", "stage", {"waving": "left"})
    await page.until('document.querySelector("#wave").parentElement.querySelector("button:enabled")')
    await ask("PUT", "stage", {"waving": "none"})
    if not await page.value(said("The left picture moved")):
        raise RuntimeError(await page.value('document.querySelector("#wave").parentElement.innerText'))


async def calibrate(page: Browser, ask: Ask, goal_um: float) -> int:
    """Hold the board where it is drawn until the goal is reached, solve, use it; the number of views."""
    await ask("PUT", "stage", {"showing": "board"})
    await go(page, "calibrate")
    await page.type("[name=mm]", SQUARE_MM)
    await page.type("[name=goal]", f"{goal_um:g}")
    await press(page, "Begin")
    await press(page, "Take views automatically")
    begun_s = time.monotonic()
    last, held_s = "", 0.0
    while not await page.value('/reached/.test(document.querySelector(".big.figure")?.innerText ?? "")'):
        if time.monotonic() - begun_s > LIMIT_S:
            raise RuntimeError(await page.value("document.querySelector('main').innerText"))
        left, right = await page.value(GHOSTS)
        drawn = json.dumps(left)
        is_due = drawn != last or time.monotonic() - held_s > LEAST_S
        if len(left) == 4 and is_due and not (await ask("GET", "stage"))["moving"]:
            last, held_s = drawn, time.monotonic()
            await ask("PUT", "stage/hand", {"left": left, "right": right})
        await page.value("new Promise((done) => setTimeout(done, 100))")
    views = int(await page.value(VIEWS))
    await press(page, "Solve")
    await long(page, 'document.querySelector("#solve").parentElement.querySelector("dl")')
    await press(page, "Use this calibration")
    await confirm(page, "the first")
    await long(page, said("In use, as release"))
    return views


async def long(page: Browser, expression: str) -> None:
    """Wait for what takes the cell longer than a page may."""
    begun_s = time.monotonic()
    while not await page.value(f"Boolean({expression})"):
        if time.monotonic() - begun_s > LIMIT_S:
            raise RuntimeError(f"never true: {expression}")
        await page.value("new Promise((done) => setTimeout(done, 200))")


async def check(page: Browser, ask: Ask) -> None:
    """This board once more, held still."""
    await ask("PUT", "stage/hand", {})
    await ask("PUT", "stage", {"still": True})
    await go(page, "check")
    await press(page, "Check now")
    await long(page, 'document.querySelector(".checked .big.figure strong")')
    if not await page.value(said("The calibration holds")):
        raise RuntimeError(await page.value('document.querySelector(".checked").innerText'))


async def teach(page: Browser, ask: Ask) -> None:
    """One pair; the part is tapped where it is drawn, and what is proposed is taken."""
    await ask("PUT", "stage", {"showing": "part"})
    await go(page, "teach")
    await press(page, "Take the pair")
    await long(page, 'document.querySelectorAll("[data-side=left] .feature.taken").length > 3')
    await press(page, "Where the part is")
    await press(page, "Tap")
    await page.click("[data-side=left] .feature[data-key=c0]")
    await long(page, '!document.querySelector("progress") && document.querySelector(".feature.taken")')
    await press(page, "Use this job")
    await confirm(page, "the first part")
    await long(page, said("is in use, as release"))


async def try_out(page: Browser, ask: Ask, tried: int) -> int:
    """The part at several places; at how many of them the page draws that it was good."""
    await go(page, "try")
    await press(page, "Try it live")
    await long(page, f"{PLACES} > 0")
    for _ in range(tried):
        before, begun_s = await page.value(PLACES), time.monotonic()
        await ask("POST", "stage/lay", {})
        while await page.value(PLACES) == before and time.monotonic() - begun_s < LEAST_S:
            await page.value("new Promise((done) => setTimeout(done, 100))")
    good = int(await page.value(PLACES)) - 1
    await press(page, "Stop")
    return good
