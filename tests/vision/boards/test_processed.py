"""Corners in pictures that a camera has processed: sharp, sharpened, clipped, bent, compressed."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from helpers.boards import board_in_the_middle, draw_board, processed, sharp_board
from helpers.rigs import make_rig

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.board import Chessboard, Detection
from edged.vision.boards.chessboard import detect_chessboard, refine_corners, remeasure_chessboard
from edged.vision.geometry.rigid import apply

CAMERA = make_rig(focal_px=800.0, size=(320, 240)).left
BOARD = Chessboard(8, 5, 6.0)
TILTED, ALONG_ROWS = (0.3, -0.2, 0.12), (0.01, -0.015, 0.003)
"""Edges that cross the rows of pixels, and edges that lie along them: each at one place between two rows."""
AS_CAMERAS_DO: dict[str, dict[str, Any]] = {
    "edges of one pixel": {},
    "without noise": {"noise": 0.0},
    "halos of 5 %": {"sharpening": 0.3},
    "halos of 9 %": {"sharpening": 0.6},
    "halos of 14 %": {"sharpening": 1.0},
    "wide halos": {"sharpening": 0.5, "radius_px": 2.0},
    "much noise": {"sharpening": 0.6, "noise": 5.0},
    "gamma": {"sharpening": 0.4, "gamma": 0.5},
    "JPEG": {"sharpening": 0.4, "jpeg": 80},
    "poor JPEG": {"sharpening": 0.4, "jpeg": 60, "noise": 0.3},
    "whites clipped": {"gain": 1.6},
    "halos and whites clipped": {"sharpening": 0.6, "gain": 1.5},
    "black halos clipped": {"sharpening": 2.5, "gain": 0.6},
}


def true_corners(tilts_rad: tuple[float, float, float]) -> FloatArray:
    """The true places of the corners (N, 2)."""
    return CAMERA.project(apply(board_in_the_middle(BOARD, CAMERA, tilts_rad), BOARD.points_mm))


def found_in(image: Image) -> Detection:
    """The detection, which must succeed."""
    found = detect_chessboard(image, BOARD)
    assert isinstance(found, Detection), found
    return found


@pytest.mark.slow
@pytest.mark.parametrize("tilts_rad", [TILTED, ALONG_ROWS], ids=["tilted", "along rows"])
@pytest.mark.parametrize("camera", AS_CAMERAS_DO)
def test_corners_of_a_processed_picture_are_where_they_say(
    camera: str, tilts_rad: tuple[float, float, float]
) -> None:
    """Every corner is measured, none is off by more than 4 of its sigmas, and the sigmas are small."""
    light, true = sharp_board(BOARD, CAMERA, tilts_rad), true_corners(tilts_rad)
    squares = []
    for seed in range(2):
        found = found_in(processed(light, seed=seed, **AS_CAMERAS_DO[camera]))
        assert list(range(40)) == list(found.ids)
        error = np.abs(found.pixels - true)
        assert (error < 4 * found.sigma_px[:, None]).all()
        squares.append((error / found.sigma_px[:, None]) ** 2)
        assert np.median(found.sigma_px) < (0.1 if "clipped" in camera else 0.03)
    assert 0.02 < np.mean(squares) < 2.0


@pytest.mark.parametrize("blur_px", [0.6, 0.8])
def test_sharpening_of_a_soft_picture_does_not_move_corners(blur_px: float) -> None:
    """If a camera sharpens a soft picture, the corners are still right to 0.006 px and within 4 sigmas."""
    pose = board_in_the_middle(BOARD, CAMERA, ALONG_ROWS)
    soft = draw_board(BOARD, CAMERA, pose, blur_mm=blur_px * pose[2, 3] / CAMERA.fx)
    found, true = found_in(processed(soft.astype(float), sharpening=0.8)), true_corners(ALONG_ROWS)
    assert np.sqrt(np.mean((found.pixels - true) ** 2)) < 0.006
    assert (np.abs(found.pixels - true) < 4 * found.sigma_px[:, None]).all()


def test_a_picture_that_is_sampled_well_is_measured_as_it_is() -> None:
    """A well sampled picture is not smoothed, which would cost precision."""
    pose = board_in_the_middle(BOARD, CAMERA, TILTED)
    image = draw_board(BOARD, CAMERA, pose, noise=2.0, blur_mm=0.7 * pose[2, 3] / CAMERA.fx)
    found = found_in(image)
    assert 0.6 < found.blur_px < 0.8
    assert np.median(found.sigma_px) < 0.008


@pytest.mark.slow
def test_one_corner_that_is_missing_costs_no_other() -> None:
    """Without one corner of the rim, all other corners are still measured; corners without neighbours are
    not."""
    image = processed(sharp_board(BOARD, CAMERA, TILTED))
    found = found_in(image)
    kept = found.ids != 15  # the end of the second row: corner 7 has no neighbour along its column any more
    part = Detection(found.ids[kept], found.pixels[kept], found.sigma_px[kept], found.blur_px, found.contrast)
    again = remeasure_chessboard(image, BOARD, part, CAMERA)
    assert isinstance(again, Detection)
    assert list(part.ids) == list(again.ids)
    alone = np.full((2, 2, 2), np.nan)
    alone[0, 0] = 100.0, 100.0
    assert [0.0] * 4 == refine_corners(image, alone)[:, 5].tolist()


@pytest.mark.slow
def test_a_covered_corner_of_a_sharpened_picture_is_left_out_or_says_so() -> None:
    """A covered corner is left out, and a corner beside a glare is off by less than 5 of its sigmas."""
    true = true_corners(TILTED)
    image = processed(sharp_board(BOARD, CAMERA, TILTED), sharpening=0.6)
    found = found_in(image)
    x, y = np.rint(true[[11, 21, 28]]).astype(int).T
    cv2.circle(image, (int(x[0]) + 3, int(y[0]) + 2), 9, 90, -1)
    cv2.circle(image, (int(x[1]) - 6, int(y[1]) + 1), 5, 255, -1)
    cv2.line(image, (int(x[2]) - 9, int(y[2]) + 3), (int(x[2]) + 9, int(y[2]) + 7), 60, 3)
    again = remeasure_chessboard(image, BOARD, found, CAMERA)
    assert isinstance(again, Detection)
    assert 11 not in again.ids
    assert (np.abs(again.pixels - true[again.ids]) < 5 * again.sigma_px[:, None]).all()
    assert len(again.ids) >= 36
