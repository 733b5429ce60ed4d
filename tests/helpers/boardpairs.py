"""Pairs of pictures of a board drawn through a small rig: quick to detect, with known truth."""

from __future__ import annotations

from functools import cache

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.board import parse_board
from helpers.boards import board_poses, draw_board, right_pose
from helpers.rigs import make_rig

SPEC = "chessboard:8x6:6"
BOARD = parse_board(SPEC)
NOISE = 5.0
"""Grey values; a mark is found to about 0.01 px."""
RIG = make_rig(focal_px=1590.0, size=(640, 480))


def drawn(pose: FloatArray, seed: int = 0) -> tuple[Image, Image]:
    """Left and right picture of the board at left_from_board, with noise."""
    left = draw_board(BOARD, RIG.left, pose, noise=NOISE, seed=seed)
    return left, draw_board(BOARD, RIG.right, right_pose(RIG, pose), noise=NOISE, seed=seed)


@cache
def pairs(count: int = 6) -> tuple[tuple[Image, Image], ...]:
    """This many pairs, each with the board in another place; read-only."""
    return tuple(drawn(pose, seed) for seed, pose in enumerate(board_poses(RIG, BOARD, count, seed=3)))
