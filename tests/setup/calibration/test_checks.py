"""Checking the rig in use over HTTP, on a stage whose true rig is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cellinuse import StillCell
from helpers.smallcell import SmallCell, pictures
from helpers.stagecell import staged

from edged.commands.stage import USER
from edged.domain.frames import Frame, FramePair
from edged.errors import UserError
from edged.files.jobs import load_job
from edged.files.rig import save_rig
from edged.setup.calibration.checks import Checked, Checks, OfferedLength
from edged.setup.calibration.service import FUNCTIONS
from edged.setup.cellfiles import read_any_cell
from edged.setup.jobs.worker import Worker
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import rotation_matrix, transform

BOARD = "chessboard:11x8:4"


@pytest.mark.long
async def test_a_check_says_whether_the_rig_is_what_the_cameras_are(tmp_path: Path) -> None:
    """The true rig holds; half a percent of baseline gives lengths wrong by as much with good rows; a camera
    turned by a pixel gives rows off by as much; without a board there is no verdict.
    """
    async with staged(tmp_path, gige=False) as newcomer:
        body = {**newcomer.token, "board": BOARD}
        true = newcomer.world.cell.rig
        seen = (await newcomer.ask("GET", "cameras"))["found"]
        assert ["left", "right"] == [one["side"] for one in seen], "whatever else answers on this machine"
        nothing = {"last": None, "is_current": False, "boards": [], "parts": []}
        assert nothing == await newcomer.ask("GET", "checks")
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        refused = await newcomer.ask("POST", "checks", body, 409)
        assert "there is no calibration to check: calibrate first" == refused["detail"]

        lengths = {**newcomer.token, "job": "flange", "lengths": {"c0": 28.0}}
        assert "there is no job flange" == (await newcomer.ask("POST", "checks", lengths, 422))["detail"]
        for wrong in ({}, {"board": BOARD, "job": "flange"}, {"job": "flange"}, {"lengths": {"c0": 28.0}}):
            problem = await newcomer.ask("POST", "checks", {**newcomer.token, **wrong}, 400)
            assert "expected either board, or job with lengths" in problem["detail"], wrong

        async def checked(rig: StereoRig) -> dict[str, object]:
            save_rig(tmp_path / "rig.json", rig)
            await newcomer.browser.reload(newcomer.daemon)
            document = await newcomer.ask("POST", "checks", body, 201)
            assert rig.calibration_id == document["calibration"]
            return dict(document)

        # with half a percent of baseline every length is half a percent longer, and every row unchanged
        relation = true.right_from_left.copy()
        relation[:3, 3] *= 1.005
        wide = await checked(replace(true, right_from_left=relation, calibration_id="wide"))
        (length,) = wide["lengths"]
        assert ("NOT_OK", "OK", "NOT_OK") == (wide["verdict"], wide["rows"]["verdict"], length["verdict"])
        assert 0.5 == pytest.approx(length["error_percent"], abs=0.05)
        assert 0.1 == length["limit_percent"]

        # about its X axis, by the angle of a pixel
        turn = transform(rotation_matrix(np.array([1 / true.right.matrix[1, 1], 0, 0])), np.zeros(3))
        turned = replace(true, right_from_left=turn @ true.right_from_left, calibration_id="turned")
        rows = (await checked(turned))["rows"]
        assert ("NOT_OK", 0.3) == (rows["verdict"], rows["limit_px"])
        assert 1.0 == pytest.approx(rows["measured_px"], abs=0.15)

        good = await checked(true)
        (length,) = good["lengths"]
        assert ("OK", USER, BOARD, "") == (good["verdict"], good["by"], good["board"], good["reason"])
        assert abs(length["error_percent"]) + length["spread_percent"] < 0.1
        assert np.hypot(40, 28) == pytest.approx(length["true_mm"])
        known = await newcomer.ask("GET", "checks")
        assert {"last": good, "is_current": True, "boards": [BOARD], "parts": []} == known

        await newcomer.ask("PUT", "stage", {"showing": "nothing"})
        unseen = await newcomer.ask("POST", "checks", body, 201)
        assert ("UNDECIDED", None, []) == (unseen["verdict"], unseen["rows"], unseen["lengths"])
        assert "left: no 11x8 inner corners found" == unseen["reason"]

        deeds = (await newcomer.ask("GET", "audit?most=100"))["records"]
        noted = [(one["object"], one["outcome"]) for one in deeds if one["object"].startswith("checks")]
        judged = [
            "wide NOT_OK",
            "turned NOT_OK",
            *(f"{true.calibration_id} {one}" for one in ("OK", "UNDECIDED")),
        ]
        noted = [one for one in noted if one[1] not in ("input_no_job", "invalid")]
        assert [("checks", "setup_refused"), *((f"checks/{one}", "ok") for one in judged)] == noted

        quality = {"board": f"dots:7x7:5,{BOARD}"}
        save_rig(tmp_path / "rig.json", replace(true, calibration_id="another"), quality)
        await newcomer.browser.reload(newcomer.daemon)
        known = {"last": unseen, "is_current": False, "boards": ["dots:7x7:5", BOARD], "parts": []}
        assert known == await newcomer.ask("GET", "checks")


def _size(length: OfferedLength) -> tuple[str, float | None]:
    return length.name, length.taught_mm and round(length.taught_mm, 1)


@pytest.mark.slow
async def test_a_part_of_known_size_says_whether_the_rig_holds(tmp_path: Path) -> None:
    """The part's diameter is as drawn, and a baseline one percent too long makes it one percent too large."""
    cell = SmallCell(tmp_path / "cell", source="virtual-inprocess")
    left, right = pictures(cell.virtual, 1)[0]
    pair = FramePair(Frame("left", 1, left, 0, 0), Frame("right", 1, right, 0, 0))
    job, true = load_job(tmp_path / "cell" / "jobs" / "flange"), cell.virtual.rig
    relation = true.right_from_left.copy()
    relation[:3, 3] *= 1.01
    wide = replace(true, right_from_left=relation, calibration_id="wide")
    running = StillCell(cell.config)
    running.session.pair = pair
    in_use = running.in_use(worker := Worker(FUNCTIONS))
    checks, kept = Checks(in_use), in_use.folder / "check.json"
    found = []
    try:
        for rig in (true, wide):
            save_rig(in_use.files.config.cell.rig, rig)
            running.files = read_any_cell(cell.config)
            found.append(await checks.by_part("theirs", "Anna", job.name, {"c0": 28.0}))
            known = await checks.last()
            assert Checked(last=found[-1], is_current=True, boards=[], parts=known.parts) == known
            (part,) = known.parts
            assert (job.name, "c0", 28.0) == (part.job, *_size(part.lengths[0]))
        with pytest.raises(UserError, match="length c9: the job has c0"):
            await checks.by_part("theirs", "Anna", job.name, {"c9": 28.0})
        kept.write_text("{")
        assert None is (await checks.last()).last
    finally:
        await worker.close()
    good, wrong = found
    (true_length,), (long_length,) = good.lengths, wrong.lengths
    assert abs(true_length.error_percent) <= true_length.spread_percent
    assert "NOT_OK" == wrong.verdict == long_length.verdict
    assert 1.0 == pytest.approx(long_length.error_percent - true_length.error_percent, abs=0.05)
    assert (job.name, None) == (good.job, good.board)
