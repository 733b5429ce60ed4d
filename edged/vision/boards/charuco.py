"""ChArUco boards: markers say which corner is which, so that parts of a board suffice."""

from __future__ import annotations

import math

import cv2
import numpy as np

from edged.domain import FloatArray, Image
from edged.vision.boards.board import Charuco, Detection, NotDetected
from edged.vision.boards.chessboard import judge_corners, refine_corners
from edged.vision.geometry.camera import CameraModel

_MIN_CORNERS = 6  # a homography and half as much again; fewer say nothing of the lens


def detect_charuco(image: Image, board: Charuco) -> Detection | NotDetected:
    """Find the inner corners of a ChArUco board that are in view, and measure them.

    image (H, W) uint8.
    """
    grid = np.full((board.rows - 1, board.columns - 1, 2), np.nan)
    seen = 0
    for legacy in (False, True):  # boards printed with OpenCV before 4.6 start with the other colour
        corners, ids = _markers(image, board, legacy=legacy)
        if len(ids) > seen:
            seen = len(ids)
            grid[:] = np.nan
            grid.reshape(-1, 2)[ids] = corners
    if seen < _MIN_CORNERS:
        return NotDetected(f"{seen} corners of the ChArUco board found, at least {_MIN_CORNERS} are needed")
    return _measure(image, board, grid, None)


def remeasure_charuco(
    image: Image, board: Charuco, found: Detection, camera: CameraModel
) -> Detection | NotDetected:
    """Measure a detected board again, now that the lens is known."""
    grid = np.full((board.rows - 1, board.columns - 1, 2), np.nan)
    grid.reshape(-1, 2)[found.ids] = found.pixels
    return _measure(image, board, grid, camera)


def _measure(
    image: Image, board: Charuco, grid: FloatArray, camera: CameraModel | None
) -> Detection | NotDetected:
    # The window must end before the marker in the white square: its corner is nearest, on the diagonal.
    share = 0.85 * math.sqrt(2) * (board.pitch_mm - board.marker_mm) / 2 / board.pitch_mm
    fits = refine_corners(image, grid, camera, radius_share=share)
    ids = np.flatnonzero(np.isfinite(grid.reshape(-1, 2)).all(axis=1))
    return judge_corners(fits[ids], ids)


def _markers(image: Image, board: Charuco, *, legacy: bool) -> tuple[FloatArray, list[int]]:
    """Rough corners (N, 2) and their numbers."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, board.marker_mm, dictionary)
    pattern.setLegacyPattern(legacy)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(image)
    if ids is None or corners is None:
        return np.empty((0, 2)), []
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2), [int(i) for i in np.ravel(ids)]
