"""Which board the pictures show: a few false recognitions do not outvote the stated board."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.boards import board_poses, draw_board
from helpers.rigs import make_rig

from edged.domain.arrays import Image
from edged.errors import CalibrationError
from edged.setup.calibration import views as views_module
from edged.setup.calibration.boards import boards_in, check_board_shown, stated_boards
from edged.setup.calibration.views import FIRST_LOOKED_AT, Views
from edged.setup.pairs import Pair, Picture
from edged.vision.boards.board import NominalBoard, parse_board
from edged.vision.boards.detection import Detection, NotDetected, detect_board

SMALL = make_rig(focal_px=1600.0, size=(640, 480))
STATED, OTHER = parse_board("chessboard:8x6:3"), parse_board("chessboard:7x5:3")
BLANK = np.full((480, 640), 90, np.uint8)


def picture(label: str, image: Image) -> Picture:
    """A picture in memory."""
    return Picture(label, lambda: image)


def drawn(board: NominalBoard, count: int) -> list[Picture]:
    """Pictures of a board."""
    poses = board_poses(SMALL, board, count, seed=4)
    return [picture(f"{board}_{n}", draw_board(board, SMALL.left, pose)) for n, pose in enumerate(poses)]


@pytest.mark.slow
@pytest.mark.parametrize(("others", "blanks", "refused"), [(3, 2, True), (2, 2, False), (1, 5, False)])
def test_another_board_must_be_in_most_pictures(others: int, blanks: int, refused: bool) -> None:
    """Another board is an error only if most pictures show it."""
    pictures = [*drawn(OTHER, others), *(picture(f"blank {n}", BLANK) for n in range(blanks))]
    if refused:
        with pytest.raises(CalibrationError, match=r"7x5 inner corners, not 8x6.*chessboard:7x5:3"):
            check_board_shown(pictures, STATED)
    else:
        check_board_shown(pictures, STATED)


@pytest.mark.long
def test_another_board_is_told_after_a_few_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another board is found after looking at a few pictures, with one full search in vain."""
    looked: list[str] = []
    searched: list[object] = []

    def detect(image: Image, board: NominalBoard) -> Detection | NotDetected:
        searched.append(board)
        return detect_board(image, board)

    monkeypatch.setattr(views_module, "detect_board", detect)

    def counted(shown: Picture) -> Picture:
        def read() -> Image:
            looked.append(shown.label)
            return shown.read()

        return Picture(shown.label, read)

    pictures = [counted(shown) for shown in drawn(OTHER, 20)]
    pairs = [Pair(shown.label, shown, shown) for shown in pictures]
    with pytest.raises(CalibrationError, match=r"7x5 inner corners, not 8x6"):
        Views([STATED]).add(pairs)
    assert len(looked) <= 3 * FIRST_LOOKED_AT
    assert 2 == len(searched)


@pytest.mark.slow
def test_a_few_pictures_of_another_board_do_not_stop_many_of_the_stated_one() -> None:
    """A few pictures of another board do not stop a calibration, whatever their order."""
    pictures = drawn(STATED, 4) + drawn(OTHER, 1)
    for order in (pictures, pictures[::-1]):
        views = Views([STATED])
        views.add([Pair(shown.label, shown, shown) for shown in order])
        assert [shown.label for shown in order] == [pair.name for pair in views.pairs]


@pytest.mark.slow
def test_what_looks_like_the_stated_board_is_no_other() -> None:
    """Exchanged columns and rows, or an equivalent circle grid, count as the stated board."""
    check_board_shown(drawn(STATED, 2), parse_board("chessboard:6x8:3"))
    circles = drawn(parse_board("circles:4x6:4"), 1)
    check_board_shown(circles, parse_board("circles:3x8:4"))
    with pytest.raises(
        CalibrationError, match=r"plate of 4x6 circles, not circles:4x11:4:2; state circles:4x6:4"
    ):
        check_board_shown(circles, parse_board("circles:4x11:4"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("4", 4.0),
        (" 4.50 MM", 4.5),
        ("4,5mm", 4.5),
        (None, None),
        ("chessboard:8x6:3, chessboard:7x5:3", (STATED, OTHER)),
    ],
)
def test_what_can_be_stated(text: str | None, expected: object) -> None:
    """A board can be stated as a length in mm with point or comma, as one or more boards, or not at all."""
    assert expected == stated_boards(text)


def test_the_pictures_are_spread_over_the_folder() -> None:
    """Six of forty pictures are looked at, from the first to the last."""
    read: list[int] = []

    def note(number: int) -> Image:
        read.append(number)
        return BLANK

    pictures = [Picture(str(number), lambda number=number: note(number)) for number in range(40)]
    with pytest.raises(CalibrationError, match="no board was recognised in 0, 8, 16, 23, 31, 39"):
        boards_in(None, pictures)
    assert [0, 8, 16, 23, 31, 39] == sorted(read)
