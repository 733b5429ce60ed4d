"""Files of golden parts: they read back equal, and every flaw is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.snapshots import make_transform

from edged.domain.golden import Golden
from edged.errors import FileFormatError
from edged.files.golden import golden_file, load_golden, save_golden

GOLDEN = Golden(
    number=3,
    job="flange",
    part="0123456789abcdef",
    calibration_id="cal-1",
    registration="fedcba9876543210",
    exposed_ns=1_700_000_000_000_000_001,
    robot_from_rig=make_transform((2.8, 0.3, -0.4), (400.0, -700.0, 900.0)),
    rig_from_part=make_transform((0.1, -0.2, 0.3), (1.0, 2.0, 250.0)),
    covariance=np.diag([1e-6, 1e-6, 4e-6, 1e-8, 1e-8, 1e-9]),
    own=1e-9 * np.eye(6),
    points_mm=np.array([[0.1, 0.2, 250.0], [8.0, 0.0, 251.0], [0.0, 9.0, 249.0]]),
    free_axis=np.array([0.0, 0.0, 1.0]),
)


def test_a_golden_part_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    """A golden part reads back exactly, also after replacing another, and without a free axis or points."""
    path = golden_file(tmp_path / "rig.json", 3)
    save_golden(path, replace(GOLDEN, number=4))
    for golden in (GOLDEN, replace(GOLDEN, free_axis=None, points_mm=np.zeros((0, 3)))):
        save_golden(path, golden)
        again = load_golden(path)
        for name in Golden.__slots__:
            np.testing.assert_equal(getattr(again, name), getattr(golden, name), name)
    assert [path] == list(path.parent.iterdir())


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"format": "edged-rig"}, "not a golden part"),
        ({"version": 2}, "version 2, this edged reads 1"),
        ({"number": -1}, "number: expected a whole number"),
        ({"number": True}, "number: expected a whole number"),
        ({"part": "../../etc"}, "part: expected 16 hex digits"),
        ({"calibration_id": ""}, "calibration_id: expected a name"),
        ({"registration": None}, "registration: expected a name"),
        ({"exposed_ns": 1.5}, "exposed_ns: expected a whole number"),
        ({"robot_from_rig": (2 * np.eye(4)).tolist()}, "robot_from_rig: expected a rigid"),
        ({"rig_from_part": [[1.0]]}, "rig_from_part: expected finite numbers in the shape (4, 4)"),
        ({"robot_from_part": np.eye(4).tolist()}, "robot_from_part: expected robot_from_rig times"),
        ({"covariance": (-np.eye(6)).tolist()}, "covariance: not a covariance"),
        ({"own_covariance": [["a"]]}, "own_covariance: expected numbers"),
        ({"points_mm": [[0, 0, 1]] * 2000}, "points_mm: 2000 points"),
        ({"points_mm": [[0, 0, -1]]}, "points_mm: expected points before the camera"),
        ({"free_axis": [0, 0, 2]}, "free_axis: expected a direction of length 1"),
    ],
)
def test_a_damaged_file_is_refused_by_the_name_of_its_field(
    tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    """A damaged file is refused with the field and the reason."""
    path = golden_file(tmp_path / "rig.json", 3)
    save_golden(path, GOLDEN)
    path.write_text(json.dumps(json.loads(path.read_bytes()) | changes))
    with pytest.raises(FileFormatError) as caught:
        load_golden(path)
    assert str(path) in str(caught.value) and why in str(caught.value)


@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"\xff\xfe", b'{"format": NaN}', b"[" * 100_000, b" " * 300_000]
)
def test_what_is_no_such_file_is_refused(tmp_path: Path, data: bytes) -> None:
    """A truncated, foreign, too large or too deep file is refused."""
    path = tmp_path / "1.json"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="1\\.json"):
        load_golden(path)
