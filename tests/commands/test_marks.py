"""`edged marks`: taught from a folder of pairs, checked in one pair; every wrong input is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commandline import exit_code, printed
from helpers.markedcell import marked_cell, pair_at, write_pairs

from edged.domain.frames import Frame, FramePair
from edged.files.marks import marks_file
from edged.files.rig import save_rig
from edged.sim.cell import demo_rig
from edged.sim.weather import Knock


@pytest.mark.long
def test_fifty_pairs_teach_what_one_pair_is_compared_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A still cell is corrected; after a knock there is no result, and the dots' displacements are listed."""
    rig, shots = tmp_path / "rig.json", tmp_path / "shots"
    save_rig(rig, demo_rig())
    cell = marked_cell(Knock(100.0, "left", (1.0, 0.0, 0.0)))
    first = pair_at(cell, 0)
    noise = np.random.default_rng(1)

    def again() -> FramePair:
        frames = []
        for frame in (first.left, first.right):
            image = np.clip(frame.image + noise.normal(0, 1, frame.image.shape), 0, 255)
            frames.append(Frame(frame.camera, 0, image.astype(np.uint8), 0, 0))
        return FramePair(*frames)

    write_pairs(shots, [again() for _ in range(50)])
    assert 0 == exit_code("marks", "teach", shots, "--rig", rig)
    words = printed(capsys)
    assert "8 marks taught of 50 exposures, codes 0, 1, 2, 3, 4, 5, 6, 7" in words
    assert "one sigma X" in words
    write_pairs(tmp_path, [pair_at(cell, 1), pair_at(cell, 200)])
    still, knocked = (
        [tmp_path / f"view_{number:03d}_{side}.png" for side in ("left", "right")] for number in range(2)
    )
    assert 0 == exit_code("marks", "status", "--rig", rig, *still)
    assert "CORRECTED" in printed(capsys)
    assert 1 == exit_code("marks", "status", "--rig", rig, "--json", *knocked)
    answer = json.loads(capsys.readouterr().out)
    assert ("KNOCKED", False) == (answer["marks"]["state"], answer["marks"]["valid"])
    assert 14 < abs(answer["moved_px"]["3"]["left"][0]) < 17
    assert abs(answer["moved_px"]["3"]["right"][0]) < 0.05
    document = json.loads(marks_file(rig).read_bytes())
    marks_file(rig).write_text(json.dumps({**document, "calibration_id": "older"}))
    assert 2 == exit_code("marks", "status", "--rig", rig, *still)
    assert "another calibration" in printed(capsys)


@pytest.mark.slow
def test_what_cannot_be_taught_says_why_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Too few pairs, no marks, another size, a rig on the flange and no folder each give a reason."""
    rig, carried, shots = tmp_path / "rig.json", tmp_path / "carried.json", tmp_path / "shots"
    save_rig(rig, demo_rig())
    save_rig(carried, replace(demo_rig(), robot_from_rig=None, flange_from_rig=np.eye(4)))
    shots.mkdir()
    blank = np.full((960, 1280), 90, np.uint8)
    for number in range(50):
        for side in ("left", "right"):
            cv2.imwrite(str(shots / f"v{number}_{side}.png"), blank)
    assert 2 == exit_code("marks", "teach", shots, "--rig", rig)
    assert "0 reference marks are in both pictures" in printed(capsys)
    assert 2 == exit_code("marks", "teach", shots, "--rig", carried)
    assert "the robot carries the cameras" in printed(capsys)
    cv2.imwrite(str(shots / "v0_left.png"), blank[:100])
    assert 2 == exit_code("marks", "teach", shots, "--rig", rig)
    assert "1280x100, the rig was calibrated for 1280x960" in printed(capsys)
    (shots / "v1_left.png").unlink()
    (shots / "v1_right.png").unlink()
    assert 2 == exit_code("marks", "teach", shots, "--rig", rig)
    assert "49 pairs, at least 50" in printed(capsys)
    assert 2 == exit_code("marks", "teach", tmp_path / "none", "--rig", rig)
    assert "not a folder" in printed(capsys)
    assert 2 == exit_code("marks", "status", "--rig", rig, shots / "v2_left.png", shots / "v2_right.png")
    assert "marks.json" in printed(capsys)
    assert not marks_file(rig).exists()
