"""Boards in 3D by a calibration without them: real pairs, drawn pairs, and wrong input."""

from __future__ import annotations

import functools
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import bench_boards
import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board, right_pose
from helpers.cells import small_rig

from edged.files.pairs import ImagePair
from edged.vision.boards.board import Chessboard

REAL = Path(__file__).resolve().parents[1] / "data" / "stereo-chessboard"


@functools.cache
def real() -> bench_boards.Folder:
    """Eight of the real pairs, detected and measured once."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("01", "04", "05", "08", "09", "11", "13", "14"):
            for path in REAL.glob(f"{name}_*.jpg"):
                shutil.copy(path, folder)
        found = bench_boards.read_folder(Path(folder), "chessboard:9x6:1", "brown")
    pairs = {
        name: ImagePair(name, REAL / pair.left.name, REAL / pair.right.name)
        for name, pair in found.pairs.items()
    }
    return replace(found, pairs=pairs)


@pytest.mark.long
@pytest.mark.parametrize("name", ["08", "14"])
def test_a_real_board_is_as_large_and_flat_as_the_calibration_allows(name: str) -> None:
    """A held-out board has its size within 3 sigma and is as flat as its covariance predicts.

    Pair 14 was taken at one instant, and the calibration alone explains it. In pair 08 the board moved
    between the two pictures; the rows show it, and its sigma includes that.
    """
    fit, edges = bench_boards.held_out(real(), name)

    for row in (fit, edges):
        assert row.marks == 54
        assert abs(row.size_error) < 3 * (row.size_sigma if name == "14" else row.size_sigma_rows)
        assert row.flatness_mm < 1.2 * row.flatness_predicted_mm
        assert row.chi2_per_dof < (1.5 if name == "14" else 4.0)
    assert abs(fit.size_error - edges.size_error) < 3e-4
    assert (fit.rows_px > 0.1) == (name == "08")


def drawn(folder: Path, count: int) -> None:
    """Draw pairs of a board of 9x6 inner corners, 3.5 mm, with noise of 2 grey values."""
    rig, board = small_rig(), Chessboard(9, 6, 3.5)
    for number, left_from_board in enumerate(board_poses(rig, board, count, seed=5)):
        views = (rig.left, left_from_board), (rig.right, right_pose(rig, left_from_board))
        for side, (camera, camera_from_board) in zip(("left", "right"), views, strict=True):
            image = draw_board(
                board, camera, camera_from_board, noise=2.0, seed=2 * number + (side == "left")
            )
            cv2.imwrite(str(folder / f"{number:02}_{side}.png"), image)


@pytest.mark.long
def test_pictures_that_are_right_have_the_stated_sigma(tmp_path: Path) -> None:
    """Drawn pairs have residuals and flatness as predicted, and sizes within their sigma."""
    drawn(tmp_path, 8)
    folder = bench_boards.read_folder(tmp_path, "chessboard:9x6:3.5", "division")
    rows = [row for name in list(folder.pairs)[:3] for row in bench_boards.held_out(folder, name)]

    assert len(rows) == 6
    for kind in ("fit", "edges"):
        chosen = [row for row in rows if row.corners == kind]
        assert 0.5 < np.mean([row.chi2_per_dof for row in chosen]) < 1.6
        assert 0.6 < np.mean([row.flatness_mm / row.flatness_predicted_mm for row in chosen]) < 1.4
        assert np.mean([(row.size_error / row.size_sigma) ** 2 for row in chosen]) < 4
        assert max(row.rows_px for row in chosen) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pairs", "board", "expected"),
    [
        (None, "chessboard:9x6:3.5", "not a folder"),
        (0, "chessboard:9x6:3.5", "no pictures NAME_left"),
        (3, "chessboard:9x6:3.5", "3 usable pairs; expected more than 3"),
        (0, "dots:7x7:5", "expected a chessboard"),
        (0, "chessboard:9", "expected chessboard:COLSxROWS:SQUARE_MM"),
    ],
)
def test_what_cannot_be_measured_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    pairs: int | None,
    board: str,
    expected: str,
) -> None:
    """No folder, no pictures, too few and another board give exit code 2 and the reason."""
    if pairs:
        drawn(tmp_path, pairs)
    folder = tmp_path / "nowhere" if pairs is None else tmp_path
    monkeypatch.setattr(
        sys, "argv", ["bench_boards.py", str(folder), "--board", board, "--model", "division"]
    )

    assert bench_boards.main() == 2
    assert expected in capsys.readouterr().err
