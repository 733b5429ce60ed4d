"""One door to the detectors of all kinds of boards."""

from __future__ import annotations

from edged.domain import Image
from edged.vision.boards import Board, Chessboard, Detection, Missed
from edged.vision.chessboard import detect_chessboard


def detect_board(image: Image, board: Board) -> Detection | Missed:
    """Find a board in an image (H, W) uint8 and measure its marks."""
    if isinstance(board, Chessboard):
        return detect_chessboard(image, board)
    return Missed(f"no detector for {board}")
