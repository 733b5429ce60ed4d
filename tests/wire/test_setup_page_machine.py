"""The machine's page: findings and their repair, downloading a backup and restoring another."""

from __future__ import annotations

import base64
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.boardcell import BoardCell
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.engines import BROWSERS, Opener
from helpers.needs import needs
from helpers.setuppage import DIALOG, SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, go, log_in, press, said, take
from helpers.smallcell import SmallCell

from edged import __version__
from edged.files.rig import load_rig, rig_text
from edged.setup.machine.bundle import unpack as unpack_bundle
from edged.setup.releases.archive import make, parts_at, unpack

pytestmark = pytest.mark.slow
KEPT = """{ const made = URL.createObjectURL;
  window.files = [];
  URL.createObjectURL = (file) => { files.push(file); return made(file); }; }"""
"""Keeps files that the page lets the browser save, for the test."""
LAST = """new Promise((done) => { const reader = new FileReader();
  reader.onload = () => done([files.at(-1).name, reader.result.split(",")[1]]);
  reader.readAsDataURL(files.at(-1)); })"""


def complete(folder: Path) -> BoardCell:
    """A cell with rig and job."""
    made = SmallCell(folder / "made", source="virtual-inprocess").config.parent
    (folder / "cell").mkdir()
    cell = BoardCell(folder / "cell")
    shutil.copy(made / "rig.json", cell.rig)
    shutil.copytree(made / "jobs", folder / "cell" / "jobs", dirs_exist_ok=True)
    cell.config.write_text(cell.config.read_text().replace('job = "none"\n', ""))
    cell.config.chmod(0o600)
    return cell


async def downloaded(page: Browser, label: str, count: int) -> tuple[str, bytes]:
    """Name and content of the file that a button downloads."""
    await press(page, label)
    await page.until(f"window.files.length === {count}")
    name, data = await page.value(LAST)
    return name, base64.b64decode(data)


@pytest.mark.long
@pytest.mark.parametrize("opened", BROWSERS)
def test_findings_are_mended_by_a_button(tmp_path: Path, opened: Opener) -> None:
    """A file readable by others and one changed by hand are found, and mended by buttons.

    A backup of the cell can be downloaded, too.
    """

    async def test(cell: BoardCell) -> None:
        cell.config.chmod(0o644)
        cell.config.write_text(cell.config.read_text() + "[drift]\nmin_cycles = 30\n")
        async with opened() as page:
            await log_in(
                page, f"http://127.0.0.1:{cell.port}", "Anna", PASSWORD, "/setup#/system", (1280, 900)
            )
            await page.until(said(f"edged {__version__}"))
            await page.until(said("as that of this browser"))
            await press(page, "Examine this machine")
            await page.until('document.querySelector(".checks .warn")')
            await page.until(said("what was changed does not count yet"))
            assert [] == await page.violations()
            assert [] == await page.value(SMALL_TARGETS)
            await press(page, "Close these files to other users")
            await page.until(f"!{said('Close these files')}")
            assert 0o640 == cell.config.stat().st_mode & 0o777
            await press(page, "Read the files again")
            await page.until(f"!{said('Read the files again')}")
            assert 30 == cell.daemon.loaded.cell.config.drift.min_cycles
            assert not await page.value(said("in use by another program"))
            await page.value(KEPT)
            name, archive = await downloaded(page, "Download a backup", 1)
            assert "cell1" == unpack(archive, name).cell
            await go(page, "welcome")
            await page.until(said("bad, "))
            await page.open(f"http://127.0.0.1:{cell.port}/setup?pseudo#/system", 360, 740)
            await page.until('document.querySelector(".checks li")')
            assert [] == await page.value(UNTRANSLATED)
            assert 0 == await page.value(TOO_WIDE)
            assert [] == page.complaints

    complete(tmp_path).run(test)


@pytest.mark.long
@needs("chromium")
def test_a_backup_is_downloaded_and_another_one_restored(tmp_path: Path) -> None:
    """The backup is a valid archive, the support file has no secrets, and a wrong archive is refused.

    Another backup is shown before it is restored.
    """
    cell = complete(tmp_path)
    rig = rig_text(replace(load_rig(cell.rig), calibration_id="cal-of-before"))
    other = tmp_path / "before.tar.gz"
    other.write_bytes(
        make(
            cell.config,
            replace(parts_at(cell.config.with_name("rig.json"), cell.config.with_name("jobs")), rig=rig),
        ).archive
    )
    wrong = tmp_path / "wrong.tar.gz"
    wrong.write_bytes(b"no archive")

    async def choose(page: Browser, file: Path) -> None:
        root = (await page.ask("DOM.getDocument"))["root"]["nodeId"]
        node = await page.ask("DOM.querySelector", nodeId=root, selector="[name=archive]")
        await page.ask("DOM.setFileInputFiles", nodeId=node["nodeId"], files=[str(file)])

    async def test(cell: BoardCell) -> None:
        async with browser() as page:
            await log_in(
                page, f"http://127.0.0.1:{cell.port}", "Anna", PASSWORD, "/setup#/system", (1280, 900)
            )
            await page.value(KEPT)
            name, archive = await downloaded(page, "Download a backup", 1)
            assert "cell1" == unpack(archive, name).cell
            name, told = await downloaded(page, "Download the support file", 2)
            assert name.endswith(".zip")
            assert "argon2id" not in str(unpack_bundle(told, name))

            await choose(page, wrong)
            await page.until('document.querySelector(".trouble")')
            page.complaints.clear()  # about the refusal
            await take(page)
            await choose(page, other)
            await page.until(said("cal-of-before"))
            assert [] == await page.violations()
            await press(page, "Use this backup")
            await page.until(DIALOG)
            await page.type("dialog[open] [name=note]", "as it was before")
            await page.click("dialog[open] .primary")
            await page.until(f"!{DIALOG}")
            rig = cell.daemon.loaded.cell.rig
            assert rig is not None
            assert "cal-of-before" == rig.calibration_id
            await go(page, "welcome")
            await go(page, "system")
            await page.until(said("restored a backup"))
            assert [] == page.complaints

    cell.run(test)
