"""A new job or rig is tried on recorded cycles before use, and degradations must be signed for."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import pytest
from helpers.recordedcell import RecordingCell, exposures, record
from helpers.smallcell import SmallCell

from edged.domain.frames import FramePair
from edged.errors import FileFormatError
from edged.files.rig import rig_text
from edged.setup.calibration.drafts import Drafts, Solution
from edged.setup.cellfiles import CellFiles, read_cell
from edged.setup.recordings import regressions
from edged.setup.recordings.setups import affected_jobs
from edged.vision.geometry.camera import StereoRig

CYCLES = 6


class Recorded(NamedTuple):
    """A cell with six recorded good cycles, and one without pictures."""

    template: Path
    recordings: Path
    files: CellFiles
    pairs: list[FramePair]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Recordings by the real pipeline."""
    folder = tmp_path_factory.mktemp("regressions")
    cell = SmallCell(folder / "cell", source="virtual-inprocess")
    files, pairs = read_cell(cell.config), exposures(cell.virtual, CYCLES)
    record(folder / "recordings", files, [*pairs, None])
    return Recorded(cell.config.parent, folder / "recordings", files, pairs)


def cell_of(recorded: Recorded, folder: Path) -> RecordingCell:
    """A cell with these recordings."""
    return RecordingCell(folder / "cell", recorded.template, recorded.recordings, recorded.pairs)


def solved(cell: RecordingCell, rig: StereoRig) -> str:
    """Id of a draft solved to a rig."""
    draft = Drafts(cell.state / "drafts").create(
        "Anna", ("chessboard:11x8:4",), None, "brown", datetime.now(UTC)
    )
    figures = {"stereo_rms_px": 0.1, "held_out": None, "sigma_um": None, "grade": "good"}
    draft.solve(Solution(rig.calibration_id, rig_text(rig), b"<html>", {**figures, "moved_um": None}))
    return draft.state.id


def wider(rig: StereoRig, factor: float) -> StereoRig:
    """The rig with another baseline."""
    moved = rig.right_from_left.copy()
    moved[:3, 3] *= factor
    return replace(rig, right_from_left=moved, calibration_id=f"cal-{factor}")


async def tried(cell: RecordingCell, body: dict[str, object]) -> dict[str, object]:
    """Result of a regression."""
    status, begun = await cell.ask("POST", "/regressions", body)
    assert 202 == status, begun
    assert "done" == (await cell.done(begun["task"]))["state"]
    status, result = await cell.ask("GET", f"/regressions/{begun['regression']}")
    assert 200 == status
    return dict(result)


@pytest.mark.long
async def test_a_rig_that_makes_good_cycles_bad_is_signed_for_or_stays_out(
    recorded: Recorded, tmp_path: Path
) -> None:
    """It is refused untried and tried, until a signed reason is given, which the release states. A rig
    that keeps every cycle good needs none. Before, nothing in the cell has changed, and going back is
    always allowed.
    """
    async with cell_of(recorded, tmp_path).running() as cell:
        before = cell.rig.read_bytes()
        bad = solved(cell, wider(recorded.files.rig, 1.02))
        activate = f"/calibrations/{bad}/activate"
        status, problem = await cell.ask("POST", activate, {"note": "new board"})
        assert (409, "regression") == (status, problem["code"])
        assert {"cycles": CYCLES, "good_to_bad": None, "regression": None} == problem["params"]

        result = await tried(cell, {"calibration": bad})
        assert (CYCLES, False) == (result["cycles"], result["passes"])
        assert {"kind": "calibration", "id": bad} == result["what"]
        worse = result["good_to_bad"]
        assert [5, 4, 3, 2, 1, 0] == [one["number"] for one in worse]
        assert {("OK", "LOW_QUALITY")} == {(one["before"], one["after"]) for one in worse}
        assert "TOLERANCE" in worse[0]["reasons"]
        status, picture = await cell.ask("GET", worse[0]["pictures"]["left"].removeprefix("/api/v1"))
        assert (200, b"\xff\xd8") == (status, picture[:2])

        status, problem = await cell.ask("POST", activate, {"note": "new board"})
        assert (409, CYCLES, result["id"]) == (
            status,
            problem["params"]["good_to_bad"],
            problem["params"]["regression"],
        )
        assert before == cell.rig.read_bytes()
        _, releases = await cell.ask("GET", "/releases")
        assert [] == releases["releases"]

        status, release = await cell.ask(
            "POST", activate, {"note": "new board", "signed": "the old parts are gone"}
        )
        assert (200, True) == (status, release["active"])
        tested = {"regression": result["id"], "cycles": CYCLES, "good_to_bad": CYCLES}
        assert {**tested, "signed": "the old parts are gone"} == release["tested"]
        kept = json.loads((cell.state / "releases" / f"{release['number']:04}.json").read_bytes())
        assert release["tested"] == kept["tested"]
        _, audit = await cell.ask("GET", "/audit?most=100")
        reasons = [one["reason"] for one in audit["records"] if "activate" in one["object"]]
        assert "new board; signed: the old parts are gone" == reasons[-1]

        _, differs = await cell.ask("GET", "/releases/1..2")
        assert ("demo", "cal-1.02") == (differs["rig"]["before"], differs["rig"]["after"])
        assert differs["rig"]["moved"]["rms_um"] > 1000
        assert ([], [], []) == (differs["jobs"]["changed"], differs["cameras"], differs["settings"])
        assert 404 == (await cell.ask("GET", "/releases/1..7"))[0]

        status, back = await cell.ask("POST", "/releases/1/activate", {"reason": "it was better"})
        assert (200, 1, "it was better") == (status, back["number"], back["tested"]["signed"])
        assert before == cell.rig.read_bytes()

        fine = solved(cell, wider(recorded.files.rig, 1.000001))
        result = await tried(cell, {"calibration": fine})
        assert (True, CYCLES, []) == (result["passes"], result["counts"]["good_stay"], result["good_to_bad"])
        assert result["motion"] is not None
        status, release = await cell.ask("POST", f"/calibrations/{fine}/activate", {"note": "again"})
        assert (200, 0, None) == (status, release["tested"]["good_to_bad"], release["tested"]["signed"])


@pytest.mark.slow
async def test_a_changed_limit_is_tried_on_all_cycles(recorded: Recorded, tmp_path: Path) -> None:
    """A limit that fails every good cycle is reported; results are kept, newest first, and a damaged one is
    skipped.
    """
    async with cell_of(recorded, tmp_path).running() as cell:
        strict = {"job": "flange", "limits": {"max_sigma_mm": 0.0001}}
        result = await tried(cell, {"change": strict})
        assert (CYCLES, ["SIGMA_LIMIT"]) == (
            result["counts"]["good_to_bad"],
            result["good_to_bad"][0]["reasons"],
        )
        assert None is result["motion"]
        loose = await tried(cell, {"change": {"job": "flange", "limits": {"max_sigma_mm": 1.0}}})
        assert (True, CYCLES, 0) == (loose["passes"], loose["counts"]["good_stay"], loose["counts"]["apart"])
        assert 0.0 == loose["spread"]["max_um"]
        (cell.state / "regressions" / "20990101-000000-0000.json").write_text("{")
        _, listed = await cell.ask("GET", "/regressions")
        assert [loose["id"], result["id"]] == [one["id"] for one in listed["regressions"]]

        for wrong in ({}, {"release": 1, "change": strict}, {"change": {"job": "../x"}}, {"release": 0}):
            assert 400 == (await cell.ask("POST", "/regressions", wrong))[0], wrong
        assert 404 == (await cell.ask("POST", "/regressions", {"release": 7}))[0]
        for body, why in (
            ({"change": {"job": "another"}}, "there is no job another"),
            ({"change": {"job": "flange", "features": {"c0": False}}}, "is the reference"),
        ):
            status, problem = await cell.ask("POST", "/regressions", body)
            assert 422 == status
            assert why in problem["detail"]
        assert 404 == (await cell.ask("GET", "/regressions/20260101-120000-0000"))[0]


@pytest.mark.slow
async def test_a_regression_is_cancelled_and_others_have_their_turn(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Recordings are tried a few at a time with other requests in between; cancelled, no result is kept."""
    monkeypatch.setattr(regressions, "CHUNK_S", 0.0)
    async with cell_of(recorded, tmp_path).running() as cell:
        strict = {"job": "flange", "limits": {"max_sigma_mm": 0.0001}}
        _, begun = await cell.ask("POST", "/regressions", {"change": strict})
        status, told = await cell.ask("POST", "/cycles/2/what-if", {"limits": {"max_sigma_mm": 0.0001}})
        assert (200, "LOW_QUALITY") == (status, told["after"]["status"])
        await cell.ask("DELETE", f"/tasks/{begun['task']}", {})
        ended = await cell.done(begun["task"])
        if ended["state"] == "cancelled":  # unless it was faster
            assert 404 == (await cell.ask("GET", f"/regressions/{begun['regression']}"))[0]


@pytest.mark.long
async def test_a_job_that_was_taught_again_is_tried_as_used(recorded: Recorded, tmp_path: Path) -> None:
    """A job taught again is refused untried, and the files tried are those used."""
    async with cell_of(recorded, tmp_path).running() as cell:
        status, draft = await cell.ask("POST", "/teachings", {"cycle": 1, "job": "flange"})
        assert 201 == status, draft
        place = f"/teachings/{draft['id']}"
        await cell.until(place, lambda draft: draft["features"] and not draft["proposing"])
        status, problem = await cell.ask("POST", f"{place}/activate", {"note": "again"})
        assert (409, "regression") == (status, problem["code"])
        result = await tried(cell, {"teaching": draft["id"]})
        assert ("teaching", CYCLES, None) == (result["what"]["kind"], result["cycles"], result["motion"])
        signed = {} if result["passes"] else {"signed": "as a test wants it"}
        status, release = await cell.ask("POST", f"{place}/activate", {"note": "again", **signed})
        assert (200, result["id"]) == (status, release["tested"]["regression"])
        assert result["counts"]["good_to_bad"] == release["tested"]["good_to_bad"]


@pytest.mark.long
async def test_what_jobs_are_called_is_not_measured(recorded: Recorded, tmp_path: Path) -> None:
    """Renaming, renumbering, copying and retiring need no trial. An edit activated together with a name is
    tried, or signed for.
    """
    async with cell_of(recorded, tmp_path).running() as cell:
        flange = cell.config.parent / "jobs" / "flange"
        for method, place, body, wanted in (
            ("PUT", "flange", {"number": 7}, 200),
            ("POST", "flange/duplicate", {"new_name": "lid", "number": 2}, 201),
            ("PUT", "lid", {"new_name": "cover", "number": 3}, 200),
            ("PUT", "cover", {"retired": True}, 200),
        ):
            status, answer = await cell.ask(method, f"/jobs/{place}", body)
            assert wanted == status, answer
        _, listed = await cell.ask("GET", "/releases")
        assert {None} == {one["tested"] for one in listed["releases"]}
        # by its name: its number is 7 by now
        result = await tried(cell, {"change": {"job": "flange", "limits": {"max_sigma_mm": 0.0001}}})
        assert CYCLES == result["counts"]["good_to_bad"]

        text = flange / "job.toml"
        text.write_text(text.read_text().replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.0001"))
        status, problem = await cell.ask("PUT", "/jobs/flange", {"number": 8})
        assert (409, "regression", CYCLES) == (status, problem["code"], problem["params"]["cycles"])
        status, _ = await cell.ask("PUT", "/jobs/flange", {"number": 8, "signed": "tighter from now on"})
        assert 200 == status
        _, listed = await cell.ask("GET", "/releases")
        assert "tighter from now on" == listed["releases"][0]["tested"]["signed"]


@pytest.mark.slow
def test_a_robot_that_stands_elsewhere_changes_no_measurement(recorded: Recorded) -> None:
    """A registration concerns only jobs with bounds on the robot."""
    contents = dict(recorded.files.contents)
    assert set() == affected_jobs(contents, contents)
    rig = json.loads(contents["rig.json"])
    moved = {**contents, "rig.json": json.dumps({**rig, "robot_from_rig": [[1.0]]}).encode()}
    assert set() == affected_jobs(contents, moved)
    box = b'\n[[limits.box]]\nname = "bin"\nmin_mm = [0, 0, 0]\nmax_mm = [9, 9, 9]\n'
    number = recorded.files.jobs[0].number
    job = contents["jobs/flange/job.toml"]
    bounded = {**contents, "jobs/flange/job.toml": job + box}
    assert {number} == affected_jobs(bounded, {**bounded, "rig.json": moved["rig.json"]})
    assert {number} == affected_jobs(contents, bounded)
    config = {**contents, "cell.toml": contents["cell.toml"] + box}
    assert {number} == affected_jobs(config, {**config, "rig.json": moved["rig.json"]})
    assert None is affected_jobs(contents, {**contents, "rig.json": rig_text(wider(recorded.files.rig, 1.1))})
    for name, data in (("rig.json", b"[]"), ("jobs/flange/job.toml", b"number = 'x'")):
        with pytest.raises(FileFormatError, match=name):
            affected_jobs({**contents, name: data}, contents)
