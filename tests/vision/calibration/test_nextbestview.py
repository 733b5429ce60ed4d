"""The effect of a calibration's uncertainty on points, the view that would lower it, and OpenCV in
comparison."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boards import board_poses, parameter_error, synthetic_views
from helpers.rigs import make_rig, random_points

from edged.report.charts import Chart, symmetric_limit, ticks
from edged.vision.boards.board import Chessboard
from edged.vision.calibration.bundle import moved_camera
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.calibration.nextbestview import best_next_view, plan_views, volume_points
from edged.vision.calibration.plainopencv import plain_opencv
from edged.vision.geometry.camera import LensModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, transform
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.geometry.uncertainty import calibration_covariance, shift_by_parameters

BOARD = Chessboard(8, 6, 6.0)
RIG = make_rig(focal_px=1590.0, size=(640, 480))
SIZE = 640, 480


def calibration_of(rig: StereoRig, count: int, tilt_deg: float = 25.0, seed: int = 1) -> Calibration:
    """A calibration from marks with 0.03 px of noise."""
    poses = board_poses(rig, BOARD, count, seed, tilt_deg=tilt_deg)
    return calibrate_stereo(synthetic_views(rig, BOARD, poses, 0.03, seed), SIZE, SIZE, rig.left.model)


def changed(rig: StereoRig, step: np.ndarray) -> StereoRig:
    """The rig with all parameters moved."""
    count = 4 + len(rig.left.distortion)
    relation = transform(
        rotation_matrix(step[-6:-3]) @ rig.right_from_left[:3, :3], rig.right_from_left[:3, 3] + step[-3:]
    )
    left, right = moved_camera(rig.left, step[:count]), moved_camera(rig.right, step[count:-6])
    return replace(rig, left=left, right=right, right_from_left=relation)


@pytest.mark.parametrize("model", ["brown", "division"])
def test_points_follow_the_parameters(model: LensModel) -> None:
    """The analytic derivative equals that of triangulation with slightly changed parameters."""
    rig = make_rig(model, focal_px=1590.0, size=SIZE)
    points = random_points(rig, 10, seed=1)
    pixels = rig.left.project(points), rig.right.project(apply(rig.right_from_left, points))
    analytic = shift_by_parameters(rig, points)
    for column in range(len(rig.parameter_names)):
        step = np.zeros(len(rig.parameter_names))
        step[column] = 1e-6
        there, back = (triangulate_raw(changed(rig, sign * step), *pixels) for sign in (1, -1))
        numeric = (there - back) / 2e-6
        scale = max(np.abs(numeric).max(), 1e-3)
        np.testing.assert_allclose(analytic[:, :, column] / scale, numeric / scale, atol=2e-4)


@pytest.mark.long
def test_the_covariance_of_points_is_their_scatter_over_calibrations() -> None:
    """Over 24 noisy calibrations the normalised squared error of a point is 3, its number of coordinates."""
    point = np.array([[5.0, -3.0, RIG.baseline_mm / 0.42]])
    pixels = RIG.left.project(point), RIG.right.project(apply(RIG.right_from_left, point))
    poses = board_poses(RIG, BOARD, 6, 2)
    squares = []
    for seed in range(24):
        found = calibrate_stereo(synthetic_views(RIG, BOARD, poses, 0.03, seed), SIZE, SIZE, "division").rig
        error = (triangulate_raw(found, *pixels) - point)[0]
        squares.append(float(error @ np.linalg.solve(calibration_covariance(found, point)[0], error)))
    assert 1.9 < np.mean(squares) < 4.4


def test_a_rig_of_unknown_covariance_adds_nothing() -> None:
    """Without a covariance of the rig its part is zero, and there is no best next view."""
    assert not calibration_covariance(RIG, random_points(RIG, 3, seed=1)).any()
    known = calibration_of(RIG, 5)
    assert best_next_view(replace(known, rig=replace(known.rig, covariance=None))) is None


@pytest.mark.long
def test_the_suggested_view_does_what_it_promises() -> None:
    """After the suggested view the points' sigma falls by the predicted share."""
    before = calibration_of(RIG, 6, tilt_deg=12.0)
    advice = best_next_view(before)
    assert advice is not None
    assert 0.02 < advice.gain < 0.9
    poses = [*board_poses(RIG, BOARD, 6, 1, tilt_deg=12.0), advice.left_from_board]
    after = calibrate_stereo(synthetic_views(RIG, BOARD, poses, 0.03, 1), SIZE, SIZE, "division")
    points = volume_points(before)

    def rms(calibration: Calibration) -> float:
        return float(np.sqrt(np.mean(np.einsum("nii->n", calibration_covariance(calibration.rig, points)))))

    assert 1 - rms(after) / rms(before) == pytest.approx(advice.gain, abs=0.08)


@pytest.mark.long
def test_a_plan_counts_the_views_to_a_goal() -> None:
    """The plan gives the number of views to a goal: none if it is reached, and no number if it is out of
    reach."""
    calibration = calibration_of(RIG, 5)
    plan = plan_views(calibration, 3)
    assert plan is not None
    assert plan.more_views is None
    first, second, third = (suggestion.gain for suggestion in plan.suggestions)
    assert 1 > first >= second >= third > 0
    best = best_next_view(calibration)
    assert best is not None
    assert (first, plan.suggestions[0].code) == (best.gain, best.code)
    assert (1 - first) * np.linalg.norm(plan.sigma_mm) == pytest.approx(np.linalg.norm(plan.sigmas_mm[0]))

    def needed(goal_mm: float) -> int | None:
        found = plan_views(calibration, 1, goal_mm)
        assert found is not None
        return found.more_views

    assert 0 == needed(plan.sigma_mm.max())
    assert 1 == needed(plan.sigmas_mm[0].max())
    some = needed(0.4 * plan.sigma_mm.max())
    assert some is not None
    assert some > 1
    assert needed(1e-9) is None


def test_no_suggestion_where_nothing_fits() -> None:
    """If the board is too large for any candidate, there is no suggestion and no error."""
    calibration = calibration_of(RIG, 5)
    giant = replace(BOARD, pitch_mm=60.0)
    views = tuple(replace(fit, view=replace(fit.view, board=giant)) for fit in calibration.views)
    assert best_next_view(replace(calibration, views=views)) is None


def test_opencv_agrees_on_exact_marks() -> None:
    """Without noise, plain OpenCV and edged find the same Brown-Conrady rig."""
    rig = make_rig("brown", focal_px=1590.0, size=SIZE)
    views = synthetic_views(rig, BOARD, board_poses(rig, BOARD, 8, 1), 0.0, 0)
    plain = plain_opencv(views, SIZE, SIZE)
    assert plain is not None
    assert plain.rms_px < 1e-3
    assert np.abs(parameter_error(plain.rig, rig)[-3:]).max() < 0.02  # OpenCV takes float32 pixels


def test_ticks_are_round_and_inside() -> None:
    """Ticks are 1, 2 or 5 times a power of ten apart, in either direction, and none for an empty range."""
    assert ticks(0, 1280) == [0, 500, 1000]
    assert ticks(960, 0) == [0, 200, 400, 600, 800]
    assert ticks(-0.004, 0.004) == pytest.approx([-0.004, -0.002, 0, 0.002, 0.004])
    assert ticks(3.0, 3.0) == [3.0]
    assert symmetric_limit(np.array([-4.1, 2.0])) == 5.0
    assert symmetric_limit(np.zeros(0)) == 1.0


def test_a_chart_puts_data_where_its_axes_say() -> None:
    """The corners of the data are the corners of the frame; names are escaped."""
    chart = Chart((0.0, 10.0), (5.0, 0.0), "<x>", "y")
    assert (chart.to_x(0.0), chart.to_y(5.0)) == (58.0, chart.height - 40.0)
    assert (chart.to_x(10.0), chart.to_y(0.0)) == (chart.width - 14.0, 12.0)
    assert "&lt;x&gt;" in chart.figure("caption")
