"""Unknown boards: kind and size are recognised from the pictures, and no board where there is none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board
from helpers.rigs import make_rig

from edged.domain.arrays import Image
from edged.vision.boards.board import Charuco, CircleGrid, Detection, DotBoard, NominalBoard, parse_board
from edged.vision.boards.detection import agreed_board, detect_board, of_size, recognise_board

SMALL = make_rig(focal_px=1600.0, size=(640, 480))
REAL = Path(__file__).parents[2] / "data" / "stereo-chessboard"
WHOLE = ((80, 60), (580, 90), (540, 430), (60, 400))
CUT = ((-150, 60), (580, -50), (540, 430), (-160, 400))
UPPER = ((80, 60), (580, 90), (540, 660), (60, 640))


def agreed(images: list[Image]) -> NominalBoard | None:
    """The board that several images agree on."""
    return agreed_board([seen for image in images if (seen := recognise_board(image))])


def charuco_picture(board: Charuco, view: object, legacy: bool = False) -> Image:
    """A printed board, its outer corners at the four places of a view (x, y) px."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    size = (board.columns, board.rows)
    pattern = cv2.aruco.CharucoBoard(size, board.pitch_mm, board.marker_mm, dictionary)
    pattern.setLegacyPattern(legacy)
    width, height = 240 * board.columns, 240 * board.rows
    outline = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    warp = cv2.getPerspectiveTransform(outline, 2 * np.array(view, np.float32))
    large = cv2.warpPerspective(pattern.generateImage((width, height)), warp, (1280, 960), borderValue=200)
    smooth = cv2.GaussianBlur(cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    return np.asarray(smooth, np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("chessboard:11x8:2.4", "chessboard:11x8"),
        ("chessboard:5x6:4", "chessboard:6x5"),
        ("dots:7x7:3", "dots:7x7"),
        ("dots:5x9:3", "dots:5x9"),
        ("circles:4x11:4", "circles:4x11"),
        ("circles:4x11:4:4.5", "circles:4x11"),
        ("circles:3x7:6", "circles:3x7"),
    ],
)
def test_kind_and_size_are_seen(spec: str, expected: str) -> None:
    """The recognised board with its pitch is a specification that finds the board in every picture."""
    board = parse_board(spec)
    images = [
        draw_board(board, SMALL.left, pose, noise=2.0, seed=seed)
        for seed, pose in enumerate(board_poses(SMALL, board, 3, seed=4, tilt_deg=30))
    ]
    seen = agreed(images)
    assert seen is not None
    whole = parse_board(str(of_size(seen, board.pitch_mm)))
    assert f"{expected}:{board.pitch_mm:g}" == ":".join(str(whole).split(":")[:3])
    assert all(isinstance(detect_board(image, whole), Detection) for image in images)
    if isinstance(board, DotBoard | CircleGrid) and isinstance(whole, DotBoard | CircleGrid):
        assert whole.diameter_mm == pytest.approx(board.diameter_mm, rel=0.08)


@pytest.mark.long
@pytest.mark.parametrize(
    ("board", "legacy"),
    [
        (Charuco(8, 6, 10.0, 7.0, "5X5_250"), False),
        (Charuco(7, 5, 10.0, 8.0, "4X4_50"), False),
        (Charuco(5, 8, 10.0, 7.5, "6X6_100"), True),  # another pattern where the count of rows is even
        (Charuco(6, 6, 10.0, 6.0, "APRILTAG_36H11"), True),
        (Charuco(5, 7, 10.0, 7.0, "ARUCO_ORIGINAL"), False),
    ],
    ids=str,
)
def test_markers_tell_the_board(board: Charuco, legacy: bool) -> None:
    """Columns, rows, dictionary and marker size are recognised, also if the left side is cut off."""
    images = [charuco_picture(board, view, legacy) for view in (WHOLE, CUT)]
    seen = agreed(images)
    assert isinstance(seen, Charuco)
    assert (board.columns, board.rows) == (seen.columns, seen.rows)
    assert board.dictionary.partition("_")[0] == seen.dictionary.partition("_")[0]
    assert board.marker_mm == pytest.approx(10 * seen.marker_mm, abs=0.2)
    assert isinstance(detect_board(images[0], of_size(seen, 10.0)), Detection)


@pytest.mark.slow
def test_the_lowest_rows_come_from_the_picture_that_shows_them() -> None:
    """A picture without the last rows does not make the board smaller."""
    board = Charuco(8, 6, 10.0, 7.0, "5X5_250")
    cut, whole = charuco_picture(board, UPPER), charuco_picture(board, WHOLE)
    alone = recognise_board(cut)
    assert isinstance(alone, Charuco)
    assert alone.rows < 6
    seen = recognise_board(whole)
    both = agreed_board([alone] if seen is None else [alone, seen])
    assert isinstance(both, Charuco)
    assert (8, 6, "5X5_50") == (both.columns, both.rows, both.dictionary)


@pytest.mark.long
def test_a_real_board_is_recognised_by_most_pictures() -> None:
    """Most pictures of a hand-held board in a room give 9x6, and so does their majority."""
    pictures = sorted(REAL.glob("*.jpg"))
    images = [np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8) for path in pictures]
    seen = [recognise_board(image) for image in images]
    right = [one for one in seen if str(one) == "chessboard:9x6:1"]
    assert len(right) > 0.8 * len(images)
    assert "chessboard:9x6:25" == str(of_size(right[0], 25.0))
    assert right[0] == agreed_board([one for one in seen if one is not None])


@pytest.mark.slow
def test_nothing_is_seen_where_no_board_is() -> None:
    """A plain picture, noise and three dots give no board."""
    noise = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    dots = np.full((480, 640), 200, np.uint8)
    for x in (200, 300, 400):
        cv2.circle(dots, (x, 240), 20, 20, -1)
    assert [None] * 3 == [
        recognise_board(image) for image in (np.full((480, 640), 90, np.uint8), noise, dots)
    ]


def test_no_majority_is_no_answer() -> None:
    """One picture of each of two boards, or none, gives no board."""
    boards = [parse_board(spec) for spec in ("chessboard:8x6:3", "chessboard:7x5:3")]
    images = [draw_board(one, SMALL.left, board_poses(SMALL, one, 1, seed=4)[0]) for one in boards]
    assert agreed(images) is None
    assert agreed([]) is None
