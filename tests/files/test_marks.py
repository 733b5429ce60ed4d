"""Files of reference marks: they read back equal, every flaw is named, hostile ones do no harm."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.markedday import new_day

from edged.errors import FileFormatError
from edged.files.marks import MAX_MARKS_BYTES, marks_file, marks_of, read_marks, save_marks
from edged.vision.marks.taught import TaughtMarks
from edged.vision.marks.tracking import MarksFilter

TAUGHT: TaughtMarks = new_day(0).taught
RIG = TAUGHT.rig


def written(folder: Path) -> tuple[Path, dict[str, Any]]:
    """A file of good marks, and its document."""
    path = marks_file(folder / "rig.json")
    save_marks(path, TAUGHT)
    return path, json.loads(path.read_bytes())


def test_marks_come_back_to_the_last_bit(tmp_path: Path) -> None:
    """Marks read back exactly, and give an equal filter."""
    path, _ = written(tmp_path)
    again = marks_of(read_marks(path), path, RIG)
    assert again is not None
    for name in (
        "pixels",
        "sigma_px",
        "shapes",
        "covariance",
        "residual_px",
        "blur_px",
        "noise",
        "exposures",
    ):
        np.testing.assert_equal(getattr(again, name), getattr(TAUGHT, name), name)
    for name in ("codes", "places_mm", "along_mm", "normal", "radius_mm"):
        np.testing.assert_equal(getattr(again.placed, name), getattr(TAUGHT.placed, name), name)
    assert np.array_equal(MarksFilter(again).considered, MarksFilter(TAUGHT).considered)
    assert [path] == list(tmp_path.iterdir())


def test_marks_of_another_calibration_are_none(tmp_path: Path) -> None:
    """Marks of another calibration count as none, not as damage."""
    path, _ = written(tmp_path)
    assert marks_of(read_marks(path), path, replace(RIG, calibration_id="other")) is None


def test_marks_that_this_rig_cannot_see_there_are_refused(tmp_path: Path) -> None:
    """Marks that do not fit the rig, with the same calibration's name, are refused."""
    path, _ = written(tmp_path)
    moved = np.array(RIG.right_from_left)
    moved[0, 3] += 5.0
    with pytest.raises(FileFormatError, match="places_mm"):
        marks_of(read_marks(path), path, replace(RIG, right_from_left=moved))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"format": "edged-rig"}, "not a file of reference marks"),
        ({"version": 2}, "version 2, this edged reads 1"),
        ({"calibration_id": 3}, "calibration_id: expected a name"),
        ({"codes": [1, 2]}, "codes: 2 marks: expected 6 to 64"),
        ({"codes": [1, 1, 2, 3, 4, 5, 6, 7]}, "codes: expected whole numbers"),
        ({"codes": [True, 2, 3, 4, 5, 6, 7, 8]}, "codes: expected whole numbers"),
        ({"codes": [1, 2, 3, 4, 5, 6, 7, 1000]}, "codes: expected whole numbers"),
        ({"codes": "40"}, "codes: expected whole numbers"),
        ({"codes": [1, 2, 3, 4, 5, 6]}, r"places_mm: expected finite numbers in the shape \(6, 3\)"),
        ({"places_mm": [[1e999] * 3] * 8}, "places_mm|not JSON"),
        ({"places_mm": [[0, 0, -200]] * 8}, "places_mm: expected places before the camera"),
        ({"places_mm": [[0, 0, 200]] * 8}, "places_mm: .* px from where this rig"),
        ({"along_mm": [[0, 0, 0]] * 8}, "along_mm: expected the way"),
        ({"normal": [0, 0, 2]}, "normal: expected a direction"),
        ({"radius_mm": [-1] * 8}, "radius_mm: expected numbers above 0"),
        ({"sigma_px": [[0] * 8] * 2}, "sigma_px: expected numbers above 0"),
        ({"blur_px": [0.7]}, "blur_px: expected finite numbers in the shape"),
        ({"shapes": [[[1, 2, 1]] * 8] * 2}, "shapes: expected ellipses"),
        ({"noise": 0.5}, "noise: expected at least 1"),
        ({"noise": "1"}, "noise: expected a number"),
        ({"pixels": None}, "pixels: expected"),
        ({"covariance": [[1.0]]}, "covariance: expected finite numbers in the shape"),
        ({"covariance": (-np.eye(24)).tolist()}, "covariance: not a covariance"),
        ({"exposures": -1}, "exposures: expected a whole number"),
        ({"exposed_ns": 2**63}, "exposed_ns: expected a whole number"),
    ],
)
def test_a_flaw_is_named(tmp_path: Path, changes: dict[str, Any], why: str) -> None:
    """A flaw is refused with the file, the field and what was expected."""
    path, document = written(tmp_path)
    path.write_text(json.dumps({**document, **changes}))
    with pytest.raises(FileFormatError, match=why) as caught:
        marks_of(read_marks(path), path, RIG)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"{", b"[" * 100_000, b"null", b'{"format": "edged-marks"}', b"\xff"])
def test_what_is_no_file_of_marks_is_refused(tmp_path: Path, data: bytes) -> None:
    """A file that is no file of marks is refused with a FileFormatError."""
    with pytest.raises(FileFormatError):
        marks_of(data, tmp_path / "marks.json", RIG)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    """A too large file is refused by its size."""
    path = tmp_path / "marks.json"
    path.write_bytes(b" " * (MAX_MARKS_BYTES + 1))
    with pytest.raises(FileFormatError):
        read_marks(path)
    with pytest.raises(FileFormatError):
        marks_of(b" " * (MAX_MARKS_BYTES + 1), path, RIG)
