"""The pictures to practise on are those of a cell that can be calibrated, taught and registered."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import frame_pair

from edged.commands.register import read_touched
from edged.domain.arrays import FloatArray
from edged.files.images import load_image
from edged.files.pairs import find_pairs
from edged.pipeline import PreparedRig, locate, prepare
from edged.robot.touch import register_points
from edged.sim.cell import demo_rig
from edged.vision.boards.board import NotDetected, parse_board
from edged.vision.boards.detection import detect_board
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach
from edged.vision.teaching.region import Region

TOOL = Path(__file__).resolve().parents[2] / "tools" / "practice.py"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the program writes."""
    folder = tmp_path_factory.mktemp("practice")
    subprocess.run([sys.executable, TOOL, folder], check=True)
    return folder


@pytest.mark.slow
def test_every_picture_shows_the_whole_board(folder: Path) -> None:
    """Twenty pairs, 88 corners in each picture."""
    pairs, board = find_pairs(folder / "board"), parse_board("chessboard:11x8:4.0")
    found = [detect_board(load_image(file), board) for pair in pairs for file in (pair.left, pair.right)]

    assert 20 == len(pairs)
    assert {88} == {0 if isinstance(one, NotDetected) else len(one.ids) for one in found}


@pytest.mark.slow
def test_the_touched_points_are_where_the_part_is(folder: Path) -> None:
    """What the robot showed and what edged measures fit to a few hundredths of a millimetre."""
    rig = prepare(demo_rig())
    images = (load_image(folder / "part" / f"part_{side}.png") for side in ("left", "right"))
    job = teach(*images, rig.rectification, Region(530.0, 240.0, 480.0, 480.0), "flange")
    pairs = find_pairs(folder / "touch")
    for pair in pairs:
        place = _place(rig, job, pair.left, pair.right)
        (folder / "touch" / f"{pair.name}.json").write_text(
            f'{{"targets": [{{"reject": [], "position_mm": {place.tolist()}}}]}}'
        )

    names, rig_mm, robot_mm = read_touched(folder / "touch" / "touched.csv")

    assert [pair.name for pair in pairs] == names
    assert np.nanmax(register_points(rig_mm, robot_mm).held_out_mm) < 0.1


def _place(rig: PreparedRig, job: Job, left: Path, right: Path) -> FloatArray:
    (target,) = locate(frame_pair(load_image(left), load_image(right)), job, rig).targets
    return target.position_mm
