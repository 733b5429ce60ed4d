"""The acceptance on the page that sets a cell up: pictures, touched points, the verdict, the page to sign."""

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
from helpers.setuppage import SMALL_TARGETS, TOO_WIDE, log_in, press, take

from edged.files.acceptance import acceptance_file, load_acceptance
from edged.files.jobs import save_job
from edged.pipeline import prepare
from edged.robot.golden import registration_digest
from edged.vision.teaching.pair import teach

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium"),
]


async def test_a_person_accepts_the_cell_by_the_page(tmp_path: Path) -> None:
    """50 pictures of a still part and one elsewhere: the tests that were made say so, what was not made is
    open, the cell has not passed, and knows it; the document lies beside the rig, the audit has a line."""
    cell = PartCell(tmp_path)
    part = flange()
    job = teach(part.left, part.right, prepare(part.rig).rectification, part.region, "flange")
    save_job(tmp_path / "jobs" / "flange", job)
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
        said = await page.value(text)
        assert "1 poses with a good part, 30 are needed" in said
        assert "not made: nothing is in length/" in said
        assert str(tmp_path) not in said, "no path of the machine"
        if shots := os.environ.get("EDGED_SHOTS"):
            (Path(shots) / "accept.png").write_bytes(await page.picture())
            await page.value("document.querySelector('#accept-last').scrollIntoView()")
            (Path(shots) / "accept-last.png").write_bytes(await page.picture())
        assert not await page.value(TOO_WIDE)
        assert [] == await page.value(SMALL_TARGETS)
        assert [] == await page.violations()
        document = json.loads(acceptance_file(cell.rig).read_bytes())
        assert ["still", "pose", "length", "robot"] == [test["name"] for test in document["tests"]]
        rig = part.rig
        found = load_acceptance(acceptance_file(cell.rig), rig.calibration_id, registration_digest(rig))
        assert not found.passed
        async with cell.session.get("/api/v1/acceptance/report") as answer:
            assert (200, "text/html") == (answer.status, answer.content_type)
            assert "The cell DID NOT PASS" in await answer.text()
        _, told = await cell.ask("GET", "/audit")
        deeds = [one["outcome"] for one in told["records"] if "acceptance" in one["object"]]
        assert ["ok", "ok"] == deeds[:2]
        assert [] == page.complaints
