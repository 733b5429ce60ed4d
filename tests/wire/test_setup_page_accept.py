"""Acceptance on the setup page: pictures, touched points, the verdict, the document to sign."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from helpers.browser import browser
from helpers.browsersession import PASSWORD
from helpers.cells import flange
from helpers.partcell import PartCell
from helpers.setuppage import SMALL_TARGETS, TOO_WIDE, log_in, press, said, take

from edged.files.acceptance import acceptance_file, load_acceptance
from edged.files.jobs import save_job
from edged.pipeline import prepare
from edged.robot.golden import registration_digest
from edged.vision.teaching.pair import teach

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium"),
]


def flange_cell(folder: Path) -> PartCell:
    """A cell that knows the flange, which lies before it."""
    cell, part = PartCell(folder), flange()
    job = teach(part.left, part.right, prepare(part.rig).rectification, part.region, "flange")
    save_job(folder / "jobs" / "flange", job)
    return cell


@pytest.mark.long
async def test_a_person_accepts_the_cell_by_the_page(tmp_path: Path) -> None:
    """After 50 pictures of a still part and one elsewhere, finished tests show results and others are
    open; the cell has not passed, the document is beside the rig, and the audit has a record."""
    cell = flange_cell(tmp_path)
    async with cell.running(), browser() as page:
        place = f"http://127.0.0.1:{cell.port}"
        await log_in(page, place, "Anna", PASSWORD, "/setup#/accept", (1280, 1500))
        await take(page)
        text = "document.querySelector('main').innerText"
        await press(page, "Take 50 pictures")
        await page.until(f"{text}.includes('50 of 50')")
        await page.click("[aria-labelledby=accept-pose] button")
        await page.until(f"{text}.includes('1 of 30')")
        await page.type("[name=touched]", "1,2,3")
        await press(page, "Keep these points")
        await page.until(f"{text}.includes('1 of 10')")
        await press(page, "Judge the cell now")
        await page.until(f"{text}.includes('got 3 values')")  # a wrong line is named
        assert "touched.csv" in await page.value(text)
        assert str(tmp_path) not in await page.value(text), "no path of the machine"
        await page.click("[aria-labelledby=accept-robot] > .actions:last-child button")
        await page.until(f"{text}.includes('0 of 10')")
        await press(page, "Judge the cell now")
        await page.until(f"{text}.includes('The cell has not passed')")
        shown = await page.value(text)
        assert "1 poses with a good part, 30 are needed" in shown
        assert "not made: nothing is in length/" in shown
        assert str(tmp_path) not in shown, "no path of the machine"
        if shots := os.environ.get("EDGED_SHOTS"):
            (Path(shots) / "accept.png").write_bytes(await page.picture())
            await page.value("document.querySelector('#accept-last').scrollIntoView()")
            (Path(shots) / "accept-last.png").write_bytes(await page.picture())
        assert not await page.value(TOO_WIDE)
        assert [] == await page.value(SMALL_TARGETS)
        assert [] == await page.violations()
        document = json.loads(acceptance_file(cell.rig).read_bytes())
        assert ["still", "pose", "length", "robot"] == [test["name"] for test in document["tests"]]
        rig = flange().rig
        found = load_acceptance(acceptance_file(cell.rig), rig.calibration_id, registration_digest(rig))
        assert not found.passed
        async with cell.session.get("/api/v1/acceptance/report") as answer:
            assert (200, "text/html") == (answer.status, answer.content_type)
            assert "The cell DID NOT PASS" in await answer.text()
        _, told = await cell.ask("GET", "/audit")
        deeds = [one["outcome"] for one in told["records"] if "acceptance" in one["object"]]
        assert ["ok", "ok"] == deeds[:2]
        assert [] == page.complaints


@pytest.mark.long
async def test_people_study_a_size_by_the_page(tmp_path: Path) -> None:
    """With one part measured 25 times, wrong input is named, a reloaded page continues, the last
    measurement is taken back and repeated, and the end shows C_g, C_gk and the document to sign."""
    cell = flange_cell(tmp_path)
    async with cell.running(), browser() as page:
        place, size = f"http://127.0.0.1:{cell.port}", (1280, 1500)
        await log_in(page, place, "Anna", PASSWORD, "/setup#/accept", size)
        await take(page)
        text = "document.querySelector('[aria-labelledby=accept-study]').innerText"
        for name, mm in (("low_mm", "28.05"), ("high_mm", "28.04"), ("reference_mm", "28")):
            await page.type(f"[name={name}]", mm)
        await press(page, "Begin the study")
        await page.until(said("the lower limit below the upper one"))
        await page.type("[name=low_mm]", "27.96")
        await press(page, "Begin the study")
        for done in range(25):
            await page.until(f"{text}.includes('{done} of 25')")
            if done == 3:
                await press(page, "Take the last one back")
                await page.until(f"{text}.includes('2 of 25')")
                await page.open(f"{place}/setup#/accept", *size)
                await page.until(f"document.querySelector('#accept-study') && {text}.includes('2 of 25')")
                await press(page, "Measure")
                await page.until(f"{text}.includes('3 of 25')")
            await press(page, "Measure")
        await page.until(f"{text}.includes('Cg, Cgk')")
        assert not await page.value(TOO_WIDE)
        assert [] == await page.value(SMALL_TARGETS)
        assert [] == await page.violations()
        async with cell.session.get("/api/v1/acceptance/study/report") as answer:
            report = await answer.text()
        assert "Study of a size" in report
        assert "<td>1</td>" in report.replace("\n", ""), "one was taken back"
        await press(page, "End the study")
        await page.until("document.querySelector('dialog[open]')")
        await page.click("dialog[open] .primary")
        await page.until(f"{text}.includes('Begin the study')")
        assert 1 == len(page.complaints), "only of the wrong limits"
