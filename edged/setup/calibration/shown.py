"""What live pictures show of a board: where it is, whether it is held still, and whether in its place.

Outlines are four corners in pixels of the full picture, once around a board's marks. Which of them is the
first does not matter: a board that is turned by a quarter tells as much.
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
"""Live pictures of this width are looked at in half the size, which takes half the time or less."""
STILL_S = 0.6
STILL_SHARE = 1e-3
"""Share of the picture's width: a hand-held board trembles by less, and edges do not smear yet."""
GAP_S = 1.5
"""Between two looks; after a longer one it is not known what happened meanwhile."""
GHOST_SHARE = 0.5
"""Share of the outline's diagonal: corners that are off by this much are not in the ghost at all."""
IN_GHOST = 0.6
"""From here on the view is the one that was asked for: corners are off by a fifth of the diagonal at most."""
NEW_SHARE = 0.35
"""Share of the diagonal: a view whose corners are off by more from every other is useful anyway."""
SAME_SHARE = 0.05
"""Share of the diagonal: a view whose corners are off by no more repeats another one."""
MEET_PX = 5.0
"""Corners of one board are off by a pixel or two in the raw picture, of another one by tens."""
_WHITE, _CLIPPED_SHARE = 255, 0.01
_DARK_GREY, _BRIGHT_SHARE = 40, 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A board in one picture. outline (4, 2); None: not found.

    missing : why not, for programs: "dark", "bright", "not_found", "other_board"; "" when it is found.
    reason : for people.
    clipped : some of it is white beyond what the camera can tell: edges beside it are shifted.
    """

    outline: FloatArray | None
    missing: str
    reason: str
    clipped: bool


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """A live pair. size (w, h) : of the left picture.

    recognised : the board that it shows, where none was stated or another one; in units of its pitch.
    """

    left: Seen
    right: Seen
    size: tuple[int, int]
    recognised: NominalBoard | None = None

    @property
    def is_seen(self) -> bool:
        """In both pictures."""
        return self.left.outline is not None and self.right.outline is not None

    @property
    def outlines(self) -> FloatArray:
        """(2, 4, 2) of both pictures, for pairs that show the board."""
        return np.array([self.left.outline, self.right.outline], dtype=np.float64)


def watch(left: Image, right: Image, boards: Sequence[NominalBoard], others: bool = False) -> Watched:
    """Look at a live pair; in half the size where that suffices. Without boards: which board is it?

    others : say which board it is where it is none of these.
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
    """What a picture shows by what was found of each board in it."""
    reason = ""
    for board, result in zip(boards, results, strict=True):
        if isinstance(result, NotDetected):
            reason = reason or result.reason
        else:
            outline = _outline_px(board, result)
            return Seen(outline, "", "", _is_clipped(image, outline))
    return Seen(None, _why_missing(image), reason, clipped=False)


def off_px(outlines: FloatArray, others: FloatArray) -> float:
    """Mean distance of corners (S, 4, 2) from others, whichever is the first, of the worse picture."""
    distances = [
        np.linalg.norm(outlines - np.roll(others, turn, axis=1), axis=2).mean(axis=1).max()
        for turn in range(4)
    ]
    return float(min(distances))


def corners_in_space(rig: StereoRig, outlines: FloatArray) -> FloatArray:
    """A board's corners (4, 3) in mm, rig frame, of its outlines (2, 4, 2) in both pictures.

    Each outline may begin anywhere, and go either way round: of all orders the one whose rays meet best is
    taken. NaN where they meet in none.
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
    """Distance, as `off_px`, from the nearest of others; infinite without any."""
    return min((off_px(outlines, other) for other in others), default=np.inf)


def diagonal_px(outlines: FloatArray) -> float:
    """Diagonal of the smaller outline; outlines (S, 4, 2)."""
    return float(np.linalg.norm(outlines[:, 2] - outlines[:, 0], axis=1).min())


def in_ghost(outlines: FloatArray, ghost: FloatArray) -> float:
    """1: exactly where it should be; 0: elsewhere. Both (S, 4, 2)."""
    return max(0.0, 1.0 - off_px(outlines, ghost) / (GHOST_SHARE * diagonal_px(ghost)))


def is_same(outlines: FloatArray, others: Sequence[FloatArray]) -> bool:
    """Whether a view of these shows the board just there: once more it would tell nothing."""
    return least_off_px(outlines, others) < SAME_SHARE * diagonal_px(outlines)


def is_new(outlines: FloatArray, others: Sequence[FloatArray]) -> bool:
    """Whether no view of these shows the board about there."""
    return least_off_px(outlines, others) >= NEW_SHARE * diagonal_px(outlines)


class Stillness:
    """Whether the board is held still, by one look after the other."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, FloatArray]] = deque()

    def look(self, at_s: float, watched: Watched | None) -> bool:
        """Add a look at a time; whether it has been still for `STILL_S` until then."""
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
    """The picture, and by how much it was made smaller."""
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
    """By the homography of the marks: where corners lie outside of the picture, too."""
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
