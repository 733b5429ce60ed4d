"""`edged grasp touch`: a grasp from the robot's pose when it takes the part."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import flange, frame_pair, small_rig
from helpers.commandline import exit_code
from helpers.snapshots import make_transform

from edged.commands.demo import DemoOptions, prepare_cell
from edged.files.jobs import load_job
from edged.files.rig import save_rig
from edged.pipeline import locate, prepare
from edged.robot.orientations import Brand, pose_of
from edged.sim.cell import VirtualCell, demo_part

ROBOT_FROM_RIG = make_transform((0.4, 1.1, -0.7), (500.0, -200.0, 300.0))
PART_FROM_TCP = make_transform((0.0, 0.3, 1.2), (12.0, -7.0, 4.0))


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a cell whose job is the flange."""
    folder = tmp_path_factory.mktemp("cell")
    prepare_cell(folder, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)
    return folder


@pytest.fixture
def folder(cell: Path, tmp_path: Path) -> Path:
    """A rig with a robot, one without, a job and pictures of its part."""
    part = flange()
    save_rig(tmp_path / "rig.json", dataclasses.replace(part.rig, robot_from_rig=ROBOT_FROM_RIG))
    save_rig(tmp_path / "alone.json", dataclasses.replace(part.rig, robot_from_rig=None))
    shutil.copytree(cell / "jobs" / "flange", tmp_path / "flange")
    for side, image in (("left", part.left), ("right", part.right)):
        cv2.imwrite(str(tmp_path / f"{side}.png"), image)
    cv2.imwrite(str(tmp_path / "blank.png"), np.full_like(part.left, 50))
    return tmp_path


def arguments(folder: Path, brand: Brand, pose: str, left: str = "left.png") -> list[object]:
    """Arguments of a touch by a robot of a brand."""
    job, rig = folder / "flange", folder / "rig.json"
    options = ["--rig", rig, "--job", job, "--brand", brand, "--pose", pose, "--name", "rim"]
    return [*options, folder / left, folder / "right.png"]


def where(folder: Path, brand: Brand) -> str:
    """The pose that the controller shows when the tool stands at PART_FROM_TCP."""
    part = flange()
    job, rig = load_job(folder / "flange"), prepare(part.rig)
    (target,) = locate(frame_pair(part.left, part.right), job, rig).targets
    robot_from_tcp = ROBOT_FROM_RIG @ target.rig_from_part @ PART_FROM_TCP
    return ",".join(f"{number:.9f}" for number in pose_of(brand, robot_from_tcp))


@pytest.mark.slow
@pytest.mark.parametrize("brand", [Brand.KUKA, Brand.ABB, Brand.UR])
def test_where_the_robot_stands_becomes_a_grasp(
    folder: Path, brand: Brand, capsys: pytest.CaptureFixture[str]
) -> None:
    """The grasp is in the part's frame, to a micrometre, and the rest of the job file is unchanged."""
    path = folder / "flange" / "job.toml"
    before = path.read_text()
    assert 0 == exit_code("grasp", "touch", *arguments(folder, brand, where(folder, brand)), "--symmetry", 3)
    assert path.read_text().startswith(before.rstrip())
    (grasp,) = load_job(folder / "flange").picking.grasps
    assert ("rim", 50.0, 50.0, 3) == (grasp.name, grasp.approach_mm, grasp.retreat_mm, grasp.symmetry)
    np.testing.assert_allclose(grasp.part_from_tcp, PART_FROM_TCP, atol=1e-3)
    assert "one sigma of the tip" in capsys.readouterr().out


@pytest.mark.long
def test_what_cannot_become_a_grasp_is_said_and_nothing_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No part gives 1; no robot, no brand, an invalid pose and a used name give 2 with what was expected."""
    path = folder / "flange" / "job.toml"
    before, pose = path.read_text(), where(folder, Brand.KUKA)
    assert 1 == exit_code("grasp", "touch", *arguments(folder, Brand.KUKA, pose, "blank.png"))
    assert "NO_TARGET" in capsys.readouterr().out
    good = arguments(folder, Brand.KUKA, pose)
    for change, message in (
        (["--rig", folder / "alone.json"], "not registered to a robot"),
        (["--brand", "acme"], "--brand acme: expected one of ur, kuka"),
        (["--pose", "1,2,3"], "--pose 1,2,3: expected 6 numbers"),
        (["--pose", "1,2,3,4,5,nan"], "expected a finite number"),
        (["--pose", "here"], "--pose here"),
        (["--pose", "1e9,0,0,0,0,0"], "position_mm"),
        (["--name", "a b"], "name"),
        (["--symmetry", "999"], "symmetry"),
    ):
        assert 2 == exit_code("grasp", "touch", *good[:-2], *change, *good[-2:])
        assert message in capsys.readouterr().err
        assert before == path.read_text()
    assert 0 == exit_code("grasp", "touch", *good)
    assert 2 == exit_code("grasp", "touch", *good)
    assert "two grasps have one name" in capsys.readouterr().err
