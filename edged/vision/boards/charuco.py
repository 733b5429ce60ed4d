"""ChArUco boards: markers identify the corners, so that a part of the board suffices."""

from __future__ import annotations

import math
from collections import Counter

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.board import Charuco, Detection, NotDetected
from edged.vision.boards.chessboard import judge_corners, reduced, refine_corners
from edged.vision.boards.params import DETECTION
from edged.vision.geometry.camera import CameraModel

_DICTIONARIES = (
    *("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36H12"),
    *("APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", "APRILTAG_36H11"),
)
"""The largest dictionary of each kind; the smaller ones are subsets from its beginning."""


def detect_charuco(image: Image, board: Charuco) -> Detection | NotDetected:
    """Find and measure the visible inner corners of a ChArUco board.

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
    if seen < DETECTION.min_corners:
        return NotDetected(
            f"{seen} corners of the ChArUco board found, at least {DETECTION.min_corners} are needed"
        )
    return _measure(image, board, grid, None)


def remeasure_charuco(
    image: Image, board: Charuco, found: Detection, camera: CameraModel
) -> Detection | NotDetected:
    """Measure a detected board again with the lens known."""
    grid = np.full((board.rows - 1, board.columns - 1, 2), np.nan)
    grid.reshape(-1, 2)[found.ids] = found.pixels
    return _measure(image, board, grid, camera)


def _measure(
    image: Image, board: Charuco, grid: FloatArray, camera: CameraModel | None
) -> Detection | NotDetected:
    # The window must not reach the marker in the white square, whose nearest point is its corner.
    share = 0.85 * math.sqrt(2) * (board.pitch_mm - board.marker_mm) / 2 / board.pitch_mm
    fits = refine_corners(image, grid, camera, radius_share=share)
    ids = np.flatnonzero(np.isfinite(grid.reshape(-1, 2)).all(axis=1))
    return judge_corners(fits[ids], ids)


def _markers(image: Image, board: Charuco, *, legacy: bool) -> tuple[FloatArray, list[int]]:
    """Approximate corners (N, 2) and their ids."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, board.marker_mm, dictionary)
    pattern.setLegacyPattern(legacy)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(image)
    if ids is None or corners is None:
        return np.empty((0, 2)), []
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2), [int(i) for i in np.ravel(ids)]


# --- recognition of unknown boards ------------------------------------------------------------------


def recognise_charuco(image: Image) -> Charuco | None:
    """Recognise a ChArUco board of any size in an image (H, W) uint8, with squares of 1 mm; None if none.

    Its last rows may be out of view: rows is the smallest number consistent with the markers. The dictionary
    is the largest of its kind; see `smallest_dictionary`.
    """
    small, _ = reduced(image)
    every = [cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}")) for name in _DICTIONARIES]
    corners, ids, _, kinds = cv2.aruco.ArucoDetector(every).detectMarkersMultiDict(small)
    if ids is None or not len(ids):
        return None
    kind = int(Counter(np.ravel(kinds).tolist()).most_common(1)[0][0])
    some = np.ravel(kinds) == kind
    outlines = np.asarray(corners, np.float64).reshape(-1, 4, 2)[some]
    share, places = _lattice(outlines)
    if len(places) < DETECTION.min_markers:
        return None
    size = _size_of({index: int(np.ravel(ids)[some][index]) for index in places}, places)
    if size is None or min(size) < 3:
        return None
    return Charuco(*size, 1.0, round(share, 2), _DICTIONARIES[kind])


def smallest_dictionary(board: Charuco) -> str:
    """Name of the smallest dictionary that contains all markers of a board."""
    kind, _, count = board.dictionary.rpartition("_")
    if count != "1000":
        return board.dictionary
    return next(f"{kind}_{size}" for size in (50, 100, 250, 1000) if size >= board.columns * board.rows / 2)


def _lattice(outlines: FloatArray) -> tuple[float, dict[int, tuple[int, int]]]:
    """Side of a marker over that of a square, and positions in squares of the connected markers.

    outlines (N, 4, 2) px, clockwise from the upper left corner as printed.
    """
    unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]], np.float32)
    maps = [cv2.getPerspectiveTransform(outline.astype(np.float32), unit) for outline in outlines]
    middles = np.array(
        [
            cv2.perspectiveTransform(np.zeros((1, 1, 2)), np.linalg.inv(homography))[0, 0]
            for homography in maps
        ]
    )
    # (N, N, 2): positions of all markers in the frame of each, in marker sides
    away = np.array([cv2.perspectiveTransform(middles[None], homography)[0] for homography in maps])
    off = np.abs(away)
    diagonal = (
        (off.min(axis=2) > 1.0) & (off.max(axis=2) < 3.0) & (np.ptp(off, axis=2) < 0.2 * off.max(axis=2))
    )
    if not diagonal.any():
        return 0.0, {}
    # the diagonally next white square is one square away in both directions
    share = 1.0 / float(np.median(off[diagonal & (off.max(axis=2) < 1.3 * off[diagonal].max(axis=1).min())]))
    steps = np.rint(away * share)
    near = (np.abs(steps).max(axis=2) <= 2) & (
        np.abs(away * share - steps).max(axis=2) < DETECTION.marker_tolerance
    )
    near &= steps.sum(axis=2) % 2 == 0
    best: dict[int, tuple[int, int]] = {}
    for seed in range(len(outlines)):
        if seed in best:
            continue
        places = {seed: (0, 0)}
        queue = [seed]
        while queue:
            here = queue.pop()
            for index in np.flatnonzero(near[here]).tolist():
                if index not in places:
                    x, y = steps[here, index].astype(int).tolist()
                    places[index] = places[here][0] + x, places[here][1] + y
                    queue.append(index)
        best = max(best, places, key=len)
    return share, best


def _size_of(ids: dict[int, int], places: dict[int, tuple[int, int]]) -> tuple[int, int] | None:
    """Columns and rows, in squares, of a board from its marker ids, which are numbered row by row.

    Two rows further the id is larger by the number of columns, whether that is even or odd.
    """
    at = {place: ids[index] for index, place in places.items()}
    grown = Counter(at[x, y + 2] - number for (x, y), number in at.items() if (x, y + 2) in at)
    if not grown or (columns := grown.most_common(1)[0][0]) < 1:
        return None
    rows = 0
    agreeing = 0
    for first in {columns // 2, columns - columns // 2}:  # markers in the first row
        row = {place: 2 * (number // columns) + (number % columns >= first) for place, number in at.items()}
        start, count = Counter(row[place] - place[1] for place in at).most_common(1)[0]
        if count > agreeing:
            agreeing, rows = count, 1 + start + max(y for x, y in at if row[x, y] - y == start)
    return (columns, rows) if agreeing > 0.8 * len(at) else None
