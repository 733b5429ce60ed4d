"""Jobs of a running cell over HTTP: changed as releases, and activated as by a PLC."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.browsersession import BrowserSession
from helpers.cells import flange
from helpers.partcell import PartCell

from edged.domain.events import Command, CommandKind
from edged.files.golden import golden_file, load_golden
from edged.files.jobs import save_job
from edged.setup.cellfiles import read_cell
from edged.vision.geometry.rectification import make_rectification
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach


@functools.cache
def taught() -> Job:
    """The flange's job."""
    part = flange()
    return teach(part.left, part.right, make_rectification(part.rig), part.region, "flange")


def cell_with_jobs(folder: Path) -> PartCell:
    """A cell with two jobs, one of which keeps its pair."""
    cell = PartCell(folder)
    save_job(folder / "jobs" / "flange", taught())
    save_job(folder / "jobs" / "lid", replace(taught(), name="lid", number=4))
    text = (folder / "jobs" / "lid" / "job.toml").read_text()
    (folder / "jobs" / "lid" / "job.toml").write_text(f"# Anna's own words\n{text}")
    (folder / "jobs" / "lid" / "taught").mkdir()
    for name in ("content.json", "left.png", "right.png"):
        (folder / "jobs" / "lid" / "taught" / name).write_text(name)
    return cell


@asynccontextmanager
async def ready(cell: PartCell) -> AsyncIterator[None]:
    """The running cell, once it is ready."""
    async with cell.running():
        await cell.until("/cell", lambda now: now["state"] == "READY")
        yield


@pytest.mark.long
async def test_jobs_are_renamed_numbered_retired_and_brought_back(tmp_path: Path) -> None:
    """Each change is a release that keeps all edits, and impossible ones are refused without effect."""
    cell = cell_with_jobs(tmp_path)

    async def told() -> list[tuple[str, int, bool, bool]]:
        _, listed = await cell.ask("GET", "/jobs")
        return [(one["folder"], one["number"], one["editable"], one["retired"]) for one in listed["jobs"]]

    async def refused(folder: str, body: dict[str, Any]) -> tuple[int, str]:
        status, problem = await cell.ask("PUT", f"/jobs/{folder}", body)
        return status, problem["code"]

    async with ready(cell):
        before = read_cell(cell.config).fingerprint
        assert [("flange", 1, False, False), ("lid", 4, True, False)] == await told()
        assert (422, "teach_number_taken") == await refused("lid", {"number": 1})
        assert (422, "teach_name_taken") == await refused("lid", {"new_name": "flange"})
        assert (400, "invalid") == await refused("lid", {"new_name": "../etc"})
        assert (400, "invalid") == await refused("lid", {})
        assert (404, "unknown") == await refused("bracket", {"number": 9})
        status, _ = await cell.ask("PUT", "/jobs/lid", {"new_name": "cover", "number": 7})
        assert 200 == status
        assert [("flange", 1, False, False), ("cover", 7, True, False)] == await told()
        text = (tmp_path / "jobs" / "cover" / "job.toml").read_text()
        assert text.startswith("# Anna's own words\n")
        jobs = read_cell(cell.config).jobs
        assert {(1, "flange"), (7, "cover")} == {(one.number, one.name) for one in jobs}
        _, listed = await cell.ask("GET", "/releases")
        assert "lid: name cover, number 7" == listed["releases"][0]["note"]

        wish = {"retired": True, "note": "not made any more"}
        assert 200 == (await cell.ask("PUT", "/jobs/flange", wish))[0]
        assert [("cover", 7, True, False), ("flange", 1, False, True)] == await told()
        assert (422, "input_last_job") == await refused("cover", {"retired": True})
        assert 200 == (await cell.ask("PUT", "/jobs/flange", {"retired": False, "number": 2}))[0]
        assert [("flange", 2, False, False), ("cover", 7, True, False)] == await told()
        copy = {"new_name": "lid-2", "note": "for the left side"}
        assert 201 == (await cell.ask("POST", "/jobs/cover/duplicate", copy))[0]
        assert (422, "teach_name_taken") == await refused("flange", {"new_name": "lid-2"})
        _, listed = await cell.ask("GET", "/jobs")
        assert ("lid-2", 1, True) == tuple(listed["jobs"][0][key] for key in ("name", "number", "editable"))
        assert 200 == (await cell.ask("PUT", "/jobs/lid-2", {"number": 3, "note": "the PLC wants 3"}))[0]
        _, versions = await cell.ask("GET", "/jobs/lid-2/versions")
        assert [("the PLC wants 3", True), ("for the left side", False)] == [
            (one["note"], one["active"]) for one in versions["versions"]
        ]
        assert 404 == (await cell.ask("GET", "/jobs/bracket/versions"))[0]
        status, back = await cell.ask("POST", "/releases/1/activate", {"reason": "as it was"})
        assert (200, before) == (status, back["fingerprint"])
        assert [("flange", 1, False, False), ("lid", 4, True, False)] == await told()
        cell.config.write_text(cell.config.read_text().replace("[cycle]", 'job = "lid"\n[cycle]'))
        await BrowserSession(cell.session).reload(cell.daemon)
        assert (422, "input_named") == await refused("lid", {"retired": True})
        assert (422, "input_named") == await refused("lid", {"new_name": "cover"})


@pytest.mark.slow
async def test_a_job_is_used_as_a_plc_would_change_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job is used from the next cycle on, its share of good cycles is listed, and a writing PLC
    prevents it."""
    cell = cell_with_jobs(tmp_path)

    async def active() -> list[tuple[str, bool, int]]:
        _, listed = await cell.ask("GET", "/jobs")
        return [(one["folder"], one["active"], one["cycles"]) for one in listed["jobs"]]

    async with ready(cell):
        assert [("flange", True, 0), ("lid", False, 0)] == await active()
        assert 202 == (await cell.ask("POST", "/jobs/lid/use", {}))[0]
        await cell.until("/jobs", lambda listed: listed["jobs"][1]["active"])
        cell.daemon._cycle.submit(Command(CommandKind.LOCATE, "test", 1))  # noqa: SLF001  (as a client's)
        listed = await cell.until("/jobs", lambda listed: listed["jobs"][1]["cycles"])
        assert (1.0, True) == (listed["jobs"][1]["ok_share"], listed["jobs"][1]["last_used"] is not None)
        assert None is listed["jobs"][0]["ok_share"]
        assert 404 == (await cell.ask("POST", "/jobs/bracket/use", {}))[0]
        modbus = cell.daemon._servers.started["modbus"]  # noqa: SLF001  (as a PLC that has written)
        with monkeypatch.context() as patch:
            patch.setattr(type(modbus), "owner", "192.0.2.7")
            status, problem = await cell.ask("POST", "/jobs/flange/use", {})
            assert (409, "setup_refused") == (status, problem["code"])
        await cell.take()
        status, problem = await cell.ask("POST", "/jobs/flange/use", {})
        assert (409, "command_refused") == (status, problem["code"])


@pytest.mark.slow
async def test_where_the_part_of_a_job_lies_is_kept_as_the_golden_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The golden part is kept, but not in SETUP, with AUTO_LOCK or while a PLC has the right to write."""
    cell = cell_with_jobs(tmp_path)
    place = golden_file(cell.config.with_name("rig.json"), 1)

    async with ready(cell):
        assert (204, None) == await cell.ask("POST", "/jobs/flange/golden", {})
        assert "flange" == load_golden(place).job
        before = place.read_bytes()
        assert 404 == (await cell.ask("POST", "/jobs/bracket/golden", {}))[0]
        modbus = cell.daemon._servers.started["modbus"]  # noqa: SLF001  (as a PLC that has written)
        with monkeypatch.context() as patch:
            patch.setattr(type(modbus), "owner", "192.0.2.7")
            status, problem = await cell.ask("POST", "/jobs/flange/golden", {})
            assert (409, "setup_refused") == (status, problem["code"])
        cell.daemon._cycle.lock_setup(locked=True)  # noqa: SLF001  (as a PLC's AUTO_LOCK)
        status, problem = await cell.ask("POST", "/jobs/flange/golden", {})
        assert (409, "setup_refused") == (status, problem["code"])
        cell.daemon._cycle.lock_setup(locked=False)  # noqa: SLF001  (as one that lets go)
        place.unlink()
        place.parent.rmdir()
        place.parent.write_text("in the way")
        status, problem = await cell.ask("POST", "/jobs/flange/golden", {})
        assert (409, "command_refused") == (status, problem["code"])
        assert place.parent.name in str(problem)
        place.parent.unlink()
        place.parent.mkdir()
        place.write_bytes(before)
        await cell.take()
        status, problem = await cell.ask("POST", "/jobs/flange/golden", {})
        assert (409, "command_refused") == (status, problem["code"])
        assert before == place.read_bytes()
