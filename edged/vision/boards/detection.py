"""One door to the detectors of all kinds of boards."""

from __future__ import annotations

from collections.abc import Sequence

from edged.domain import FloatArray, Image
from edged.vision.boards.board import Charuco, Chessboard, Detection, NominalBoard, NotDetected
from edged.vision.boards.charuco import detect_charuco, remeasure_charuco
from edged.vision.boards.chessboard import detect_chessboard, remeasure_chessboard
from edged.vision.boards.circlegrid import detect_dots, remeasure_dots
from edged.vision.geometry.camera import CameraModel

NEIGHBOUR_SIZES = ((1, 1), (0, 1), (1, 0), (0, -1), (-1, 0), (-1, -1))
"""Columns and rows more than stated, larger boards first: a smaller one may be a part of the true one."""


def detect_board(image: Image, board: NominalBoard) -> Detection | NotDetected:
    """Find a board in an image (H, W) uint8 and measure its marks."""
    if isinstance(board, Chessboard):
        return detect_chessboard(image, board)
    if isinstance(board, Charuco):
        return detect_charuco(image, board)
    return detect_dots(image, board)


def fitting_size(images: Sequence[Image], board: NominalBoard) -> str | None:
    """The COLSxROWS of the chessboard that most images (H, W) uint8 show, where it is not the stated size.

    Most often squares were counted: a chessboard of 12x9 squares has 11x8 inner corners. None: no other fits.
    """
    if not isinstance(board, Chessboard):
        return None
    images = [image for image in images if isinstance(detect_board(image, board), NotDetected)]
    if not images:
        return None
    for columns, rows in NEIGHBOUR_SIZES:
        size = board.columns + columns, board.rows + rows
        if min(size) < 3:
            continue
        other = Chessboard(*size, board.pitch_mm)
        seen = sum(isinstance(detect_board(image, other), Detection) for image in images)
        if 2 * seen >= len(images):
            return f"{size[0]}x{size[1]}"
    return None


def remeasure_board(
    image: Image, board: NominalBoard, found: Detection, camera: CameraModel, camera_from_board: FloatArray
) -> Detection | NotDetected:
    """Measure the marks again now that lens and pose are known roughly.

    That takes the small errors away that come from edges bent by the lens and from
    ellipses whose middle is not the image of the dot's centre.
    """
    if isinstance(board, Chessboard):
        return remeasure_chessboard(image, board, found, camera)
    if isinstance(board, Charuco):
        return remeasure_charuco(image, board, found, camera)
    return remeasure_dots(image, board, found, camera, camera_from_board)
