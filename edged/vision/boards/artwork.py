"""Printable artwork of a board, as shapes in the board's own frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.boards.board import Charuco, Chessboard, CircleGrid, DotBoard, NominalBoard

FRAME_OUTER, FRAME_INNER = 1.0, 0.75
"""Distances, in pitches, from the outermost dots to the edges of the frame around a grid of dots."""


@dataclass(frozen=True, slots=True)
class Ink:
    """Shapes of one shade, drawn together. black : True for black, False for white.

    rectangles : x, y, width, height.  circles : x, y, radius.  triangles : six coordinates.  All mm.
    """

    black: bool
    rectangles: tuple[tuple[float, ...], ...] = ()
    circles: tuple[tuple[float, ...], ...] = ()
    triangles: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class Artwork:
    """A board's ink in drawing order, in the board's frame (y down).

    low, high : corners of all ink, mm.
    """

    ink: tuple[Ink, ...]
    low: tuple[float, float]
    high: tuple[float, float]


def artwork(board: NominalBoard) -> Artwork:
    """Make the artwork of a board."""
    if isinstance(board, Chessboard):
        # a border of one square around the inner corners; the square beside mark 0 is black
        p = board.pitch_mm
        squares = _squares(board.columns + 1, board.rows + 1, p, (-p, -p))
        return Artwork((Ink(True, squares),), (-p, -p), (board.columns * p, board.rows * p))
    if isinstance(board, Charuco):
        return _charuco(board)
    dots = tuple((float(x), float(y), board.diameter_mm / 2) for x, y, _ in board.points_mm)
    far = board.points_mm[:, :2].max(axis=0)
    if isinstance(board, CircleGrid):
        r = board.diameter_mm / 2
        return Artwork((Ink(True, circles=dots),), (-r, -r), (float(far[0]) + r, float(far[1]) + r))
    return _dots(board, dots, far)


def _squares(
    columns: int, rows: int, side: float, origin: tuple[float, float]
) -> tuple[tuple[float, ...], ...]:
    """Black squares of a chessboard whose first corner square is black."""
    return tuple(
        (origin[0] + x * side, origin[1] + y * side, side, side)
        for y in range(rows)
        for x in range(columns)
        if (x + y) % 2 == 0
    )


def _dots(board: DotBoard, dots: tuple[tuple[float, ...], ...], far: FloatArray) -> Artwork:
    p = board.pitch_mm

    def box(reach: float) -> tuple[float, ...]:
        return (-reach, -reach, float(far[0]) + 2 * reach, float(far[1]) + 2 * reach)

    outer, inner = FRAME_OUTER * p, FRAME_INNER * p
    corner = (-outer, -outer, 0.0, -outer, -outer, 0.0)
    ink = (Ink(True, (box(outer),)), Ink(False, (box(inner),)), Ink(True, circles=dots, triangles=(corner,)))
    return Artwork(ink, (-outer, -outer), (float(far[0]) + outer, float(far[1]) + outer))


def _charuco(board: Charuco) -> Artwork:
    """ChArUco artwork as drawn by OpenCV since 4.6: first corner black, markers in the white squares."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    p, size = board.pitch_mm, (board.columns, board.rows)
    drawn = cv2.aruco.CharucoBoard(size, p, board.marker_mm, dictionary)
    cells = dictionary.markerSize + 2
    cell = board.marker_mm / cells
    black, white = list(_squares(*size, p, (-p, -p))), []
    for corners, number in zip(drawn.getObjPoints(), np.ravel(drawn.getIds()), strict=True):
        x, y = (np.asarray(corners)[:, :2].min(axis=0) - p).tolist()
        black.append((x, y, board.marker_mm, board.marker_mm))
        picture = cv2.aruco.generateImageMarker(dictionary, int(number), cells)
        white += [(x + k * cell, y + j * cell, cell, cell) for j, k in np.argwhere(picture > 127).tolist()]
    ink = (Ink(True, tuple(black)), Ink(False, tuple(white)))
    return Artwork(ink, (-p, -p), ((board.columns - 1) * p, (board.rows - 1) * p))
