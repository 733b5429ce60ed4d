"""Suggests where to hold the board next: an outline in both pictures, and the sigma expected with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError, EdgedError
from edged.setup.calibration.shown import IN_GHOST, Watched, in_ghost, is_new, is_same, least_off_px
from edged.setup.calibration.views import Views
from edged.setup.pairs import Progress, silent
from edged.vision.boards.board import Board, Detection, NotDetected, outline_mm
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.calibration.lenschoice import LensWish
from edged.vision.calibration.nextbestview import TILT_DEG, TILTS, Suggestion, plan_views
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

SUGGESTED = 3
IN_PLACE_S, ANYWHERE_S = 4.0, 20.0
"""How long a ghost is offered without a new view while the board rests in it, and elsewhere or unseen."""
FLOOR_PX, FLOOR_VIEWS = 0.01, 3
"""Lower limit on a mark's sigma, as few boards are printed, and few lenses follow their model, any better; it
holds for up to this many views, and falls with the square root of their number beyond, as sigma does and as
more residuals are more credible."""
FIRST_SHARE, LEAST_SHARE, MOST_SHARE = 0.6, 0.35, 0.8
"""Share of the picture's height that the board's diagonal should fill: before any board is seen, and the
limits of the share at which the user holds it first. Only the volume where boards were held is calibrated."""
_NOMINAL_FOCAL = (
    2.0  # times the picture's width: 16 mm before a sensor of 1/1.8"; outlines hardly depend on it
)


@dataclass(frozen=True, slots=True, eq=False)
class Ghost:
    """An outline to hold the board in. left, right (4, 2) px; right is None while it is not known.

    sigma_um (3,) : of X, Y, Z, expected with this view; None while there is no calibration.
    code, text : the view for programs and for people.
    """

    left: FloatArray
    right: FloatArray | None
    sigma_um: FloatArray | None
    code: str
    text: str

    @property
    def outlines(self) -> FloatArray:
        """Outlines (S, 4, 2) in the pictures in which they are known."""
        return np.array([self.left] if self.right is None else [self.left, self.right])


@dataclass(frozen=True, slots=True, eq=False)
class Guided:
    """Result of the views so far. trouble : why they give no calibration yet; None when they do.

    rms_px, excluded : by the name of a view.  sigma_um (3,) : of X, Y, Z in the working volume.
    ghosts : the best first.  more_views : needed for the goal; None without one, or if out of reach.
    """

    trouble: EdgedError | None
    ghosts: Sequence[Ghost]
    rms_px: dict[str, float] = field(default_factory=dict)
    excluded: dict[str, str] = field(default_factory=dict)
    sigma_um: FloatArray | None = None
    more_views: int | None = None


def guide(
    views: Views,
    lens: LensWish,
    goal_um: float | None = None,
    taken: Sequence[FloatArray] = (),
    progress: Progress = silent,
    *,
    share: float = FIRST_SHARE,
) -> Guided:
    """Calibrate from the marks as they were found, and plan the next views.

    taken (2, 4, 2) : outlines of each view.  share : as `held_share` returns.
    """
    sizes = views.sizes
    progress("bundle adjustment", 0, 0)
    floor_px = FLOOR_PX * float(np.sqrt(FLOOR_VIEWS / max(len(views.pairs), FLOOR_VIEWS)))
    found = [
        replace(view, left=_floored(view.left, floor_px), right=_floored(view.right, floor_px))
        for view in views.found
    ]
    try:
        calibration = calibrate_stereo(found, *sizes, lens)
    except CalibrationError as error:
        return Guided(error, first_ghosts(views.boards[0], sizes[0], len(views.pairs), share))
    progress("the next view", 0, 0)
    plan = plan_views(calibration, None, None if goal_um is None else 1e-3 * goal_um)
    rms = {fit.name: fit.rms_px for fit in calibration.views}
    if plan is None:
        return Guided(None, (), rms, dict(calibration.excluded))
    ghosts = (
        _ghost(calibration, suggestion, 1e3 * sigma_mm)
        for suggestion, sigma_mm in zip(plan.suggestions, plan.sigmas_mm, strict=True)
    )
    # a ghost where there already is a view would not help, even if the solution excluded that view
    fresh = list(islice((ghost for ghost in ghosts if not is_same(ghost.outlines, taken)), SUGGESTED))
    return Guided(None, fresh, rms, dict(calibration.excluded), 1e3 * plan.sigma_mm, plan.more_views)


def wait_reason(
    watched: Watched | None, *, still: bool, ghost: Ghost | None, others: Sequence[FloatArray]
) -> str:
    """Code of why a pair is not taken automatically; "" if it should be taken.

    others (2, 4, 2) : outlines of each view in use.
    """
    if watched is None or (watched.left.outline is None and watched.right.outline is None):
        return "no_board"
    if not watched.is_seen:
        return "no_board_left" if watched.left.outline is None else "no_board_right"
    # position comes before stillness: holding the board still in a wrong place would be in vain
    if ghost is not None and nearness(watched, ghost) >= IN_GHOST:
        waits = "" if _is_nearer(watched, ghost, others) else "same"
    elif is_same(watched.outlines, others):
        waits = "same"
    else:
        waits = "" if is_new(watched.outlines, others) else "elsewhere"
    return waits or ("" if still else "moving")


def _is_nearer(watched: Watched, ghost: Ghost, others: Sequence[FloatArray]) -> bool:
    """Whether a board in the ghost is nearer to it than to any view, or repeats no view.

    A ghost may be as close to a view as the hand's error: a board in the ghost then looks like that view.
    """
    if not is_same(watched.outlines, others):
        return True
    count = len(ghost.outlines)
    known, views = watched.outlines[:count], [other[:count] for other in others]
    off = least_off_px(known, [ghost.outlines])
    return not is_same(ghost.outlines, views) and off < least_off_px(known, views)


class GhostSelector:
    """Chooses the ghost to offer: the next one if the board rested or was unseen too long without a view."""

    def __init__(self) -> None:
        self._ghosts: Sequence[Ghost] = ()
        self._passed = 0
        self._rests: tuple[bool, float] | None = None

    def offered(self, ghosts: Sequence[Ghost]) -> Ghost | None:
        """The ghost to offer: the best one until `look` has moved on to the next. None without any."""
        if ghosts is not self._ghosts:
            self._ghosts, self._passed, self._rests = ghosts, 0, None
        return ghosts[self._passed % len(ghosts)] if ghosts else None

    def look(self, at_s: float, ghosts: Sequence[Ghost], watched: Watched, *, still: bool) -> None:
        """Add a live pair seen at a time."""
        ghost = self.offered(ghosts)
        if ghost is None or (watched.is_seen and not still):
            self._rests = None
            return
        is_in = nearness(watched, ghost) >= IN_GHOST
        if self._rests is None or self._rests[0] != is_in:
            self._rests = is_in, at_s
        elif at_s - self._rests[1] >= (IN_PLACE_S if is_in else ANYWHERE_S):
            self._passed, self._rests = self._passed + 1, None


def nearness(watched: Watched, ghost: Ghost) -> float:
    """How well the board matches the ghost, 0 to 1, in those pictures where the ghost is known."""
    if not watched.is_seen:
        return 0.0
    return in_ghost(watched.outlines[: len(ghost.outlines)], ghost.outlines)


def held_share(watched: Watched) -> float:
    """Share of the picture's height that the board's diagonal fills now, within its limits."""
    if not watched.is_seen:
        return FIRST_SHARE
    left = watched.outlines[0]
    # a tilt shortens one of the two diagonals
    longest = max(np.linalg.norm(left[2] - left[0]), np.linalg.norm(left[3] - left[1]))
    return float(np.clip(longest / watched.size[1], LEAST_SHARE, MOST_SHARE))


def first_ghosts(board: Board, size: tuple[int, int], views: int, share: float = FIRST_SHARE) -> list[Ghost]:
    """Ghosts before there is a calibration: one tilt after the other in the middle of the left picture.

    share : of the picture's height, for the diagonal of the board.
    """
    width, height = size
    focal = _NOMINAL_FOCAL * width
    camera = CameraModel("division", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, (0.0,))
    corners = outline_mm(board)
    middle = corners.mean(axis=0)
    depth = focal * float(np.linalg.norm(corners[2] - corners[0])) / (share * height)
    words, code, axis = TILTS[1:][views % (len(TILTS) - 1)]
    rotation = rotation_matrix(np.radians(TILT_DEG) * np.array([*axis, 0.0]))
    pose = transform(rotation, np.array([0.0, 0.0, depth]) - rotation @ middle)
    text = f"board in the middle of the left image, {words} by {TILT_DEG:.0f}°"
    return [Ghost(camera.project(apply(pose, corners)), None, None, f"middle-middle.any.{code}", text)]


def _floored(found: Detection | NotDetected, floor_px: float) -> Detection | NotDetected:
    if isinstance(found, NotDetected):
        return found
    return replace(found, sigma_px=np.hypot(found.sigma_px, floor_px))


def _ghost(calibration: Calibration, suggestion: Suggestion, sigma_um: FloatArray) -> Ghost:
    left, right = outlines_of(calibration.rig, suggestion.board, suggestion.left_from_board)
    return Ghost(left, right, sigma_um, suggestion.code, suggestion.where)


def outlines_of(rig: StereoRig, board: Board, left_from_board: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A board's outline (4, 2) in the left and in the right picture, px."""
    corners = apply(left_from_board, outline_mm(board))
    return rig.left.project(corners), rig.right.project(apply(rig.right_from_left, corners))
