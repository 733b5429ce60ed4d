"""`edged golden`: the golden part of a job from one pair of pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import flange, frame_pair, small_rig
from helpers.commandline import exit_code
from helpers.snapshots import make_transform

from edged.commands.demo import DemoOptions, prepare_cell
from edged.files.golden import golden_file, load_golden
from edged.files.jobs import load_job
from edged.files.rig import save_rig
from edged.pipeline import locate, prepare
from edged.sim.cell import VirtualCell, demo_part

ROBOT_FROM_RIG = make_transform((0.4, 1.1, -0.7), (500.0, -200.0, 300.0))


@pytest.mark.slow
def test_the_part_of_a_pair_becomes_the_golden_one_or_it_is_said_why_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The kept pose is that of `edged locate` in the robot's frame; an empty table or no robot keeps
    nothing."""
    prepare_cell(tmp_path, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)
    part, job = flange(), tmp_path / "jobs" / "flange"
    rig, alone, carried = (tmp_path / name for name in ("rig.json", "alone.json", "carried.json"))
    save_rig(rig, replace(part.rig, robot_from_rig=ROBOT_FROM_RIG))
    save_rig(alone, replace(part.rig, robot_from_rig=None))
    save_rig(carried, replace(part.rig, robot_from_rig=None, flange_from_rig=np.eye(4)))
    for name, image in (("left", part.left), ("right", part.right), ("blank", np.full_like(part.left, 50))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    pair = [tmp_path / "left.png", tmp_path / "right.png"]
    assert 0 == exit_code("golden", "--rig", rig, "--job", job, *pair)
    assert "kept" in capsys.readouterr().out
    kept = load_golden(golden_file(rig, 1))
    (target,) = locate(frame_pair(part.left, part.right), load_job(job), prepare(part.rig)).targets
    np.testing.assert_allclose(kept.robot_from_part, ROBOT_FROM_RIG @ target.rig_from_part, atol=1e-9)
    before = golden_file(rig, 1).read_bytes()
    assert 1 == exit_code("golden", "--rig", rig, "--job", job, *[tmp_path / "blank.png"] * 2)
    assert "nothing was kept: no good part" in " ".join(capsys.readouterr().out.split())
    for wrong, why in ((alone, "not registered"), (carried, "its program say GOLDEN")):
        assert 2 == exit_code("golden", "--rig", wrong, "--job", job, *pair)
        assert why in " ".join(capsys.readouterr().err.split())
    assert before == golden_file(rig, 1).read_bytes()
