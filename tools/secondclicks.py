"""The second pass by clicks: a VALID cell gets another camera, board, part and robot, without a restart.

Replacements are brought by hands beside the page (`Bench`); everything else is pressed on it. Calibrating and
teaching are begun again after a release, after a stop and after a draft was discarded; at the end the cell
goes back to its first release, and forward again.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from helpers.browser import Browser
from helpers.flatparts import DISC
from helpers.setuppage import DIALOG, STATE, said
from newcomerclicks import (
    BORROWED,
    VIEWS,
    Clicks,
    check,
    confirm,
    done,
    follow,
    long,
    press,
    release,
    to_release,
    try_out,
    valid,
    waved,
)

from edged.sim.exposure import ExposureRequest
from edged.sim.gige.camera import GigeCamera
from edged.sim.render.scene import Part, RenderedView
from edged.sim.stage import Stage
from edged.sim.world import VirtualWorld
from edged.vision.geometry.rigid import rotation_matrix, transform

SPARE = ("127.0.0.3", "EDGED-VIRTUAL-S")
SPARE_MM, SPARE_DEG = (4.0, -2.0, 1.0), (0.4, -0.5, 1.0)
"""Pose of the other camera relative to the one that it replaces."""
LONGER = 1.01
"""Its focal length relative to that camera's."""
OTHER_GRID = (10, 7, 4.5)
"""Inner corners and squares (mm) of the other board."""
WRONG_SIZE = (9, 8)
"""Inner corners that differ from the other board's."""
OTHER_BRAND = "fanuc"
POSES = 10
SETTING = '[name="cameras.max_arrival_skew_ms"]'
LOST_PACKET = 5
"""Number of the lost packet of a picture: neither its leader nor its trailer."""
SETTLED = "new Promise((done) => setTimeout(done, 1500))"
"""Time for a page to request the present state."""
RELEASES = """[...document.querySelectorAll("#releases ~ ul .tile")].map((tile) => [
  Number(/\\d+/.exec(tile.querySelector("h3").innerText)[0]), Boolean(tile.querySelector(".now"))])"""


class Losses:
    """While it is on, every second picture of a camera lacks a packet that cannot be resent."""

    def __init__(self, camera: GigeCamera) -> None:
        self._camera, self._whole = camera, camera.exposure
        self.is_on, self._is_due, self.count = False, False, 0
        camera.exposure = self._expose

    def _expose(self, request: ExposureRequest) -> Any:
        image = self._whole(request)
        faults, self._is_due = self._camera.faults, self.is_on and not self._is_due
        faults.no_resend = self._is_due
        faults.lost_packets = (LOST_PACKET,) if self._is_due else ()
        self.count += self._is_due
        return image


@dataclass(frozen=True, slots=True)
class Bench:
    """Spare devices beside the cell, and the hands that bring them. losses : None if no picture is lost."""

    world: VirtualWorld
    parts: tuple[Part, Part]
    views: tuple[RenderedView, RenderedView]
    losses: Losses | None = None

    @property
    def stage(self) -> Stage:
        """Stage of the world. Raises ValueError without one."""
        if self.world.stage is None:
            raise ValueError("no stage")
        return self.world.stage

    def lay(self, number: int) -> None:
        """Put the first (0) or the other part (1) there."""
        self.world.cell.part = self.parts[number]

    def see(self, number: int) -> None:
        """Let the hands follow the view of the first (0) or the other right camera (1)."""
        self.world.cell.replace_camera("right", self.views[number])

    def lose(self, is_on: bool) -> None:
        """Set whether pictures are lost from now on."""
        if self.losses is not None:
            self.losses.is_on = is_on


@contextlib.contextmanager
def bench(world: VirtualWorld, *, loses: bool) -> Iterator[Bench]:
    """Run the other camera on the network beside the two of a world; yields everything to be brought."""
    cell, first = world.cell, world.cell.view("right")
    moved = transform(rotation_matrix(np.radians(SPARE_DEG)), np.array(SPARE_MM)) @ first.camera_from_rig
    lens = replace(first.camera, fx=LONGER * first.camera.fx, fy=LONGER * first.camera.fy)
    other = RenderedView(lens, moved, first.sensor)
    with GigeCamera(*SPARE, cell.exposure("right", other), size=(lens.width, lens.height)):
        losses = Losses(world.devices[0]) if loses else None
        yield Bench(world, (cell.part, DISC), (first, other), losses)


async def second_pass(
    page: Browser,
    clicks: Clicks,
    beside: Bench,
    modbus: int,
    password: str,
    goal_um: float,
    tried: int,
    *,
    backward: bool = False,
) -> dict[str, Any]:
    """From a VALID cell to another one that is VALID, back, and forward again; return figures by name.

    goal_um : of the calibration. tried : places of the part on the page, before its job is used.
    backward : the steps in the other order, from settings to cameras.
    """
    begun_s = time.monotonic()
    first = await now_valid(page, modbus)
    beside.lose(True)
    await take_again(page)
    before = await release_in_use(page)
    clicks.end("take the cell again")
    await check_again(page)
    clicks.end("check")
    steps: dict[str, Callable[[], Awaitable[object]]] = {
        "another camera and board": lambda: calibrate_again(page, clicks, beside, goal_um, password),
        "check again": lambda: check_again(page),
        "another part": lambda: teach_another(page, beside, password),
        "try again": lambda: try_out(page, tried),
        "another robot": lambda: another_robot(page, password),
        "other settings": lambda: other_settings(page, password),
    }
    for name in reversed(steps) if backward else steps:
        await steps[name]()
        clicks.end(name)
    await give_back(page)
    await use_job(page, 2)
    beside.lose(False)
    second = await now_valid(page, modbus)
    clicks.end("live again")
    after = await release_in_use(page)
    back = await released(page, beside, before, 0, modbus, password)
    clicks.end("rolled back")
    again = await released(page, beside, after, 1, modbus, password)
    clicks.end("forward again")
    return {
        "second_s": round(time.monotonic() - begun_s, 1),
        "valid": [first, second, back, again],
        "releases": [before, after],
        "lost": 0 if beside.losses is None else beside.losses.count,
    }


async def released(
    page: Browser, beside: Bench, number: int, which: int, modbus: int, password: str
) -> dict[str, Any]:
    """Go back to a release, with its camera and part (0: the first, 1: the other); return `now_valid`."""
    beside.lose(True)
    await go_back(page, number, password)
    beside.lay(which)
    beside.see(which)
    await press(page, "Lay the part")
    await use_job(page, which + 1)
    beside.lose(False)
    return await now_valid(page, modbus)


async def now_valid(page: Browser, modbus: int) -> dict[str, Any]:
    """Job and calibration of a VALID result, once there is one, and the setting."""
    found = await valid(page, modbus)
    return {name: found[name] for name in ("JOB", "CALIBRATION")} | {"setting": await setting(page)}


async def take_again(page: Browser) -> None:
    """Take the running cell for setting up, and answer its question."""
    await press(page, "Take the cell")
    await long(page, f"{DIALOG} || document.querySelector('.lease.mine')")
    if await page.value(f"Boolean({DIALOG})"):
        await page.click("dialog[open] .primary")
    await long(page, 'document.querySelector(".lease.mine")')


async def release_in_use(page: Browser) -> int:
    """Number of the release in use, as shown by System once it is up to date."""
    await page.click('a[href="#/system"]')
    await page.value(SETTLED)
    await long(page, f"{RELEASES}.some(([, isUsed]) => isUsed)")
    return int(await page.value(f"{RELEASES}.find(([, isUsed]) => isUsed)[0]"))


async def another_camera(page: Browser, beside: Bench) -> None:
    """Make the spare camera the right one; exchange both and back again, by a wave."""
    await follow(page, "cameras")
    await press(page, "Search again")
    tile = f"""[...document.querySelectorAll(".tile")].find((one) => one.innerText.includes("{SPARE[1]}"))"""
    await long(page, tile)
    beside.see(1)
    await page.click(f'[aria-label="Use as right camera: {SPARE[1]}"]')
    await long(page, f'{tile}?.innerText.includes("right camera")')
    await page.click(f'[aria-label="Use as left camera: {SPARE[1]}"]')
    await long(page, f'{tile}?.innerText.includes("left camera")')
    await waved(page, "left and right have been exchanged")  # the left picture was the right one, by mistake
    await long(page, f'{tile}?.innerText.includes("right camera")')
    await done(page, "Take a test pair", said("ms between the two exposures"))


async def check_again(page: Browser) -> None:
    """Check with the board in the hand, which the page must have chosen."""
    await press(page, "Hold the board")
    await press(page, "Lay the board down")
    await check(page)


async def calibrate_again(
    page: Browser, clicks: Clicks, beside: Bench, goal_um: float, password: str
) -> None:
    """Another camera and board: begin with the wrong one, discard, stop, begin anew, solve, activate."""
    await another_camera(page, beside)
    beside.stage.take_board(*OTHER_GRID)
    await press(page, "Hold the board")
    await follow(page, "calibrate")
    await anew(page, "Begin another calibration", "Which board?")
    await page.click("[name=board]:not(:checked)")
    await page.type("[name=mm]", f"{OTHER_GRID[2]:g}")
    await page.type("[name=goal]", f"{goal_um:g}")
    for name, value in zip(("columns", "rows"), WRONG_SIZE, strict=True):
        await page.type(f"[name={name}]", str(value))
    await press(page, "Begin")
    await long(page, said("The pictures show another board"))
    await discard_here(page)
    await long(page, 'document.querySelector("[name=board]:not(:checked)")')
    await page.click("[name=board]:not(:checked)")
    await press(page, "Begin, and take views automatically")
    await long(page, f"{VIEWS} > 0")
    await press(page, "Stop taking views")
    await press(page, "Begin another calibration")
    await long(page, 'document.querySelector("[name=mm]")')
    await to_release(page, clicks, password)


async def anew(page: Browser, another: str, beginning: str) -> None:
    """Go to the beginning of a page: by its button, unless the page has left what is in use by itself."""
    await page.value(SETTLED)
    if not await page.value(said(beginning)):
        await press(page, another)
    await long(page, said(beginning))


async def discard_here(page: Browser) -> None:
    """Discard the draft that is shown, and answer its question."""
    await press(page, "Discard")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until(f"!{DIALOG}")


async def teach_another(page: Browser, beside: Bench, password: str) -> None:
    """Teach another part: begin, discard, begin again, use it."""
    beside.lay(1)
    await press(page, "Lay the part")
    await follow(page, "teach")
    for is_kept in (False, True):
        await anew(page, "Another part", "Take the pair")
        taken = 'document.querySelectorAll("[data-side=left] .feature.taken").length > 2'
        await done(page, "Take the pair", taken)
        if not is_kept:
            await discard_here(page)
    await release(page, "Use this job", password)
    await long(page, said("is in use, as release"))


async def another_robot(page: Browser, password: str) -> None:
    """Register a robot of another brand, which holds the board in ten poses."""
    await press(page, "Hold the board")
    await follow(page, "robot")
    await anew(page, "Begin another one", "How do you want to do it?")
    await page.click("[name=way][value=poses]")
    await page.value(
        f"""(() => {{ const brand = document.querySelector("[name=brand]"); brand.value = "{OTHER_BRAND}";
        brand.dispatchEvent(new Event("change", {{ bubbles: true }})); }})()"""
    )
    await press(page, "Begin")
    for count in range(1, POSES + 1):
        await press(page, "Stage: robot to its next pose")
        await press(page, "Stage: what the virtual robot shows")
        await long(page, BORROWED)
        taken = f"{BORROWED} === '' && {said(f'Points and poses ({count})')}"
        await done(page, "Take the picture at this pose", taken)
    await long(page, said("All of them agree."))
    await press(page, "Keep this registration")
    await long(page, said("The check: go to this place"))
    await release(page, "Use this registration", password)
    await long(page, said("In use, as release"))


async def setting(page: Browser) -> str:
    """Value of the setting that is changed meanwhile, as the page shows it."""
    await page.click('a[href="#/settings"]')
    await long(page, f"document.querySelector('{SETTING}')")
    return str(await page.value(f"document.querySelector('{SETTING}').value"))


async def other_settings(page: Browser, password: str) -> None:
    """Change a setting for which the cameras are opened anew, and wait for new live pictures."""
    before = await setting(page)
    await page.type(SETTING, before + "5")
    await release(page, "Use these settings", password)
    await long(page, said("The cell runs with these settings."))
    await follow(page, "light")
    picture = """document.querySelector(".view canvas:not([hidden])")"""
    await long(page, picture)
    await page.value(f"globalThis.earlier = {picture}.toDataURL(), 0")
    await long(page, f"{picture}.toDataURL() !== globalThis.earlier")


async def give_back(page: Browser) -> None:
    """Give the cell back with the part before the cameras; it must measure, even if it loses pictures."""
    await press(page, "Lay the part")
    await follow(page, "plc")
    await page.click("main .primary.big")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await long(page, f'["READY", "BUSY"].includes({STATE})')


async def use_job(page: Browser, number: int) -> None:
    """Use a job by its tile, unless it is in use, or becomes so by itself because the other one is gone."""
    await page.click('a[href="#/jobs"]')
    tile = f"""[...document.querySelectorAll(".tile.job")].find((one) =>
      one.querySelector(".count").innerText === "{number}")"""
    await long(page, tile)
    button = f"""[...{tile}.querySelectorAll("button")].find((b) => b.innerText === "Use now")"""
    is_used = f"{tile}.innerText.includes('in use now')"
    await long(page, f"{is_used} || {button}?.disabled === false")
    if not await page.value(is_used):
        await page.click_on(button)
    await long(page, is_used)


async def go_back(page: Browser, number: int, password: str) -> None:
    """Go back to a release, by the button of its tile."""
    await page.click('a[href="#/system"]')
    await page.click(f'[aria-label="Use it again: release {number}"]')
    await page.until(DIALOG)
    await page.type("dialog[open] input", "back")
    await page.click("dialog[open] .primary")
    await confirm(page, password, f"{RELEASES}.some(([count, isUsed]) => isUsed && count === {number})")
