"""The robot's registration on the setup page, with the stage's virtual robot."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.cells import small_rig
from helpers.needs import needs
from helpers.setuppage import DIALOG, SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, discard, go, log_in, press, said
from helpers.stagecell import Newcomer, staged

from edged.commands.stage import USER
from edged.files.rig import load_rig, save_rig
from edged.robot.errormap import ErrorMap
from edged.setup.registration.registering import from_points
from edged.vision.geometry.rigid import apply

pytestmark = [pytest.mark.slow, needs("chromium")]

OVERTAKEN = """{ const asked = fetch;
window.fetch = async (path, request) => {
  const answer = await asked(path, request);
  while (request?.method === "PUT" && !document.body.innerText.includes("All of them agree."))
    await new Promise((done) => setTimeout(done, 20));
  return answer; }; 0 }"""
"""From now on, answers to changes arrive after the published messages about them."""


async def paste(page: Browser, text: str) -> None:
    """Paste a text copied elsewhere into its field."""
    await page.type("[name=pasted]", text)


async def type_and_press(page: Browser, field: str, text: str, button: str) -> None:
    """Type into a field and press a button before the page is drawn again."""
    await page.value(
        f"""(async () => {{
        const field = document.querySelector({field!r});
        field.value = {text!r};
        field.dispatchEvent(new Event("input", {{bubbles: true}}));
        await new Promise((done) => setTimeout(done));
        const buttons = [...document.querySelectorAll("button")];
        buttons.find((b) => b.textContent.trim() === {button!r}).click(); }})()"""
    )


async def accessible(page: Browser) -> None:
    """Check that axe finds nothing, no target is too small, and the console is empty."""
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)
    assert [] == page.complaints


@asynccontextmanager
async def on_stage(folder: Path) -> AsyncIterator[tuple[Newcomer, Browser]]:
    """A stage with a rig without a robot and a board before it, and a page that has the cell."""
    save_rig(folder / "rig.json", replace(small_rig(), robot_from_rig=None), {"board": "chessboard:11x8:4"})
    async with staged(folder, gige=False) as newcomer, browser() as page:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        await newcomer.ask("POST", "stage/robot/walk", {})
        await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
        await press(page, "Take over")
        await page.until(DIALOG)
        await page.click("dialog[open] .primary")
        await page.until('document.querySelector(".lease.mine")')
        await go(page, "robot")
        await page.until(said("How do you want to do it?"))
        yield newcomer, page


@pytest.mark.long
async def test_a_robot_is_registered_by_touch(tmp_path: Path) -> None:
    """Five touches, one mistyped and corrected, register the rig, proved by another touch and activated;
    what is sent equals the field, and a late answer does not overwrite newer messages.
    """
    async with on_stage(tmp_path) as (_, page):
        await accessible(page)
        await page.choose('[name="brand"]', "fanuc")
        await press(page, "Begin")
        await page.until(said("Point 1 of 6"))
        await press(page, "Take a picture of it")
        await page.until('document.querySelectorAll(".robot-look .place").length === 9')
        for step in range(5):
            await press(page, "Stage: what the virtual robot shows")
            await page.until('document.querySelector("[name=pasted]").value')
            if step == 4:
                shown = await page.value('document.querySelector("[name=pasted]").value')
                x, y, z = (part.split()[1] for part in shown.split(", "))
                await paste(page, f"X {float(x) + 4:.2f}°\t{y}\t{z}".replace(".", ","))
            await press(page, "Add this point")
            await page.until(said(f"Points and poses ({step + 1})"))
            # the point is pushed before its answer, which empties the field for the next one
            await page.until("""document.querySelector("[name=pasted]").value === ''""")
        await page.until(said("point 5 is wrong by"))
        assert "Wrong, if the others are right." == await page.value(
            'document.querySelector(".culprit").children[3].textContent.trim()'
        )
        await page.click(".culprit button")
        await page.until(DIALOG)
        await page.value(OVERTAKEN)
        await type_and_press(page, "dialog [name=shown0]", x.replace(".", ","), "Save")
        await page.until(said("All of them agree."))

        await press(page, "Keep this registration")
        await page.until(said("The check: go to this place"))
        await page.until('document.querySelector(".robot-target").textContent.startsWith("X ")')
        await press(page, "Stage: what the virtual robot shows")
        await press(page, "How far was it off?")
        await page.until(said("Off by 0."))
        await accessible(page)
        await press(page, "Use this registration")
        await page.until(DIALOG)
        await page.type("[name=note]", "five touches")
        await page.click("dialog[open] .primary")
        await page.until(said("In use, as release"))
        assert load_rig(tmp_path / "rig.json").robot_from_rig is not None

        await press(page, "Begin another one")
        await page.until(said("How do you want to do it?"))
        await press(page, "Begin")
        await page.until(said("Point 1 of 6"))
        assert [] == page.complaints


@pytest.mark.long
async def test_the_map_of_the_robots_error_is_shown(tmp_path: Path) -> None:
    """Its quality and the robot's errors are shown; EDGED_SHOTS keeps a picture."""
    rig = small_rig()
    rng = np.random.default_rng(4)
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    seen = np.concatenate([corners, rng.uniform(-1, 1, (22, 3))]) * (150.0, 100.0, 40.0) + (0, 0, 200.0)
    assert rig.robot_from_rig is not None
    at = apply(rig.robot_from_rig, seen)
    off = 0.2 * np.sin(at / 120.0)[:, [1, 2, 0]] + rng.normal(0, 0.02, at.shape)
    made = from_points(rig, seen, at + off, 2.0, with_map=True).registered.rig
    assert made.robot_map is not None
    save_rig(tmp_path / "rig.json", made, {"board": "chessboard:11x8:4"})
    async with staged(tmp_path, gige=False) as newcomer, browser() as page:
        await log_in(page, newcomer.origin, USER, PASSWORD, "/setup#/robot", (1280, 1400))
        await page.until(said("Map of the robot's error"))
        text = await page.value("document.querySelector('.robot-map').innerText")
        figures = ErrorMap(made.robot_map).figures
        assert f"30, a map of degree {figures.degree}" in text
        held, alone = (round(1e3 * mm) for mm in (figures.held_out_mm, figures.alone_mm))
        assert f"{held} µm; without the map {alone} µm" in text
        assert 30 == await page.value("document.querySelectorAll('.robot-map svg .point').length")
        if shots := os.environ.get("EDGED_SHOTS"):
            (Path(shots) / "robot-map.png").write_bytes(await page.picture())
        assert not await page.value(TOO_WIDE)
        await accessible(page)


@pytest.mark.long
async def test_another_registration_is_begun_and_one_is_discarded(tmp_path: Path) -> None:
    """An earlier registration opens only on request, neither by changing steps nor by a reload."""
    async with on_stage(tmp_path) as (newcomer, page):
        await press(page, "Begin")
        await page.until(said("Point 1 of 6"))
        await press(page, "Begin another one")
        await page.until(said("How do you want to do it?"))
        await go(page, "welcome")
        await go(page, "robot")
        await page.until(said("Begun before"))
        assert await page.value(said("How do you want to do it?"))
        await page.ask("Page.reload")
        await page.until(said("Begun before"))
        assert await page.value(said("How do you want to do it?"))
        await accessible(page)

        await page.click("[name=way][value=poses]")
        await press(page, "Begin")
        await page.until(said("Pose 1 of 10"))
        await discard(page)
        await page.until(said("How do you want to do it?"))
        (first,) = (await newcomer.ask("GET", "registrations"))["registrations"]
        assert "touch" == first["kind"]
        await press(page, "Continue")
        await page.until(said("Point 1 of 6"))
        await newcomer.ask("DELETE", f"registrations/{first['id']}", {}, 204)  # on another screen
        await page.until(said("How do you want to do it?"))
        await page.until(f"!{said('Begun before')}")
        await press(page, "Begin")
        await page.until(said("Pose 1 of 10"))
        # the page may request what the other screen discards
        assert [] == [complaint for complaint in page.complaints if first["id"] not in complaint]


@pytest.mark.long
async def test_poses_of_another_brand_are_told_and_read_rightly_by_one_button(tmp_path: Path) -> None:
    """Poses entered as KUKA's are recognised as Universal Robots', and one button reads them so; nothing
    is cut off."""
    async with on_stage(tmp_path) as (newcomer, page):
        await page.click("[name=way][value=poses]")
        await page.choose('[name="brand"]', "kuka")
        await press(page, "Begin")
        for step in range(4):
            await page.until(said(f"Pose {step + 1} of 10"))
            await newcomer.ask("POST", "stage/robot/walk", {})
            await paste(page, (await newcomer.ask("GET", "stage/robot?brand=ur"))["text"])
            await press(page, "Take the picture at this pose")
        await page.until(said("These numbers read as a rotation vector in rad, lengths in m"))
        assert await page.value(said("that is Universal Robots. You said KUKA."))
        await press(page, "Read them as Universal Robots")
        await page.until(said("All of them agree."))
        await page.until('document.querySelectorAll(".robot-sky .star").length === 4')
        await accessible(page)

        await page.open(f"{newcomer.origin}/setup?pseudo#/robot", 360, 740)
        await page.until('document.querySelector(".robot-sky .star")')
        assert [] == await page.value(UNTRANSLATED)
        assert 0 == await page.value(TOO_WIDE)
