"""Pose of the rig relative to the robot: solved and judged here, saved in a separate step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.domain.robotmap import RobotMap
from edged.errors import CalibrationError, UserError
from edged.files.rig import keep_old_rig, load_rig_quality, save_rig
from edged.robot.covariance import adjoint
from edged.robot.errormap import MapFit, error_map, fit_map
from edged.robot.golden import motion_of_points
from edged.robot.handeye import HandEye, Mount, hand_eye
from edged.robot.orientations import LENGTH_UNITS_MM, POSE_FORMATS
from edged.robot.readings import PoseFormat, rank_readings
from edged.robot.touch import PointRegistration, register_points
from edged.setup.documents import now_text
from edged.setup.pairs import Pair
from edged.vision.boards.board import NominalBoard, NotDetected, StereoView
from edged.vision.boards.detection import detect_board
from edged.vision.calibration.verification import pose_of_board
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, fit_rigid, skew

if TYPE_CHECKING:  # as in `files.marks`
    from edged.vision.marks.taught import TaughtMarks

MIN_COMMON = 6
"""Marks that two teachings must have in common: with fewer, a moved mark could not be identified."""
DECIDED = 3.0
"""A reading that fits this many times better than the next one is the right one."""


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredRig:
    """A registered rig, not saved yet. how : what the rig file records about how it was registered."""

    rig: StereoRig
    how: Mapping[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class FromPoints:
    """Registration from touched points.

    worst_mm : largest distance of a point from where the others predict it; where they cannot predict it, how
    far the distances between points disagree.  checked : there are such predictions.  good : within the
    limit. doubt : the robot's lengths differ from the rig's. trials : of a map of the robot's error, if one
    was asked for.
    """

    found: PointRegistration
    worst_mm: float
    checked: bool
    good: bool
    doubt: bool
    registered: RegisteredRig
    trials: tuple[MapFit, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FromPoses:
    """Registration from flange poses. held_out_rms_mm : of those that were used; good : within the limit."""

    found: HandEye
    held_out_rms_mm: float
    good: bool
    registered: RegisteredRig

    @property
    def worst(self) -> int | None:
        """Index of the worst rejected pose, or, if they disagree, of the one that agrees least; or None."""
        held, used = self.found.held_out_mm, self.found.used
        if self.good and used.all():
            return None
        among = np.where(used & (not used.all()), np.nan, held)
        return int(np.nanargmax(among)) if np.isfinite(among).any() else None


@dataclass(frozen=True, slots=True, eq=False)
class FromMarks:
    """Registration of a recalibrated rig from reference marks.

    covariance (6, 6) : as of a rig; NaN where the former one was not known. worst : code of the mark with the
    largest residual, worst_mm.  good : within the limit.
    """

    robot_from_rig: FloatArray
    covariance: FloatArray
    worst: int
    worst_mm: float
    rms_mm: float
    good: bool
    registered: RegisteredRig


@dataclass(frozen=True, slots=True)
class Readings:
    """Ways to read the poses, ranked by how well they fit.

    stands_out : the first one fits clearly better than the next. alike : how many fit these poses as well as
    the first. agrees : the stated reading is one of those; True when none was stated.
    """

    ranked: tuple[PoseFormat, ...]
    stands_out: bool
    alike: int
    agrees: bool


def from_points(
    rig: StereoRig, rig_mm: FloatArray, robot_mm: FloatArray, limit_mm: float, *, with_map: bool = False
) -> FromPoints:
    """Register from touched points, (N, 3) mm in both frames. Raises `CalibrationError`.

    Three points cannot predict each other: the distances between them must agree within the limit.
    with_map : also make a map of the robot's error, if it improves the fit; the limit then applies to points
    corrected by it.
    """
    found = register_points(rig_mm, robot_mm)
    checked = bool(np.isfinite(found.held_out_mm).any())
    worst_mm = float(np.nanmax(found.held_out_mm)) if checked else found.lengths_mm
    made: RobotMap | None = None
    trials: tuple[MapFit, ...] = ()
    if with_map:
        made, trials = fit_map(apply(found.robot_from_rig, rig_mm), robot_mm, found.held_out_mm)
        if made is not None:
            worst_mm = float(error_map(made).held_out_mm.max())
    doubt = abs(found.scale - 1) > max(3 * found.sigma_scale, 0.002) if len(rig_mm) > 3 else False
    registered = replace(rig, robot_from_rig=found.robot_from_rig, flange_from_rig=None, robot_map=made)
    how = {"how": "touched points", "points": len(rig_mm), "rms_mm": round(found.rms_mm, 4)}
    known = _known(registered, found.covariance, how)
    return FromPoints(found, worst_mm, checked, worst_mm <= limit_mm, doubt, known, trials)


def rig_from_board(rig: StereoRig, pair: Pair, board: NominalBoard) -> FloatArray | NotDetected:
    """Pose rig_from_board (4, 4) by one pair. Raises `UserError` for pictures of another size."""
    placed = pose_of_board(rig, view_of_board(rig, pair, board))
    return placed if isinstance(placed, NotDetected) else placed[1]


def view_of_board(rig: StereoRig, pair: Pair, board: NominalBoard) -> StereoView:
    """Detect the board in both pictures. Raises `UserError` for pictures of another size."""
    sides = []
    for side in SIDES:
        picture = pair.side(side)
        image = picture.read()
        camera = rig.camera(side)
        if image.shape != (camera.height, camera.width):
            raise UserError(f"{picture.label}: not of the size the rig was calibrated for")
        sides.append(detect_board(image, board))
    return StereoView(pair.name, board, sides[0], sides[1])


def from_poses(
    rig: StereoRig,
    robot_from_flange: Mapping[str, FloatArray],
    views: Mapping[str, FloatArray],
    board: NominalBoard,
    mount: Mount,
    limit_mm: float,
) -> FromPoses:
    """Register from flange poses and rig_from_board, by the same names. Raises `CalibrationError`."""
    transforms = [robot_from_flange[name] for name in views]
    found = hand_eye(transforms, list(views.values()), board.points_mm, mount)
    # a rejected pose says nothing about the registration, which does not use it
    held = found.held_out_mm[found.used & np.isfinite(found.held_out_mm)]
    rms_mm = float(np.sqrt(np.mean(held**2))) if len(held) else math.inf
    fixed = mount == "eye-to-hand"
    registered = replace(
        rig,
        robot_from_rig=found.rig if fixed else None,
        flange_from_rig=None if fixed else found.rig,
        robot_map=None,
    )
    how = {
        "how": f"hand-eye, {mount}",
        "poses": int(found.used.sum()),
        "rejected": [name for name, used in zip(views, found.used, strict=True) if not used],
        "held_out_rms_mm": round(rms_mm, 4),
    }
    return FromPoses(found, rms_mm, rms_mm <= limit_mm, _known(registered, found.covariance, how))


def from_marks(rig: StereoRig, taught: TaughtMarks, former: TaughtMarks, limit_mm: float) -> FromMarks:
    """Register a recalibrated rig by the reference marks that were taught with both calibrations.

    taught, former : the same plate, which did not move between both teachings. limit_mm : how far places may
    differ. Raises `CalibrationError`.
    """
    robot_from_former = former.rig.robot_from_rig
    if robot_from_former is None:
        raise CalibrationError("the former rig is not registered to a robot that does not carry it")
    common = [code for code in taught.codes if code in former.codes]
    if len(common) < MIN_COMMON:
        raise CalibrationError(f"{len(common)} marks are in both teachings, {MIN_COMMON} are needed")
    now, then = (
        marks.placed.places_mm[[marks.codes.index(code) for code in common]] for marks in (taught, former)
    )
    fit = fit_rigid(now, then)
    robot_from_rig = robot_from_former @ fit.to_from_source
    away = np.linalg.norm(fit.residuals_mm, axis=1)
    about = np.eye(6)  # the fit's covariance is of the shift of the rig's origin
    about[:3, 3:] = skew(fit.to_from_source[:3, 3])
    to_robot = adjoint(robot_from_former)
    covariance = to_robot @ about @ fit.covariance @ about.T @ to_robot.T
    for seen, frame, points in ((former.rig, robot_from_former, then), (rig, robot_from_rig, now)):
        if seen.covariance is not None:  # errors of each calibration move the marks as they move parts
            moved = adjoint(frame) @ motion_of_points(seen, points)
            covariance = covariance + moved @ seen.covariance @ moved.T
    known = former.rig.registration_covariance
    covariance = np.full((6, 6), np.nan) if known is None else covariance + known
    worst = int(np.argmax(away))
    how = {"how": "reference marks", "marks": len(common), "from": former.rig.calibration_id}
    registered = replace(rig, robot_from_rig=robot_from_rig, flange_from_rig=None, robot_map=None)
    return FromMarks(
        robot_from_rig,
        covariance,
        common[worst],
        float(away[worst]),
        float(np.sqrt(np.mean(away**2))),
        bool(away[worst] <= limit_mm),
        _known(registered, covariance, how),
    )


def which_convention(
    numbers: Sequence[Sequence[float]],
    views: Sequence[FloatArray],
    board: NominalBoard,
    stated: Sequence[FloatArray] | None = None,
) -> Readings:
    """Try every reading of the poses as the controller shows them. Raises `CalibrationError` when none fits.

    views : rig_from_board at each. stated : the poses by the reading that the user stated.
    """
    ranked = rank_readings(numbers, views, board.points_mm, POSE_FORMATS, LENGTH_UNITS_MM)
    best = ranked[0]
    agrees = True
    if stated is not None:
        rms_mm = min(
            hand_eye(stated, views, board.points_mm, mount).rms_mm for mount in ("eye-to-hand", "eye-in-hand")
        )
        agrees = rms_mm <= 1.01 * best.rms_mm + 1e-9
    return Readings(
        tuple(ranked),
        stands_out(ranked),
        sum(reading.rms_mm <= 1.0001 * best.rms_mm for reading in ranked),
        agrees,
    )


def stands_out(ranked: Sequence[PoseFormat]) -> bool:
    """Whether the first reading fits so much better than the next that it is the right one."""
    best_mm = ranked[0].rms_mm
    rival_mm = next((reading.rms_mm for reading in ranked[1:] if reading.rms_mm > 1.0001 * best_mm), math.inf)
    return rival_mm > DECIDED * best_mm


def in_words(reading: PoseFormat) -> str:
    """Sentence on how well the poses agree by a reading."""
    return (
        f"read as {reading.orientation}, lengths in {reading.length_unit}, {reading.mount}, the poses agree "
        f"within {reading.rms_mm:.3f} mm"
    )


def save(source: Path, registered: RegisteredRig, output: Path) -> Path | None:
    """Write the registered rig, and keep a copy of the former file beside it. Return the path of that copy.

    source : the rig file that was registered; its record of the calibration's quality is kept.
    """
    when = now_text()
    quality = {**load_rig_quality(source), "registration": {**registered.how, "when": when}}
    kept = keep_old_rig(output)
    save_rig(output, registered.rig, quality)
    return kept


def _known(rig: StereoRig, covariance: FloatArray, how: Mapping[str, object]) -> RegisteredRig:
    known = covariance if np.isfinite(covariance).all() else None
    return RegisteredRig(replace(rig, registration_covariance=known), how)
