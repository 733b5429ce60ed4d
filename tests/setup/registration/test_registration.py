"""Registering without a console: the same numbers as the commands, and solving saves nothing."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from helpers.rigs import make_rig
from rich.console import Console

from edged.commands.register import touch
from edged.files.rig import load_rig, load_rig_quality, save_rig
from edged.setup.registration.registering import from_points, save
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

ROBOT_FROM_RIG = transform(rotation_matrix(np.array([2.0, 0.3, -0.4])), np.array([600.0, -40.0, 900.0]))


@pytest.mark.parametrize("limit_mm", [0.5, 1e-4])
def test_touched_points_give_the_same_registration(
    limit_mm: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The result is bit-identical to the command's, and above the limit nothing is saved."""
    source, by_command, by_hand = (tmp_path / f"{name}.json" for name in ("rig", "command", "hand"))
    save_rig(source, make_rig(), {"views": 6})
    random = np.random.default_rng(4)
    rig_mm = random.uniform(-80, 80, (6, 3)).round(3) + np.array([0, 0, 400.0])
    robot_mm = (apply(ROBOT_FROM_RIG, rig_mm) + random.normal(0, 0.02, (6, 3))).round(3)
    rows = np.hstack([rig_mm, robot_mm])
    points = tmp_path / "points.csv"
    points.write_text("\n".join(",".join(repr(float(value)) for value in row) for row in rows))

    solved = from_points(load_rig(source), rig_mm, robot_mm, limit_mm)
    assert not by_hand.exists()
    code = touch(source, points, by_command, limit_mm, True, Console(file=io.StringIO()))
    said = json.loads(capsys.readouterr().out)

    assert code == (0 if solved.good else 1)
    assert said["robot_from_rig"] == solved.found.robot_from_rig.tolist()
    assert said["rms_mm"] == solved.found.rms_mm
    assert said["scale"] == solved.found.scale
    assert by_command.exists() == solved.good == (limit_mm == 0.5)
    if solved.good:
        save(source, solved.registered, by_hand)
        one, other = load_rig(by_command), load_rig(by_hand)
        assert one.calibration_id == other.calibration_id
        for name in ("robot_from_rig", "registration_covariance"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
        kept, again = load_rig_quality(by_command), load_rig_quality(by_hand)
        assert kept["views"] == again["views"] == 6
        del kept["registration"]["when"], again["registration"]["when"]
        assert kept == again
