"""`edged register marks`: a new calibration keeps the robot's registration by means of reference marks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.commandline import exit_code
from helpers.markedplate import AT, pair, taught
from helpers.snapshots import make_transform

from edged.files.marks import keep_old_marks, marks_file, save_marks
from edged.files.rig import load_rig, save_rig
from edged.sim.cell import demo_rig
from edged.vision.geometry.rigid import invert, rotation_vector
from edged.vision.marks.taught import teach_marks

OLD_FROM_NEW = make_transform((0.003, -0.002, 0.004), (0.3, -0.4, 1.0))
"""From the left camera's new frame to its former one, after the cameras were remounted."""


@pytest.mark.long
def test_the_robot_stays_known_over_a_new_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The registration is right to micrometres at the part, with a covariance; wrong files are named."""
    robot_from_old = make_transform((0.1, 3.0, 0.2), (400.0, -60.0, 500.0))
    known = np.diag([1e-4, 1e-4, 1e-4, 1e-10, 1e-10, 1e-10])
    old, new = tmp_path / "old.json", tmp_path / "rig.json"
    save_rig(old, replace(demo_rig(), robot_from_rig=robot_from_old, registration_covariance=known))
    anew = replace(demo_rig(), calibration_id="anew", robot_from_rig=None)
    save_rig(new, anew)
    save_marks(marks_file(old), taught())
    kept = keep_old_marks(marks_file(old), "anew")
    assert kept == tmp_path / "marks.demo.json"
    assert keep_old_marks(marks_file(old), "demo") is None
    again = teach_marks((pair(invert(OLD_FROM_NEW) @ AT, k) for k in range(50, 60)), anew, 9, least=10)
    save_marks(marks_file(new), again)
    given = ("--rig", new, "--former", old, "--former-marks", kept, "-o", tmp_path / "out.json")
    assert 0 == exit_code("register", "marks", *given)
    found = load_rig(tmp_path / "out.json")
    assert found.robot_from_rig is not None
    assert found.registration_covariance is not None
    error = found.robot_from_rig @ invert(robot_from_old @ OLD_FROM_NEW)
    part = (robot_from_old @ AT)[:3, 3]
    assert np.linalg.norm(error[:3, :3] @ part + error[:3, 3] - part) < 0.005
    assert np.linalg.norm(rotation_vector(error[:3, :3])) < 2e-4
    assert (np.diag(found.registration_covariance) >= np.diag(known)).all()
    assert found.calibration_id == "anew"

    capsys.readouterr()
    assert 1 == exit_code("register", "marks", *given, "--limit", 1e-6)
    assert "or the plate was moved between both teachings: nothing was saved" in " ".join(
        capsys.readouterr().out.split()
    )
    assert 2 == exit_code("register", "marks", *given[:2], "--former", new, *given[4:])
    assert "the same calibration" in capsys.readouterr().err
    assert 2 == exit_code("register", "marks", *given[:4], "--former-marks", marks_file(new), *given[6:])
    assert "taught with another calibration" in " ".join(capsys.readouterr().err.split())
    save_rig(old, replace(demo_rig(), robot_from_rig=None))
    assert 2 == exit_code("register", "marks", *given)
    assert "not registered to a robot" in " ".join(capsys.readouterr().err.split())
