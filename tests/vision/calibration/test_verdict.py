"""The verdict about a calibration: good, usable or repeat, with reasons and a view to add."""

from __future__ import annotations

from dataclasses import replace

import pytest
from helpers.boards import board_poses, synthetic_views
from helpers.rigs import make_rig

from edged.vision.boards.board import Chessboard
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.calibration.crossvalidation import hold_out
from edged.vision.calibration.imaging import UNKNOWN
from edged.vision.calibration.verdict import judge_calibration

BOARD = Chessboard(11, 8, 4.0)
SMALL = Chessboard(7, 6, 4.0)
RIG = make_rig("division")
SIZE = (RIG.left.width, RIG.left.height)


@pytest.mark.long
@pytest.mark.parametrize(
    ("views", "sigma_px", "grade", "why"),
    [
        (20, 0.02, "good", "20 views"),
        (8, 0.02, "usable", "8 views"),
        (14, 1.0, "repeat", "epipolar rms of held-out views 1."),
    ],
)
def test_few_views_are_usable_and_noise_is_not(views: int, sigma_px: float, grade: str, why: str) -> None:
    """The worst finding decides the grade and is named; a grade below good suggests a view."""
    poses = board_poses(RIG, BOARD, views, 0)
    calibration = calibrate_stereo(synthetic_views(RIG, BOARD, poses, sigma_px, 0), SIZE, SIZE, "division")
    verdict = judge_calibration(calibration, hold_out(calibration))

    assert grade == verdict.grade
    assert any(why in text for text in verdict.why)
    assert (grade == "good") == (verdict.add == "")
    assert str(verdict).startswith(f"verdict: {grade}: ")


@pytest.mark.long
def test_pictures_that_a_camera_has_changed_are_usable_at_best() -> None:
    """Twenty views of a camera that sharpens or clips are usable at best, with both reasons."""
    poses = board_poses(RIG, BOARD, 20, 0)
    calibration = calibrate_stereo(synthetic_views(RIG, BOARD, poses, 0.02, 0), SIZE, SIZE, "division")
    sharpening, clipping = replace(UNKNOWN, halo=0.08), replace(UNKNOWN, saturated=0.9)
    held = hold_out(calibration)

    assert "good" == judge_calibration(calibration, held, (UNKNOWN, UNKNOWN)).grade
    verdict = judge_calibration(calibration, held, (sharpening, clipping))
    assert "usable" == verdict.grade
    assert (
        "the left camera sharpens: switch it off",
        "whites of the right camera are clipped: less exposure",
    ) == verdict.why


@pytest.mark.long
def test_boards_in_one_half_of_the_image_are_no_good_calibration() -> None:
    """With twenty views all in the right half the grade is usable, and the other half is named."""
    poses = [pose for pose in board_poses(RIG, SMALL, 120, 0) if pose[0, 3] > 0][:20]
    calibration = calibrate_stereo(synthetic_views(RIG, SMALL, poses, 0.02, 0), SIZE, SIZE, "division")
    verdict = judge_calibration(calibration, hold_out(calibration))

    assert 20 == len(calibration.views)
    assert "usable" == verdict.grade
    assert any("hardly any in the upper left" in text and "of the left image" in text for text in verdict.why)


@pytest.mark.slow
def test_what_was_not_held_out_is_not_praised() -> None:
    """Without held-out views the grade is "repeat"."""
    poses = board_poses(RIG, BOARD, 8, 0)
    calibration = calibrate_stereo(synthetic_views(RIG, BOARD, poses, 0.02, 0), SIZE, SIZE, "division")
    assert "repeat" == judge_calibration(calibration, ()).grade
