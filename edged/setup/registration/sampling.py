"""A registration sample by sample, as a robot's program makes it: which samples are taken, and the verdict.

Nothing is saved here. Each sample is judged at once, while the robot still stands there: a pose that adds
nothing new, or a board that is not seen well, is not taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.domain.measurement import Outcome, Reject
from edged.domain.registration import UNKNOWN_6, Method, Obstacle, Registration
from edged.errors import CalibrationError, Undetermined
from edged.robot.handeye import Mount
from edged.setup.pairs import Pair
from edged.setup.registration.registering import (
    DECIDED,
    FromPoints,
    FromPoses,
    RegisteredRig,
    from_points,
    from_poses,
    in_words,
    view_of_board,
    which_convention,
)
from edged.vision.boards.board import NominalBoard, NotDetected, StereoView
from edged.vision.calibration.verification import BoardCheck, check_board, pose_of_board
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, rotation_vector, skew

LEAST_POSES, LEAST_POINTS = 6, 4
"""Fewest samples: the others must determine a fit when one is held out; hand-eye has twelve unknowns."""
SAME_MM, SAME_DEG = 1.0, 1.0
"""Poses of the flange that differ by less than both are duplicates."""
SAME_POINT_MM = 5.0
TRIED = 8
"""Poses that are read in every way: enough to decide, and each further one makes the robot wait longer."""
MAX_BLUR_PX = 3.0
"""Wider edges mean that the picture is out of focus or the board was moving."""
MAX_RMS_PX = 1.0
"""Limit on the rms reprojection and epipolar errors; beyond it the board moved or is another one."""


@dataclass(frozen=True, slots=True)
class Step:
    """Result of a command. why : a message for people, present on success too."""

    registration: Registration
    obstacle: Obstacle | None = None
    why: str = ""
    registered: RegisteredRig | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoard:
    """A board in both pictures, numbered alike, sharp and consistent with the rig. rig_from_board (4, 4)."""

    view: StereoView
    rig_from_board: FloatArray
    check: BoardCheck

    @property
    def worst_px(self) -> float:
        """The larger of the epipolar and reprojection rms."""
        return max(self.check.epipolar_rms_px, self.check.reprojection_rms_px)


def see_board(rig: StereoRig, pair: Pair, board: NominalBoard) -> SeenBoard | NotDetected:
    """Find a board, as strictly as a registration needs it. Raises `UserError`: pictures of another size."""
    placed = pose_of_board(rig, view_of_board(rig, pair, board))
    if isinstance(placed, NotDetected):
        return placed
    view, rig_from_board = placed
    blur_px = max(view.found(side).blur_px for side in SIDES)
    seen = SeenBoard(view, rig_from_board, check_board(rig, view, rig_from_board))
    if blur_px > MAX_BLUR_PX:
        return NotDetected(f"not sharp: edges of {blur_px:.1f} px")
    if seen.worst_px > MAX_RMS_PX:
        return NotDetected(
            f"the marks miss the board by {seen.worst_px:.2f} px: it moved, its length is another one, or "
            "the calibration does not hold"
        )
    return seen


@dataclass(slots=True, eq=False)
class RegistrationSampling:
    """One registration under way.

    board : for HAND_EYE only. poses : of the flange, or of the tip that touched. views : rig_from_board of
    each, or the part's position in the rig's frame. shown : the poses as the robot sent them, () where not
    known.
    """

    rig: StereoRig
    method: Method
    mount: Mount
    board: NominalBoard | None
    limit_mm: float
    poses: list[FloatArray] = field(default_factory=list)
    views: list[FloatArray] = field(default_factory=list)
    shown: list[tuple[float, ...]] = field(default_factory=list)

    @property
    def state(self) -> Registration:
        """State of the registration before it is solved."""
        return Registration(self.method, len(self.poses), limit_mm=self.limit_mm)

    def add_board(self, pair: Pair, robot_from_flange: FloatArray, shown: tuple[float, ...]) -> Step:
        """Add a flange pose with pictures of the board. Raises `UserError` for pictures of another size."""
        assert self.board is not None
        if same := self._same(robot_from_flange):
            return Step(self.state, Obstacle.SAME_PLACE, same)
        seen = see_board(self.rig, pair, self.board)
        if isinstance(seen, NotDetected):
            return Step(self.state, Obstacle.NOT_SEEN, seen.reason)
        self._take(robot_from_flange, seen.rig_from_board, shown)
        words = f"pose {len(self.poses)}: {seen.check.marks} marks, {seen.worst_px:.2f} px rms"
        return Step(self.state, None, words)

    def add_part(self, outcome: Outcome, robot_from_tip: FloatArray, shown: tuple[float, ...]) -> Step:
        """Add a point that the tip touched, with the part that was found there."""
        places = [pose[:3, 3] for pose in self.poses]
        for number, place in enumerate(places, 1):
            if np.linalg.norm(place - robot_from_tip[:3, 3]) < SAME_POINT_MM:
                return Step(self.state, Obstacle.SAME_PLACE, f"near point {number}")
        good = [target for target in outcome.targets if target.reject == Reject.NONE]
        if len(good) != 1:
            what = "several parts: which one was touched?" if good else "no good part"
            return Step(self.state, Obstacle.NOT_SEEN, what)
        self._take(robot_from_tip, good[0].rig_from_part[:3, 3], shown)
        return Step(self.state, None, f"point {len(self.poses)}: the part is found")

    def solve(self) -> Step:
        """Solve and judge; `registered` is set only if the result is good."""
        least = LEAST_POINTS if self.method is Method.TOUCH else LEAST_POSES
        if len(self.poses) < least:
            return Step(self.state, Obstacle.TOO_FEW, f"{len(self.poses)}, at least {least} are needed")
        try:
            return self._solve_points() if self.method is Method.TOUCH else self._solve_poses()
        except Undetermined as error:
            return Step(self.state, Obstacle.TURN_MORE, str(error))
        except np.linalg.LinAlgError as error:
            return Step(self.state, Obstacle.TURN_MORE, f"nothing can be solved: {error}")
        except CalibrationError as error:
            return Step(self.state, Obstacle.NOT_GOOD, str(error))

    def _take(self, pose: FloatArray, view: FloatArray, shown: tuple[float, ...]) -> None:
        self.poses.append(pose)
        self.views.append(view)
        self.shown.append(shown)

    def _same(self, pose: FloatArray) -> str:
        for number, other in enumerate(self.poses, 1):
            shift_mm = float(np.linalg.norm(other[:3, 3] - pose[:3, 3]))
            turn_deg = math.degrees(float(np.linalg.norm(rotation_vector(other[:3, :3].T @ pose[:3, :3]))))
            if shift_mm < SAME_MM and turn_deg < SAME_DEG:
                return f"the flange is where it was at pose {number}"
        return ""

    # --- by touched points -----------------------------------------------------------------------

    def _solve_points(self) -> Step:
        robot_mm = np.array([pose[:3, 3] for pose in self.poses])
        solved = from_points(self.rig, np.array(self.views), robot_mm, self.limit_mm)
        found = solved.found
        worst = 0 if found.culprit is None else found.culprit + 1
        if not solved.good and not worst:
            worst = 1 + int(np.nanargmax(found.held_out_mm))
        held_out = found.held_out_mm[np.isfinite(found.held_out_mm)]
        state = Registration(
            self.method,
            len(self.poses),
            len(self.poses),
            worst,
            found.rms_mm,
            float(np.sqrt(np.mean(held_out**2))) if len(held_out) else math.nan,
            self.limit_mm,
            sigma_at(found.covariance, robot_mm.mean(axis=0)),
        )
        return self._judged(state, solved, _words_of_points(solved))

    # --- by poses and a board ------------------------------------------------------------------

    def _solve_poses(self) -> Step:
        assert self.board is not None
        names = [str(number) for number in range(1, len(self.poses) + 1)]
        transforms, views = (dict(zip(names, of, strict=True)) for of in (self.poses, self.views))
        solved = from_poses(self.rig, transforms, views, self.board, self.mount, self.limit_mm)
        found, middle = solved.found, self.board.points_mm.mean(axis=0)
        places = np.array([apply(found.rig @ view, middle[None])[0] for view in self.views])
        state = Registration(
            self.method,
            len(self.poses),
            int(found.used.sum()),
            0 if solved.worst is None else solved.worst + 1,
            found.rms_mm,
            solved.held_out_rms_mm,
            self.limit_mm,
            sigma_at(found.covariance, places.mean(axis=0)),
        )
        if not solved.good and (reading := self._other_reading(solved)):
            return Step(state, Obstacle.OTHER_READING, reading)
        return self._judged(state, solved, f"held out {solved.held_out_rms_mm:.3f} mm")

    def _other_reading(self, solved: FromPoses) -> str:
        """Another reading of the numbers that fits so much better that it must be right, in words, or ""."""
        assert self.board is not None
        if not all(self.shown):
            return ""
        some = np.linspace(0, len(self.shown) - 1, min(len(self.shown), TRIED)).round().astype(int)
        shown, views = ([of[k] for k in some] for of in (self.shown, self.views))
        try:
            readings = which_convention(shown, views, self.board)
        except CalibrationError:
            return ""
        best = readings.ranked[0]
        if not readings.stands_out or DECIDED * best.rms_mm > solved.found.rms_mm:
            return ""
        return f"{in_words(best)}; as configured within {solved.found.rms_mm:.3f} mm"

    def _judged(self, state: Registration, solved: FromPoints | FromPoses, words: str) -> Step:
        doubts = isinstance(solved, FromPoints) and solved.doubt
        if solved.good and not doubts:
            return Step(state, None, f"{state.used} of {state.samples} agree: {words}", solved.registered)
        worst = f"; number {state.worst} agrees least" if state.worst else ""
        return Step(state, Obstacle.NOT_GOOD, f"{words}, the limit is {self.limit_mm:g} mm{worst}")


def _words_of_points(solved: FromPoints) -> str:
    scale = f"; the robot's lengths are {solved.found.scale:.4f} of the rig's" if solved.doubt else ""
    return f"held out {solved.worst_mm:.3f} mm at most{scale}"


def sigma_at(covariance: FloatArray, place_mm: FloatArray) -> tuple[float, ...]:
    """One sigma of X, Y, Z (mm) of a point place_mm (3,), and of the rotation (degrees).

    covariance (6, 6) : of a small motion about the frame's origin.
    """
    if not np.isfinite(covariance).all():
        return UNKNOWN_6
    arm = np.concatenate([np.eye(3), -skew(place_mm)], axis=1)
    mm = np.sqrt(np.maximum(np.diag(arm @ covariance @ arm.T), 0.0))
    degrees = np.degrees(np.sqrt(np.maximum(np.diag(covariance)[3:], 0.0)))
    return (*mm.tolist(), *degrees.tolist())
