"""The choice of the lens model from the views, and a sigma that includes the other models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boards import board_poses, synthetic_views
from helpers.rigs import make_rig

from edged.domain.arrays import FloatArray
from edged.vision.boards.board import Chessboard, StereoView
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.calibration.lenschoice import choice_in_words, freedom_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.geometry.uncertainty import calibration_covariance

BOARD = Chessboard(8, 6, 6.0)
SIZE = 640, 480
DIVISION = make_rig(focal_px=1590.0, size=SIZE)


def brown_rig(tangential: float, k2: float = 0.14) -> StereoRig:
    """Lenses with this k2 and both tangential coefficients of this size."""
    rig = make_rig("brown", focal_px=1590.0, size=SIZE)
    distortion = -0.21, k2, tangential, -tangential, 0.0
    left, right = (replace(camera, distortion=distortion) for camera in (rig.left, rig.right))
    return replace(rig, left=left, right=right)


def views_of(rig: StereoRig, count: int = 7, seed: int = 1, sigma_px: float = 0.02) -> list[StereoView]:
    """Marks as the rig sees them, with noise."""
    return synthetic_views(rig, BOARD, board_poses(rig, BOARD, count, seed), sigma_px, seed)


def points_of(calibration: Calibration) -> FloatArray:
    """A part of the marks' places (N, 3)."""
    return np.concatenate([apply(fit.left_from_board, BOARD.points_mm[::15]) for fit in calibration.views])


def sigma_mm(calibration: Calibration) -> float:
    """The rms sigma of points at the marks' places."""
    covariance = calibration_covariance(calibration.rig, points_of(calibration))
    return float(np.sqrt(np.mean(np.einsum("nii->n", covariance))))


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig", "name", "model"),
    [
        (DIVISION, "division", "division"),
        (brown_rig(0.0, k2=0.5), "brown without p1, p2", "brown"),
        (brown_rig(8e-4), "brown", "brown"),
    ],
    ids=["division", "radial", "tangential"],
)
def test_the_true_lens_is_chosen(rig: StereoRig, name: str, model: str) -> None:
    """Ten views tell division, Brown-Conrady without and Brown-Conrady with the tangential part apart."""
    found = calibrate_stereo(views_of(rig, 10, sigma_px=0.01), SIZE, SIZE, "auto")
    assert name == found.lenses[0].name
    assert model == found.rig.left.model == found.rig.right.model
    assert 1 == pytest.approx(sum(one.weight for one in found.lenses))
    assert "lens model chosen by the views: " + name in choice_in_words(found.lenses)
    expected = {"division": ("kappa",), "brown": ("k1", "k2", "p1", "p2")}.get(name, ("k1", "k2"))
    assert expected == freedom_of(found.rig.left).distortion


@pytest.mark.long
def test_a_simple_lens_is_known_better() -> None:
    """The sigma with a chosen division model is below Brown-Conrady's and above that of a given division
    model."""
    views = views_of(DIVISION)
    chosen, brown, division = (calibrate_stereo(views, SIZE, SIZE, m) for m in ("auto", "brown", "division"))
    assert "division" == chosen.lenses[0].name
    assert 0.95 * sigma_mm(brown) > sigma_mm(chosen) > sigma_mm(division)


@pytest.mark.long
def test_sigma_knows_that_another_model_may_be_true() -> None:
    """If the views hardly show a tangential part, the stated sigma still equals the error."""
    rig, squares, simpler = brown_rig(1e-4), [], 0
    for seed in range(8):
        found = calibrate_stereo(views_of(rig, 5, seed), SIZE, SIZE, "auto")
        simpler += found.lenses[0].name != "brown"
        points = points_of(found)
        pixels = rig.left.project(points), rig.right.project(apply(rig.right_from_left, points))
        error = triangulate_raw(found.rig, *pixels) - points
        covariance = calibration_covariance(found.rig, points)
        solved = np.linalg.solve(covariance, error[..., None])[..., 0]
        squares.append(float(np.mean(np.sum(error * solved, axis=1))) / 3)
    assert simpler > 0
    assert 0.4 < np.mean(squares) < 2


def test_views_that_determine_no_brown_lens_still_choose() -> None:
    """Three views that leave Brown-Conrady undetermined still give a rig with a valid covariance."""
    views = views_of(DIVISION, 3, sigma_px=0.3)
    found = calibrate_stereo(views, SIZE, SIZE, "auto")
    assert found.rig.covariance is not None
    assert np.linalg.eigvalsh(found.rig.covariance).min() > -1e-9 * np.trace(found.rig.covariance)


@pytest.mark.long
def test_a_stated_model_is_not_questioned() -> None:
    """With a stated model no other models are tried or reported."""
    assert () == calibrate_stereo(views_of(DIVISION), SIZE, SIZE, "brown").lenses


@pytest.mark.long
def test_a_lens_that_folds_the_picture_is_not_chosen() -> None:
    """A polynomial that fits the middle best but folds back further out is not chosen."""
    rig = make_rig("brown", focal_px=425.0, size=SIZE)
    folding = -0.45, 0.0, 8e-4, -8e-4, 0.0  # no point of space is seen beyond 243 px from the middle
    left, right = (replace(camera, distortion=folding) for camera in (rig.left, rig.right))
    wide, board = replace(rig, left=left, right=right), Chessboard(9, 6, 12.0)
    poses = [
        pose
        for pose in board_poses(wide, board, 80, 1)
        if np.abs(wide.left.project(apply(pose, board.points_mm)) - (320, 240)).max() < 180
    ]
    views = synthetic_views(wide, board, poses[:14], 0.05, 1)
    assert "division" == calibrate_stereo(views, SIZE, SIZE, "auto").rig.left.model
