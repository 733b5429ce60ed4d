"""Held-out views, and the report page made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boards import board_poses, synthetic_views
from helpers.htmlpages import HtmlPage
from helpers.rigs import make_rig

from edged.report.calibration import ReportExtras, calibration_report
from edged.setup.calibration.views import quality_figures
from edged.vision.boards.board import Chessboard, NotDetected
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.calibration.coverage import coverage_in_words, coverage_of
from edged.vision.calibration.crossvalidation import hold_out
from edged.vision.calibration.plainopencv import plain_opencv

BOARD = Chessboard(11, 8, 4.0)
RIG = make_rig()
SIZE = (1280, 960)
VIEWS = synthetic_views(RIG, BOARD, board_poses(RIG, BOARD, 8, 1), 0.02, 1)


@pytest.mark.long
def test_held_out_figures_are_the_noise_that_was_put_in() -> None:
    """With marks of 0.02 px noise the held-out residuals are about as large, and the scale is true."""
    held = hold_out(calibrate_stereo(VIEWS, SIZE, SIZE, "division"))
    assert [view.name for view in held] == [view.name for view in VIEWS]
    reprojection = np.sqrt(np.mean([view.reprojection_rms_px**2 for view in held]))
    assert reprojection == pytest.approx(0.02 * np.sqrt(2), rel=0.1)
    assert np.mean([view.epipolar_rms_px for view in held]) == pytest.approx(0.02 * np.sqrt(2), rel=0.2)
    assert np.mean([view.scale for view in held]) == pytest.approx(1, abs=1e-4)
    assert held[0].length_mm == pytest.approx(np.hypot(40, 28))
    assert np.abs([view.length_error_mm for view in held]).max() < 0.02
    assert 0 < max(view.flatness_mm for view in held) < 0.01


@pytest.mark.long
def test_a_view_of_a_wrongly_printed_board_shows_in_its_length() -> None:
    """A board 0.1 % too large in one view only is seen when that view is held out."""
    large = replace(BOARD, pitch_mm=4.004)
    poses = board_poses(RIG, BOARD, 8, 1)
    views = [
        *VIEWS[:7],
        replace(synthetic_views(RIG, large, [poses[7]], 0.02, 3)[0], name="large", board=BOARD),
    ]
    held = {view.name: view for view in hold_out(calibrate_stereo(views, SIZE, SIZE, "division"))}
    assert held["large"].scale == pytest.approx(1.001, abs=2e-4)
    assert abs(held["view_02"].scale - 1) < 2e-4


def test_three_views_leave_nothing_to_hold_out() -> None:
    """Three views calibrate, but none is held out."""
    assert hold_out(calibrate_stereo(VIEWS[:3], SIZE, SIZE, "division")) == ()


@pytest.mark.slow
def test_known_lengths_are_single_distances_of_the_board() -> None:
    """Every row and column gives its whole, half and one step, true and measured within the noise."""
    held = hold_out(calibrate_stereo(VIEWS, SIZE, SIZE, "division"))
    lengths = held[0].lengths_mm
    columns, rows, pitch = BOARD.columns, BOARD.rows, BOARD.pitch_mm
    assert len(lengths) == 3 * (columns + rows) + 2
    steps = {round(float(true / pitch), 3) for true in lengths[:, 0]}
    assert {1.0, columns - 1.0, rows - 1.0, columns // 2 * 1.0, rows // 2 * 1.0} <= steps
    assert 0 < np.abs(lengths[:, 1] - lengths[:, 0]).max() < 0.05


@pytest.mark.long
def test_a_measured_shape_is_compared_with_opencv_as_stated() -> None:
    """Plain OpenCV gets the stated flat board, and the report shows it beside the measured shape."""
    calibration = calibrate_stereo(VIEWS, SIZE, SIZE, "division", plate_shape=True)
    plain = plain_opencv([fit.view for fit in calibration.views], SIZE, SIZE)
    assert plain is not None
    quality = quality_figures(calibration, (), [BOARD])
    page = calibration_report(calibration, (), VIEWS, quality, ReportExtras(plain=plain))
    assert "shape measured" in page
    assert f"{plain.rms_px:.4f}" in page


def test_three_views_still_make_a_report() -> None:
    """With three views the page says that there are too few to hold any out."""
    calibration = calibrate_stereo(VIEWS[:3], SIZE, SIZE, "division")
    page = calibration_report(calibration, (), VIEWS[:3], quality_figures(calibration, (), [BOARD]))
    assert "Too few views to hold any out" in page
    assert "nan" not in page


@pytest.mark.long
def test_the_report_is_one_well_formed_page_that_says_it_all() -> None:
    """The page is well formed, has no outside references, escapes user text, and contains every view and
    figure."""
    spoiled = replace(VIEWS[3], name="<b>3", left=NotDetected("too dark & blurred"))
    views = [*VIEWS[:3], spoiled, *VIEWS[4:]]
    calibration = calibrate_stereo(views, SIZE, SIZE, "division")
    held = hold_out(calibration)
    quality = quality_figures(calibration, held, [BOARD])
    plain = plain_opencv([fit.view for fit in calibration.views], SIZE, SIZE)
    page = calibration_report(calibration, held, views, quality, ReportExtras({"place": "cell 7"}, plain))
    parsed = HtmlPage(page)
    assert parsed.open == []
    assert parsed.outside == []
    assert "<b>3" not in page
    for text in (
        "too dark & blurred",
        calibration.rig.calibration_id,
        "Known lengths: measured minus true",
        "σZ in µm",
        "Table 1",
        "Table 2",
        "The view that would help most",
        "cv2.stereoCalibrate",
        "cell 7",
        "view_07",
    ):
        assert text in parsed.text
    assert f"{calibration.rms_px:.4f} px" in parsed.text


@pytest.mark.slow
def test_the_report_shows_what_was_found_in_each_picture() -> None:
    """The page has small pictures of both sides of each view, also of skipped ones, and the coverage."""
    views = [*VIEWS[:4], replace(VIEWS[4], right=NotDetected("covered"))]
    calibration = calibrate_stereo(views, SIZE, SIZE, "division")
    small = np.full((180, 240), 90, np.uint8)
    page = calibration_report(
        calibration,
        hold_out(calibration),
        views,
        quality_figures(calibration, (), [BOARD]),
        ReportExtras(
            verdict="verdict: usable: 4 views",
            thumbnails={view.name: (small, small) for view in views},
        ),
    )
    parsed = HtmlPage(page)
    assert [] == parsed.open
    assert 2 * len(views) == len(parsed.outside)
    assert all(text.startswith("data:image/jpeg;base64,") and len(text) < 20_000 for text in parsed.outside)
    assert 9 * len(BOARD.points_mm) == page.count("h0")  # four views twice, and the left half of the fifth
    assert "verdict: usable: 4 views" in parsed.text
    assert "view_04: skipped: right: covered" in parsed.text
    said = coverage_in_words([coverage_of(calibration, "left"), coverage_of(calibration, "right")])
    assert said in parsed.text
