"""Common interface to the detectors of all kinds of boards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from statistics import median

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.board import Charuco, Chessboard, Detection, DotBoard, NominalBoard, NotDetected
from edged.vision.boards.charuco import (
    detect_charuco,
    recognise_charuco,
    remeasure_charuco,
    smallest_dictionary,
)
from edged.vision.boards.chessboard import detect_chessboard, recognise_chessboard, remeasure_chessboard
from edged.vision.boards.circlegrid import detect_dots, recognise_dots, remeasure_dots
from edged.vision.geometry.camera import CameraModel


def detect_board(image: Image, board: NominalBoard) -> Detection | NotDetected:
    """Find a board in an image (H, W) uint8 and measure its marks."""
    if isinstance(board, Chessboard):
        return detect_chessboard(image, board)
    if isinstance(board, Charuco):
        return detect_charuco(image, board)
    return detect_dots(image, board)


def recognise_board(image: Image) -> NominalBoard | None:
    """Recognise a board of any kind and size in an image (H, W) uint8, in units of its pitch; None if none.

    Its size is what this one image shows; `agreed_board` combines the boards of several images.
    """
    # chessboard first: comparing each of its squares with the markers of all dictionaries takes seconds
    return recognise_chessboard(image) or recognise_charuco(image) or recognise_dots(image)


def agreed_board(seen: Sequence[NominalBoard]) -> NominalBoard | None:
    """The board shown by more than half of several images, from their `recognise_board`, or None.

    In units of its pitch, with the smallest dictionary that contains its markers.
    """
    if not seen:
        return None
    alike = Counter(map(_alike, seen)).most_common(1)[0]
    if 2 * alike[1] <= len(seen):
        return None
    boards = [board for board in seen if _alike(board) == alike[0]]
    # the last rows of a ChArUco board may be out of view
    most = max(boards, key=lambda board: board.rows)
    if not isinstance(most, Charuco):
        return most
    share = round(median(board.marker_mm for board in boards if isinstance(board, Charuco)), 2)
    return replace(most, marker_mm=share, dictionary=smallest_dictionary(most))


def _alike(board: NominalBoard) -> NominalBoard:
    """The board without the values that vary between images of the same board."""
    if isinstance(board, Charuco):
        return replace(board, rows=0, marker_mm=0.0)
    return board if isinstance(board, Chessboard) else replace(board, diameter_mm=0.0)


def of_size(board: NominalBoard, pitch_mm: float) -> NominalBoard:
    """Scale a board given in units of its pitch to a pitch in mm."""
    if isinstance(board, Chessboard):
        return replace(board, pitch_mm=pitch_mm)
    if isinstance(board, Charuco):
        return replace(board, pitch_mm=pitch_mm, marker_mm=_rounded(pitch_mm * board.marker_mm))
    return replace(board, pitch_mm=pitch_mm, diameter_mm=_rounded(pitch_mm * board.diameter_mm))


def _rounded(length_mm: float) -> float:
    return float(f"{length_mm:.4g}")


def in_words(board: NominalBoard) -> str:
    """Kind and size in words, as counted on the board."""
    size = f"{board.columns}x{board.rows}"
    if isinstance(board, Chessboard):
        return f"a chessboard of {size} inner corners"
    if isinstance(board, Charuco):
        return f"a ChArUco board of {size} squares, markers of {smallest_dictionary(board)}"
    if isinstance(board, DotBoard):
        return f"a plate of {size} dots"
    return f"an asymmetric plate of {size} circles"


def remeasure_board(
    image: Image, board: NominalBoard, found: Detection, camera: CameraModel, camera_from_board: FloatArray
) -> Detection | NotDetected:
    """Measure the marks again with lens and pose approximately known.

    This removes small errors due to edges curved by the lens, and to ellipses whose centre is not the
    image of the dot's centre.
    """
    if isinstance(board, Chessboard):
        return remeasure_chessboard(image, board, found, camera)
    if isinstance(board, Charuco):
        return remeasure_charuco(image, board, found, camera)
    return remeasure_dots(image, board, found, camera, camera_from_board)
