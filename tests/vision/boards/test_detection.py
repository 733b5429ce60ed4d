"""Boards: specifications, and marks at their true places, numbered alike by both cameras."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board, right_pose
from helpers.rigs import make_rig
from hypothesis import given
from hypothesis import strategies as st
from naive.boards import corner_model, dot_model

from edged.errors import CalibrationError
from edged.vision.boards.board import (
    Charuco,
    Chessboard,
    CircleGrid,
    Detection,
    DotBoard,
    NotDetected,
    parse_board,
)
from edged.vision.boards.charuco import detect_charuco
from edged.vision.boards.chessboard import detect_chessboard, remeasure_chessboard
from edged.vision.boards.circlegrid import detect_dots, remeasure_dots
from edged.vision.boards.markmodels import CORNER, DOT, accumulate, fit_corners
from edged.vision.geometry.rigid import apply, rotation_matrix

SMALL = make_rig(focal_px=1590.0, size=(640, 480))


def test_specifications_are_read() -> None:
    """Each kind of board is read as it is written in the manual, and written as it is read."""
    assert parse_board("chessboard:11x8:4.0") == Chessboard(11, 8, 4.0)
    assert parse_board(" Chessboard:9X6:25 ") == Chessboard(9, 6, 25.0)
    assert parse_board("dots:7x7:5.0") == DotBoard(7, 7, 5.0, 2.5)
    assert parse_board("dots:7x7:5.0:2") == DotBoard(7, 7, 5.0, 2.0)
    assert parse_board("circles:4x11:5") == CircleGrid(4, 11, 5.0, 2.5)
    assert parse_board("circles:4x11:5:6") == CircleGrid(4, 11, 5.0, 6.0)
    assert parse_board("charuco:12x9:4:3:DICT_5X5_250") == Charuco(12, 9, 4.0, 3.0, "5X5_250")
    for text in ("chessboard:11x8:4", "dots:7x6:5:2.5", "charuco:12x9:4:3:5X5_250"):
        assert str(parse_board(text)) == text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "not a kind of board"),
        ("checkers:8x8:1", "not a kind of board"),
        ("chessboard", "values after the kind"),
        ("chessboard:11x8:4:1", "values after the kind"),
        ("chessboard:11:4", "not COLSxROWS"),
        ("chessboard:11x-8:4", "not COLSxROWS"),
        ("chessboard:2x8:4", "3 to 100"),
        ("chessboard:99999999999x8:4", "3 to 100"),
        ("chessboard:11x8:0", "not a length"),
        ("chessboard:11x8:nan", "not a length"),
        ("chessboard:11x8:4mm", "not a length"),
        ("dots:7x7:5:5", "overlap"),
        ("charuco:12x9:4:4:5X5_250", "do not fit"),
        ("charuco:12x9:4:3:9X9_1", "not an ArUco dictionary"),
        ("charuco:12x9:4:3:4X4_50", "54 markers needed"),
    ],
)
def test_a_wrong_specification_is_named(text: str, expected: str) -> None:
    """The error names what is wrong in the specification."""
    with pytest.raises(CalibrationError, match=expected):
        parse_board(text)


@given(st.text(max_size=30))
def test_any_text_is_a_board_or_an_error(text: str) -> None:
    """No text crashes the parser."""
    try:
        assert len(parse_board(text).points_mm) >= 4
    except CalibrationError as error:
        assert "board" in str(error)


def found_in(image: np.ndarray, board: Chessboard) -> Detection:
    """The detection, which must succeed."""
    found = detect_chessboard(image, board)
    assert isinstance(found, Detection), found
    return found


@pytest.mark.slow
@pytest.mark.parametrize("spec", ["chessboard:11x8:2.4", "chessboard:9x7:2.6", "chessboard:7x7:3"])
def test_corners_are_found_to_a_hundredth_of_a_pixel(spec: str) -> None:
    """With pixel noise of 2 grey values the corners are right to 0.02 px rms, without bias."""
    board = parse_board(spec)
    assert isinstance(board, Chessboard)
    errors = []
    for seed, pose in enumerate(board_poses(SMALL, board, 3, seed=4)):
        found = found_in(draw_board(board, SMALL.left, pose, noise=2.0, seed=seed), board)
        true = SMALL.left.project(board.points_mm @ pose[:3, :3].T + pose[:3, 3])
        if board.is_symmetric and np.linalg.norm(found.pixels[0] - true[0]) > 5:
            true = true[::-1]
        assert len(found.ids) == len(true)
        errors.append(found.pixels - true)
    error = np.concatenate(errors)
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.abs(error.mean(axis=0)).max() < 0.004


@pytest.mark.long
def test_the_stated_sigma_is_the_scatter() -> None:
    """Over many noise draws the normalised error of a corner is 1, and the sigma grows as the noise does."""
    board = Chessboard(6, 5, 4.0)
    pose = board_poses(SMALL, board, 1, seed=1)[0]
    clean = found_in(draw_board(board, SMALL.left, pose), board)
    typical = {}
    for noise in (2.0, 8.0):
        squares, sigmas = [], []
        for seed in range(12):
            image = draw_board(board, SMALL.left, pose, noise=noise, seed=seed)
            found = remeasure_chessboard(image, board, clean, SMALL.left)
            assert isinstance(found, Detection)
            truth = SMALL.left.project(board.points_mm @ pose[:3, :3].T + pose[:3, 3])
            squares.append(((found.pixels - truth) / found.sigma_px[:, None]) ** 2)
            sigmas.append(found.sigma_px)
        assert np.mean(squares) == pytest.approx(1, abs=0.2)
        typical[noise] = float(np.median(sigmas))
    assert typical[8.0] == pytest.approx(4 * typical[2.0], rel=0.1)
    assert np.median(clean.sigma_px) < typical[8.0] / 3


@pytest.mark.slow
def test_both_cameras_number_the_corners_alike() -> None:
    """An asymmetric board turned by any angle starts at its black corner square in both images."""
    board = Chessboard(8, 5, 3.0)
    turns = [np.diag([-1.0, -1.0, 1.0, 1.0]), np.eye(4)]
    for pose in board_poses(SMALL, board, 2, seed=7):
        for turn in turns:
            middle = np.eye(4)
            middle[:3, 3] = board.points_mm.mean(axis=0)
            turned = pose @ middle @ turn @ np.linalg.inv(middle)
            for camera, camera_pose in ((SMALL.left, turned), (SMALL.right, right_pose(SMALL, turned))):
                found = found_in(draw_board(board, camera, camera_pose), board)
                true = camera.project(board.points_mm @ camera_pose[:3, :3].T + camera_pose[:3, 3])
                assert np.abs(found.pixels - true).max() < 0.1


def test_a_bent_edge_is_no_bias_once_the_lens_is_known() -> None:
    """A strong lens bends edges in the window; a second measurement with the known lens has no radial
    bias."""
    rig = make_rig(focal_px=800.0, size=(640, 480), vergence_deg=10)
    board = Chessboard(8, 6, 8.0)
    pose = board_poses(rig, board, 1, seed=11, tilt_deg=5)[0]
    image = draw_board(board, rig.left, pose, blur_mm=0.12)
    true = rig.left.project(board.points_mm @ pose[:3, :3].T + pose[:3, 3])
    straight = found_in(image, board)
    bent = remeasure_chessboard(image, board, straight, rig.left)
    assert isinstance(bent, Detection)
    before, after = straight.pixels - true, bent.pixels - true
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(before**2))
    assert np.abs(after).max() < 0.02


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.full((480, 640), 128, np.uint8), "no 8x5 inner corners"),
        (np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8), "no 8x5 inner corners"),
        (np.zeros((3, 2), np.uint8), "no 8x5 inner corners"),
    ],
)
def test_a_picture_without_the_board_is_a_miss_with_a_reason(image: np.ndarray, reason: str) -> None:
    """A picture without the board gives NotDetected with a reason, no exception."""
    found = detect_chessboard(image, Chessboard(8, 5, 3.0))
    assert isinstance(found, NotDetected)
    assert reason in found.reason


def test_a_picture_with_hardly_any_contrast_is_a_miss() -> None:
    """A picture with five grey values between black and white gives NotDetected."""
    board = Chessboard(8, 5, 3.0)
    image = draw_board(board, SMALL.left, board_poses(SMALL, board, 1, seed=7)[0])
    flat = np.rint(100 + image * (5 / 255)).astype(np.uint8)
    assert isinstance(detect_chessboard(flat, board), NotDetected)


@pytest.mark.slow
def test_a_covered_corner_is_left_out() -> None:
    """A covered corner is not in the detection; the others are at their true places."""
    board = Chessboard(8, 5, 6.0)
    pose = board_poses(SMALL, board, 1, seed=7)[0]
    image = draw_board(board, SMALL.left, pose)
    true = SMALL.left.project(board.points_mm @ pose[:3, :3].T + pose[:3, 3])
    found = found_in(image, board)
    x, y = np.rint(true[17]).astype(int)
    covered = cv2.circle(image.copy(), (int(x) + 5, int(y) + 4), 14, 90, -1)
    again = remeasure_chessboard(covered, board, found, SMALL.left)
    assert isinstance(again, Detection)
    assert 17 not in again.ids
    assert np.abs(again.pixels - true[again.ids]).max() < 0.1


@pytest.mark.slow
def test_corner_kernel_equals_its_plain_twin() -> None:
    """Residuals, normal equations and gradient of the kernel are those of the formula and its differences."""
    rng = np.random.default_rng(3)
    image = rng.integers(20, 200, (40, 40), dtype=np.uint8)
    p = np.array([19.3, 20.1, 0.2, 1.9, -0.3, 110.0, 40.0, 3e-3, -2e-3])
    window = np.array([19.0, 20.5, 7.5, 2e-3, -1e-3])
    normal, gradient = np.empty((9, 9)), np.empty(9)
    total, count = accumulate(CORNER, image, p, window, normal, gradient, False)
    values, model, jacobian = corner_model(image, p, window)
    residuals = values - model
    assert count == len(values)
    assert total == pytest.approx(residuals @ residuals, rel=1e-12)
    lower = np.tril_indices(9)
    assert np.allclose(normal[lower], (jacobian.T @ jacobian)[lower], rtol=1e-5, atol=1e-4)
    assert np.allclose(gradient, jacobian.T @ residuals, rtol=1e-5, atol=1e-3)
    accumulate(CORNER, image, p, window, normal, gradient, True)
    weighted = (jacobian * residuals[:, None] ** 2).T @ jacobian
    assert np.allclose(normal[lower], weighted[lower], rtol=1e-5, atol=1e-2)


def test_a_corner_outside_the_image_is_refused() -> None:
    """Starts outside the image, or on a flat field, end with ok = 0."""
    image = np.full((60, 60), 100, np.uint8)
    start = np.array([[-5.0, 30, 0, 1.5, 8, 0, 0], [30.0, 30, 0, 1.5, 8, 0, 0], [59.0, 59, 0, 1.5, 8, 0, 0]])
    result = np.empty((3, 6))
    fit_corners(image, start, 0.0, result)
    assert (result[:, 5] == 0).all()


# --- dots -----------------------------------------------------------------------------------------


PLATE = DotBoard(7, 7, 6.0, 3.0)


def dots_in(image: np.ndarray, board: DotBoard) -> Detection:
    """The detection, which must succeed."""
    found = detect_dots(image, board)
    assert isinstance(found, Detection), found
    return found


@pytest.mark.slow
@pytest.mark.parametrize("board", [PLATE, DotBoard(9, 6, 6.0, 2.5)])
@pytest.mark.parametrize("inverted", [False, True])
def test_dots_are_found_to_two_hundredths_of_a_pixel(board: DotBoard, inverted: bool) -> None:
    """The centres of the dots, not of their ellipses, are found, dark on light and light on dark."""
    for seed, pose in enumerate(board_poses(SMALL, board, 3, seed=2, tilt_deg=35)):
        image = draw_board(board, SMALL.left, pose, noise=1.5, seed=seed)
        found = dots_in(255 - image if inverted else image, board)
        true = SMALL.left.project(apply(pose, board.points_mm))
        assert len(found.ids) == len(true)
        again = remeasure_dots(image, board, found, SMALL.left, pose)
        assert isinstance(again, Detection)
        for measured in (found, again):
            error = measured.pixels - true[measured.ids]
            assert np.sqrt(np.mean(error**2)) < 0.02
            assert np.abs(error.mean(axis=0)).max() < 0.004


def test_the_middle_of_an_ellipse_is_not_the_middle_of_the_circle() -> None:
    """For large dots seen aslant and near, the ellipses' centres are off by 0.06 px; the corrected marks
    are not."""
    board = DotBoard(5, 5, 12.0, 9.0)
    rig = make_rig(focal_px=900.0, size=(640, 480))
    pose = board_poses(rig, board, 1, seed=1, tilt_deg=40)[0]
    true = rig.left.project(apply(pose, board.points_mm))
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.column_stack([4.5 * np.cos(angles), 4.5 * np.sin(angles), 0 * angles])
    outlines = rig.left.project(apply(pose, board.points_mm[:, None] + ring))
    ellipses = np.array([cv2.fitEllipse(o.astype(np.float32))[0] for o in outlines])
    assert np.abs(ellipses - true).max() > 0.06
    image = draw_board(board, rig.left, pose)
    found = remeasure_dots(image, board, dots_in(image, board), rig.left, pose)
    assert isinstance(found, Detection)
    assert np.abs(found.pixels - true).max() < 0.01


@pytest.mark.long
def test_the_filled_corner_numbers_the_dots_whatever_the_turn() -> None:
    """A square plate turned by any quarter starts at its filled corner."""
    pose = board_poses(SMALL, PLATE, 1, seed=5)[0]
    middle = np.eye(4)
    middle[:3, 3] = PLATE.points_mm.mean(axis=0)
    for quarter in range(4):
        turn = np.eye(4)
        turn[:3, :3] = rotation_matrix(np.array([0, 0, quarter * np.pi / 2]))
        turned = pose @ middle @ turn @ np.linalg.inv(middle)
        found = dots_in(draw_board(PLATE, SMALL.left, turned), PLATE)
        true = SMALL.left.project(apply(turned, PLATE.points_mm))
        assert np.abs(found.pixels - true[found.ids]).max() < 0.05


@pytest.mark.slow
def test_dots_of_another_count_or_without_orientation_are_a_miss() -> None:
    """The reason says whether the count is wrong or the orientation mark is not seen."""
    pose = board_poses(SMALL, PLATE, 1, seed=5)[0]
    image = draw_board(PLATE, SMALL.left, pose)
    wrong = detect_dots(image, DotBoard(8, 7, 6.0, 3.0))
    assert isinstance(wrong, NotDetected)
    assert "the plate has 56" in wrong.reason
    corner = SMALL.left.project(apply(pose, np.array([-3.8, -3.8, 0])))
    x, y = np.rint(corner).astype(int)
    cv2.circle(image, (int(x), int(y)), 7, 210, -1)
    bare = detect_dots(image, PLATE)
    assert isinstance(bare, NotDetected)
    assert "orientation mark" in bare.reason
    assert isinstance(detect_dots(np.full((480, 640), 100, np.uint8), PLATE), NotDetected)
    noise = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    assert isinstance(detect_dots(noise, PLATE), NotDetected)


@pytest.mark.slow
@pytest.mark.parametrize("stated_mm", [6.0, 9.0, 11.0])
def test_the_dots_own_size_is_measured(stated_mm: float) -> None:
    """A wrong or unknown diameter does no harm: the perspective correction uses the measured one."""
    board = DotBoard(5, 5, 12.0, 9.0)
    rig = make_rig(focal_px=900.0, size=(640, 480))
    pose = board_poses(rig, board, 1, seed=1, tilt_deg=40)[0]
    true = rig.left.project(apply(pose, board.points_mm))
    image, stated = draw_board(board, rig.left, pose), DotBoard(5, 5, 12.0, stated_mm)
    first = dots_in(image, stated)
    again = remeasure_dots(image, stated, first, rig.left, pose)
    assert isinstance(again, Detection)
    assert len(again.ids) == 25
    assert np.abs(again.pixels - true).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    "board", [DotBoard(3, 3, 12.0, 6.0), DotBoard(15, 11, 3.0, 1.5), DotBoard(5, 9, 5.0, 2.0)]
)
def test_plates_of_any_size_are_found(board: DotBoard) -> None:
    """Plates with few large dots, many small ones, or more rows than columns are found."""
    pose = board_poses(SMALL, board, 1, seed=8)[0]
    found = dots_in(draw_board(board, SMALL.left, pose, noise=1.5), board)
    true = SMALL.left.project(apply(pose, board.points_mm))
    assert len(found.ids) == len(true)
    assert np.abs(found.pixels - true[found.ids]).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    "board", [CircleGrid(4, 11, 4.0, 2.0), CircleGrid(4, 11, 4.0, 4.5), CircleGrid(3, 7, 6.0, 3.0)]
)
@pytest.mark.parametrize("turn_rad", [0.0, 1.3, 2.9, 4.6])
def test_an_asymmetric_grid_tells_its_turn(board: CircleGrid, turn_rad: float) -> None:
    """Turned by any angle and tilted by 40°, each mark has its own number, to a fiftieth of a pixel."""
    pose, middle, turn = board_poses(SMALL, board, 1, seed=3, tilt_deg=40)[0], np.eye(4), np.eye(4)
    middle[:3, 3] = board.points_mm.mean(axis=0)
    turn[:3, :3] = rotation_matrix(np.array([0, 0, turn_rad]))
    pose = pose @ middle @ turn @ np.linalg.inv(middle)
    found = detect_dots(draw_board(board, SMALL.left, pose, noise=1.5), board)
    assert isinstance(found, Detection), found
    true = SMALL.left.project(apply(pose, board.points_mm))
    assert list(found.ids) == list(range(len(true)))
    assert np.sqrt(np.mean((found.pixels - true) ** 2)) < 0.02


def test_asymmetric_marks_stand_where_opencv_says() -> None:
    """The marks are those of cv2.findCirclesGrid with ASYMMETRIC_GRID, in the same order."""
    board = CircleGrid(4, 11, 4.0, 2.0)
    image = draw_board(board, SMALL.left, board_poses(SMALL, board, 1, seed=3)[0])
    ok, theirs = cv2.findCirclesGrid(image, (4, 11), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    ours = detect_dots(image, board)
    assert ok
    assert isinstance(ours, Detection)
    both = np.stack([theirs.reshape(-1, 2), theirs.reshape(-1, 2)[::-1]])
    assert np.abs(both - ours.pixels).max(axis=(1, 2)).min() < 0.5


@pytest.mark.parametrize(("rows", "symmetric"), [(6, True), (7, False)])
def test_an_even_asymmetric_grid_is_symmetric(rows: int, symmetric: bool) -> None:
    """Only with an even number of rows the grid equals its own half turn, and is_symmetric says so."""
    board = CircleGrid(4, rows, 5.0, 2.5)
    places = {tuple(place) for place in board.points_mm.tolist()}
    turned = {tuple(place) for place in (board.points_mm.max(axis=0) - board.points_mm).tolist()}
    assert board.is_symmetric is symmetric
    assert (turned == places) is symmetric


def test_circles_in_another_arrangement_are_a_miss() -> None:
    """The same number of marks in another arrangement is not taken for the board."""
    board = CircleGrid(4, 6, 5.0, 2.5)
    image = draw_board(board, SMALL.left, board_poses(SMALL, board, 1, seed=3)[0])
    found = detect_dots(image, CircleGrid(6, 4, 5.0, 2.5))
    assert isinstance(found, NotDetected)
    assert "arranged in another way" in found.reason


def test_dot_kernel_equals_its_plain_twin() -> None:
    """Residuals, normal equations and gradient of the dot model are those of the formula."""
    image = np.random.default_rng(3).integers(20, 200, (40, 40), dtype=np.uint8)
    p = np.array([19.3, 20.1, 0.17, 0.02, 0.2, -2.0, 110.0, 40.0, 3e-3, -2e-3])
    window = np.array([19.0, 20.5, 9.5, 0.0, 0.0])
    normal, gradient = np.empty((10, 10)), np.empty(10)
    total, _ = accumulate(DOT, image, p, window, normal, gradient, False)
    values, model, jacobian = dot_model(image, p, window)
    residuals = values - model
    assert total == pytest.approx(residuals @ residuals, rel=1e-12)
    lower = np.tril_indices(10)
    assert np.allclose(normal[lower], (jacobian.T @ jacobian)[lower], rtol=1e-4, atol=1e-2)
    assert np.allclose(gradient, jacobian.T @ residuals, rtol=1e-4, atol=1e-1)


# --- ChArUco --------------------------------------------------------------------------------------


CHARUCO = Charuco(8, 6, 10.0, 7.0, "5X5_250")


def charuco_picture(legacy: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A printed, smoothed board seen aslant, and the places of its inner corners."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    pattern = cv2.aruco.CharucoBoard((8, 6), 10.0, 7.0, dictionary)
    pattern.setLegacyPattern(legacy)
    print_px = pattern.generateImage((1600, 1200), marginSize=0)
    # the centre of print pixel (x, y) is (x + 0.5) / 200 squares from the board's edge
    squares = np.array([[0, 0], [8, 0], [8, 6], [0, 6]], np.float32)
    view = np.array([[80, 60], [580, 90], [540, 430], [60, 400]], np.float32)
    from_squares = cv2.getPerspectiveTransform(squares, view)
    from_print = from_squares @ np.array([[1 / 200, 0, 0.5 / 200], [0, 1 / 200, 0.5 / 200], [0, 0, 1]])
    large = np.diag([4.0, 4.0, 1.0]) @ np.array([[1, 0, 0.375], [0, 1, 0.375], [0, 0, 1]])
    image = cv2.warpPerspective(print_px, large @ from_print, (2560, 1920), borderValue=255)
    image = cv2.GaussianBlur(cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    y, x = np.mgrid[1:6, 1:8]
    corners = np.column_stack([x.ravel(), y.ravel(), np.ones(35)]) @ from_squares.T
    return image, corners[:, :2] / corners[:, 2:]


@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_corners_are_found_and_measured(legacy: bool) -> None:
    """All inner corners of a whole board, to a fiftieth of a pixel, for both printing conventions."""
    image, true = charuco_picture(legacy)
    found = detect_charuco(image, CHARUCO)
    assert isinstance(found, Detection)
    assert list(found.ids) == list(range(35))
    assert np.sqrt(np.mean((found.pixels - true) ** 2)) < 0.02


def test_a_part_of_a_charuco_board_suffices() -> None:
    """With half of the board covered the other corners keep their numbers and places."""
    image, true = charuco_picture()
    image[:, :320] = 120
    found = detect_charuco(image, CHARUCO)
    assert isinstance(found, Detection)
    assert 10 < len(found.ids) < 30
    assert np.abs(found.pixels - true[found.ids]).max() < 0.1
    image[:, :] = 120
    nothing = detect_charuco(image, CHARUCO)
    assert isinstance(nothing, NotDetected)
    assert "0 corners" in nothing.reason
