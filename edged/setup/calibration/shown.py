"""Analyses live pictures of a board: where it is, whether it is held still, and whether it is in its ghost.

Outlines are four corners in pixels of the full picture, in order around a board's marks. Which one is first
does not matter: a board rotated by 90 degrees is worth the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.setup.calibration.boards import may_be
from edged.setup.pairs import work_on
from edged.vision.boards.board import Detection, NominalBoard, NotDetected, outline_mm
from edged.vision.boards.detection import detect_board, recognise_board
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw

HALVED_FROM_PX = 800
"""Live pictures of at least this width are analysed at half the size, which takes half the time or less."""
STILL_S = 0.6
STILL_SHARE = 1e-3
"""Limit on movement as a share of the picture's width: hand tremor is less, and does not blur edges."""
GAP_S = 1.5
"""Longest gap between two live pairs; after a longer one the board may have moved meanwhile."""
GHOST_SHARE = 0.5
"""Share of the ghost's diagonal: if corners are off by this much, the board is not in the ghost at all."""
IN_GHOST = 0.6
"""A match from which the board counts as in the ghost: corners are off by a fifth of the diagonal at most."""
NEW_SHARE = 0.35
"""Share of the diagonal: a view whose corners differ by more from every other view is useful anywhere."""
SAME_SHARE = 0.05
"""Share of the diagonal: a view whose corners differ by less from another one is a duplicate."""
MEET_PX = 5.0
"""Limit on the reprojection error of corners: matching ones are off by a pixel or two, wrong ones by tens."""
_WHITE, _CLIPPED_SHARE = 255, 0.01
_DARK_GREY, _BRIGHT_SHARE = 40, 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A board in one picture. outline (4, 2); None if not found.

    missing : code of why not: "dark", "bright", "not_found", "other_board"; "" when it is found.
    reason : the same for people.
    clipped : parts of it are overexposed, which shifts the edges beside them.
    """

    outline: FloatArray | None
    missing: str
    reason: str
    clipped: bool


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """A live pair. size (w, h) : of the left picture.

    recognised : the board seen if none or another one was stated; in units of its pitch.
    """

    left: Seen
    right: Seen
    size: tuple[int, int]
    recognised: NominalBoard | None = None

    @property
    def is_seen(self) -> bool:
        """Whether the board is seen in both pictures."""
        return self.left.outline is not None and self.right.outline is not None

    @property
    def outlines(self) -> FloatArray:
        """Outlines (2, 4, 2) in both pictures, for pairs that show the board."""
        return np.array([self.left.outline, self.right.outline], dtype=np.float64)


def watch(left: Image, right: Image, boards: Sequence[NominalBoard], others: bool = False) -> Watched:
    """Analyse a live pair, at half the size if it is large. Without boards, recognise the one it shows.

    others : recognise another board if none of these is found.
    """
    images = [_halved(image) for image in (left, right)]
    recognised = None
    if not boards:
        recognised = recognise_board(images[0][0])
        boards = () if recognised is None else (recognised,)
    both = work_on([partial(_see, *image, boards) for image in images], "", lambda *_: None)
    if others and recognised is None and [seen.missing for seen in both] == ["not_found"] * len(both):
        recognised = recognise_board(images[0][0])
        if recognised is not None and any(may_be(board, recognised) for board in boards):
            recognised = None
        if recognised is not None:
            both = [replace(seen, missing="other_board") for seen in both]
    return Watched(both[0], both[1], (left.shape[1], left.shape[0]), recognised)


def seen_in(image: Image, boards: Sequence[NominalBoard], results: Sequence[Detection | NotDetected]) -> Seen:
    """Summary of a picture from the detection results of each board in it."""
    reason = ""
    for board, result in zip(boards, results, strict=True):
        if isinstance(result, NotDetected):
            reason = reason or result.reason
        else:
            outline = _outline_px(board, result)
            return Seen(outline, "", "", _is_clipped(image, outline))
    return Seen(None, _why_missing(image), reason, clipped=False)


def off_px(outlines: FloatArray, others: FloatArray) -> float:
    """Mean distance between corners (S, 4, 2) in the worse picture, minimised over the first corner."""
    distances = [
        np.linalg.norm(outlines - np.roll(others, turn, axis=1), axis=2).mean(axis=1).max()
        for turn in range(4)
    ]
    return float(min(distances))


def corners_in_space(rig: StereoRig, outlines: FloatArray) -> FloatArray:
    """A board's corners (4, 3) in mm, rig frame, from its outlines (2, 4, 2) in both pictures.

    Each outline may begin at any corner and go either way round: the order whose rays meet best is used. NaN
    if they meet in none.
    """
    left, right = outlines
    found, least_px = np.full((4, 3), np.nan), MEET_PX
    for order in (np.roll(np.arange(4)[::way], first) for way in (1, -1) for first in range(4)):
        corners = triangulate_raw(rig, left, right[order])
        if not np.isfinite(corners).all():
            continue
        seen = (
            rig.left.project(corners) - left,
            rig.right.project(apply(rig.right_from_left, corners)) - right[order],
        )
        off = float(np.abs(seen).max())
        if off < least_px:
            found, least_px = corners, off
    return found


def least_off_px(outlines: FloatArray, others: Sequence[FloatArray]) -> float:
    """Distance by `off_px` from the nearest of others; infinite without any."""
    return min((off_px(outlines, other) for other in others), default=np.inf)


def diagonal_px(outlines: FloatArray) -> float:
    """Diagonal of the smaller outline; outlines (S, 4, 2)."""
    return float(np.linalg.norm(outlines[:, 2] - outlines[:, 0], axis=1).min())


def in_ghost(outlines: FloatArray, ghost: FloatArray) -> float:
    """How well outlines match a ghost, both (S, 4, 2): 1 exactly, 0 elsewhere."""
    return max(0.0, 1.0 - off_px(outlines, ghost) / (GHOST_SHARE * diagonal_px(ghost)))


def is_same(outlines: FloatArray, others: Sequence[FloatArray]) -> bool:
    """Whether one of the other views shows the board in the same place, so that another adds nothing."""
    return least_off_px(outlines, others) < SAME_SHARE * diagonal_px(outlines)


def is_new(outlines: FloatArray, others: Sequence[FloatArray]) -> bool:
    """Whether none of the other views shows the board near there."""
    return least_off_px(outlines, others) >= NEW_SHARE * diagonal_px(outlines)


class Stillness:
    """Tracks over successive live pairs whether the board is held still."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, FloatArray]] = deque()

    def look(self, at_s: float, watched: Watched | None) -> bool:
        """Add a live pair seen at a time; return whether the board has been still for `STILL_S`."""
        if watched is None or not watched.is_seen:
            self._looks.clear()
            return False
        outlines = watched.outlines
        if self._looks and (
            at_s - self._looks[-1][0] > GAP_S
            or np.abs(outlines - self._looks[-1][1]).max() > 0.5 * diagonal_px(outlines)
        ):
            self._looks.clear()  # a gap, or numbered from another corner
        self._looks.append((at_s, outlines))
        while len(self._looks) > 2 and at_s - self._looks[1][0] >= STILL_S:
            self._looks.popleft()
        if at_s - self._looks[0][0] < STILL_S:
            return False
        where = np.array([outlines for _, outlines in self._looks])
        moved = np.linalg.norm(where - where.mean(axis=0), axis=-1)
        return bool(moved.max() <= STILL_SHARE * watched.size[0])


def _halved(image: Image) -> tuple[Image, int]:
    """The picture, halved if it is large, and the factor by which it was reduced."""
    if image.shape[1] < HALVED_FROM_PX:
        return image, 1
    half = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(half, np.uint8), 2


def _see(image: Image, shrunk: int, boards: Sequence[NominalBoard]) -> Seen:
    results: list[Detection | NotDetected] = []
    for board in boards:
        results.append(detect_board(image, board))
        if isinstance(results[-1], Detection):
            break
    seen = seen_in(image, boards[: len(results)], results)
    if seen.outline is None or shrunk == 1:
        return seen
    full = (seen.outline + 0.5) * shrunk - 0.5
    return Seen(full, seen.missing, seen.reason, seen.clipped)


def _outline_px(board: NominalBoard, found: Detection) -> FloatArray:
    """Outline of a board by the homography of its marks, also where corners lie outside the picture."""
    from_board, _ = cv2.findHomography(board.points_mm[found.ids, :2], found.pixels)
    corners = outline_mm(board)[:, :2]
    return np.asarray(cv2.perspectiveTransform(corners[None], from_board)[0], np.float64)


def _is_clipped(image: Image, outline: FloatArray) -> bool:
    inside = np.zeros(image.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.round(outline).astype(np.int32), 1)
    pixels = image[inside == 1]
    return bool(pixels.size and np.mean(pixels == _WHITE) > _CLIPPED_SHARE)


def _why_missing(image: Image) -> str:
    if float(np.percentile(image, 99)) < _DARK_GREY:
        return "dark"
    return "bright" if float(np.mean(image == _WHITE)) > _BRIGHT_SHARE else "not_found"
