"""A board's own shape: found if it is bent, not invented if it is flat, with the stated size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boards import board_poses, parameter_error, synthetic_views
from helpers.rigs import make_rig

from edged.domain.arrays import FloatArray
from edged.vision.boards.board import Board, Chessboard, CircleGrid, DotBoard, ShapedBoard, StereoView
from edged.vision.boards.deformation import deviation_mm, nominal, plate_basis, shaped
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.geometry.rigid import fit_rigid

RIG = make_rig()
SIZE = RIG.left.width, RIG.left.height
BOARD = Chessboard(11, 8, 4.0)
OTHER = DotBoard(7, 7, 5.0, 2.5)


def bent(board: Chessboard | DotBoard) -> ShapedBoard:
    """Arched by 40 µm, twisted, and printed a little oblong."""
    points = board.points_mm
    x, y = (points[:, :2] / points[:, :2].max(axis=0)).T - 0.5
    return ShapedBoard(board, points + np.column_stack([0.01 * x, -0.01 * y, 0.16 * x * x + 0.03 * x * y]))


def views_of(board: ShapedBoard, count: int = 10, seed: int = 1, noise_seed: int = 0) -> list[StereoView]:
    """Views of a bent board, stated as flat, with 0.02 px of noise."""
    poses = board_poses(RIG, board.stated, count, seed)
    views = synthetic_views(RIG, board, poses, 0.02, noise_seed)
    return [replace(view, board=board.stated) for view in views]


def normalised_error(calibration: Calibration) -> FloatArray:
    """Error of each free parameter in its own sigma."""
    assert calibration.rig.covariance is not None
    sigma = np.sqrt(np.diag(calibration.rig.covariance))
    return parameter_error(calibration.rig, RIG)[sigma > 0] / sigma[sigma > 0]


@pytest.mark.long
def test_a_bent_board_is_found_bent() -> None:
    """Taken as flat, a bent board spoils the rig beyond its sigma; with a free shape rig and shape are
    right."""
    true = bent(BOARD)
    flat = calibrate_stereo(views_of(true), SIZE, SIZE, "division")
    free = calibrate_stereo(views_of(true), SIZE, SIZE, "division", plate_shape=True)
    assert flat.rms_px > 0.05
    assert free.rms_px == pytest.approx(0.02 * np.sqrt(2), rel=0.05)
    assert np.abs(normalised_error(flat)).max() > 4
    assert np.abs(normalised_error(free)).max() < 3.5
    found = free.views[0].view.board
    assert isinstance(found, ShapedBoard)
    # up to how the board lies, and its size, which is as stated
    fit = fit_rigid(found.points_mm, true.points_mm, with_scale=True)
    assert np.sqrt(np.mean(fit.residuals_mm**2)) < 0.0008
    assert any("from lowest to highest mark" in note for note in free.notes)


@pytest.mark.long
def test_the_sigma_of_the_rig_knows_of_the_shape() -> None:
    """Over 8 draws of noise the normalised squared error per parameter of the rig is 1."""
    true = bent(BOARD)
    squares = []
    for seed in range(8):
        found = calibrate_stereo(views_of(true, 8, noise_seed=seed), SIZE, SIZE, "division", plate_shape=True)
        squares.append(float(np.mean(normalised_error(found) ** 2)))
    assert 0.7 < np.mean(squares) < 1.4


@pytest.mark.slow
def test_a_flat_board_stays_flat() -> None:
    """The measured shape of a flat board is only noise, and the rig is no worse."""
    views = synthetic_views(RIG, BOARD, board_poses(RIG, BOARD, 10, 1), 0.02, 0)
    free = calibrate_stereo(views, SIZE, SIZE, "division", plate_shape=True)
    found = free.views[0].view.board
    assert isinstance(found, ShapedBoard)
    height_mm, plane_mm = deviation_mm(found)
    assert height_mm < 0.006
    assert plane_mm < 0.001
    assert np.abs(normalised_error(free)).max() < 3.5


@pytest.mark.long
def test_two_boards_have_two_shapes() -> None:
    """Each board of a calibration gets its own shape."""
    truths = bent(BOARD), ShapedBoard(OTHER, OTHER.points_mm)
    views = [*views_of(truths[0], 8), *views_of(truths[1], 8, seed=2)]
    views = [replace(view, name=f"v{n}") for n, view in enumerate(views)]
    free = calibrate_stereo(views, SIZE, SIZE, "division", plate_shape=True)
    heights = {}
    for fit in free.views:
        assert isinstance(fit.view.board, ShapedBoard)
        heights[nominal(fit.view.board)] = deviation_mm(fit.view.board)[0]
    assert heights[BOARD] > 0.03
    assert heights[OTHER] < 0.008
    assert len([note for note in free.notes if "shape measured" in note]) == 2


@pytest.mark.parametrize("board", [BOARD, OTHER, CircleGrid(4, 11, 4.0, 2.0), Chessboard(3, 3, 10.0)])
def test_a_shape_is_no_movement_and_no_size(board: Board) -> None:
    """Every shape parameter keeps middle, direction and size of the board, and has an rms of 1 mm."""
    basis = plate_basis(board)
    points = board.points_mm
    ways = basis.at(points)
    assert 3 <= basis.count <= 38
    np.testing.assert_allclose(np.mean(np.sum(ways**2, axis=1), axis=0), 1.0, rtol=1e-9)
    np.testing.assert_allclose(ways.mean(axis=0), 0.0, atol=1e-9)
    arms = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
    moments = np.einsum("ni,njq->ijq", arms, ways) / len(points)
    np.testing.assert_allclose(moments - moments.transpose(1, 0, 2), 0.0, atol=1e-8)  # no turn
    np.testing.assert_allclose(np.einsum("iiq->q", moments), 0.0, atol=1e-8)  # no scale
    moved = shaped(board, basis, np.eye(basis.count)[0])
    assert np.sqrt(np.mean(np.sum((moved.points_mm - points) ** 2, axis=1))) == pytest.approx(1.0)
    assert nominal(moved) == board
    assert "shape measured" in str(moved)
