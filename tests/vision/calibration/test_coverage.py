"""Which parts of the images have marks, field by field, in the view that both cameras share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boards import board_poses, synthetic_views
from helpers.rigs import make_rig

from edged.vision.boards.board import Chessboard, Detection, StereoView
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.calibration.coverage import COLUMNS, ROWS, coverage_in_words, coverage_of

BOARD = Chessboard(11, 8, 4.0)
RIG = make_rig("division")
SIZE = (RIG.left.width, RIG.left.height)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    """Calibrated from eight views."""
    views = synthetic_views(RIG, BOARD, board_poses(RIG, BOARD, 8, 0), 0.02, 0)
    return calibrate_stereo(views, SIZE, SIZE, "division")


def with_marks(calibration: Calibration, left_px: np.ndarray) -> Calibration:
    """The same calibration with only the first view, which has these marks in its left image."""
    count = len(left_px)
    found = Detection(np.arange(count), left_px, np.full(count, 0.02), 0.6, 150.0)
    first = calibration.views[0]
    view = StereoView(first.name, first.view.board, found, first.view.right)
    return replace(calibration, views=[replace(first, view=view)])


@pytest.mark.slow
def test_a_field_is_reached_by_a_mark_in_it(calibration: Calibration) -> None:
    """Marks in the middle of a field count for that field alone; a mark on the image's edge counts, too."""
    field = np.array(SIZE) / (COLUMNS, ROWS)
    seen = with_marks(calibration, np.array([[2.5, 1.5] * field, [7.5, 5.5] * field, np.array(SIZE) - 0.6]))
    reached = np.argwhere(coverage_of(seen, "left").reached)
    assert [[1, 2], [5, 7]] == reached.tolist()


def test_every_part_without_marks_is_named(calibration: Calibration) -> None:
    """With marks in the middle only, the parts around it that both cameras see are named as missed."""
    x, y = np.meshgrid(np.linspace(0.26, 0.74, 9) * SIZE[0], np.linspace(0.34, 0.66, 9) * SIZE[1])
    coverage = coverage_of(with_marks(calibration, np.column_stack([x.ravel(), y.ravel()])), "left")
    parts = {
        f"{row} {column}" for row in ("upper", "middle", "lower") for column in ("left", "middle", "right")
    }
    assert coverage.missed
    assert set(coverage.missed) <= parts - {"middle middle"}
    assert {"upper middle", "lower middle"} <= set(coverage.missed)
    assert coverage.share == pytest.approx(8 / coverage.common.sum())


def test_what_one_camera_sees_alone_is_not_missed(calibration: Calibration) -> None:
    """What only one camera sees does not count as missed."""
    left, right = coverage_of(calibration, "left"), coverage_of(calibration, "right")
    apart = replace(calibration, rig=make_rig("division", vergence_deg=0.0), views=calibration.views)
    alone = coverage_of(apart, "left")
    assert left.common.sum() > alone.common.sum()
    assert not alone.common[:, 0].any()
    assert right.common.any()


def test_the_words_name_both_images(calibration: Calibration) -> None:
    """The sentence names both images; parts are only named if they are missed, each with its image."""
    whole = coverage_of(calibration, "left")
    full = replace(whole, reached=np.ones_like(whole.reached))
    empty = replace(full, side="right", reached=np.zeros_like(full.reached))
    assert "marks in 100 % of the left and 100 % of the right image's common view" == coverage_in_words(
        [full, replace(full, side="right")]
    )
    said = coverage_in_words([full, empty])
    assert "0 % of the right image's common view, hardly any in the upper left" in said
    assert said.endswith("of the right image")
    assert "of the left image" not in said
