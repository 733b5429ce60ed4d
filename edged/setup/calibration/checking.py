"""Checks whether a calibration still holds, by one fresh pair of a board or of a part of known size."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.cell.drift import DRIFT_REJECTS
from edged.domain.arrays import SIDES, FloatArray, Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Circle3D, Target
from edged.errors import UserError
from edged.pipeline import locate, prepare
from edged.vision.boards.board import NominalBoard, NotDetected, StereoView
from edged.vision.boards.detection import detect_board, remeasure_board
from edged.vision.calibration.imaging import Imaging, edges_of, findings, imaging_of
from edged.vision.calibration.imaging import ImagingFinding as Remark
from edged.vision.calibration.verification import BoardCheck, Length, Verdict, check_board, pose_of_board
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import linear_pair
from edged.vision.geometry.rigid import apply
from edged.vision.part.consistency import without_doubt
from edged.vision.part.job import Job

MAX_OFFERED = 12
"""Most lengths of a part that are offered for a check."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a good rig: epipolar rms in px, length errors in percent."""

    epipolar_px: float
    length_percent: float


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of checking a rig with one pair. reason : why there are no figures, or empty.

    cameras : findings on response, blur and light from the board's edges.
    """

    verdict: Verdict
    epipolar_rms_px: float
    lengths: tuple[Length, ...]
    reason: str = ""
    board: BoardCheck | None = None
    cameras: tuple[Remark, ...] = ()


def by_board(
    rig: StereoRig, images: tuple[Image, Image], boards: Sequence[NominalBoard], limits: Limits
) -> Finding:
    """Check the rig with one pair of any of the boards.

    Raises `ImageError` for images that the rig was not calibrated for.
    """
    linear = linear_pair(rig, *images)
    reason = ""
    for board in boards:
        view = StereoView("verify", board, *(detect_board(image, board) for image in images))
        placed = pose_of_board(rig, view)
        if not isinstance(placed, NotDetected):
            # marks are measured again with lens and pose known, as for the calibration
            view, pose = placed
            left = remeasure_board(images[0], board, view.found("left"), rig.left, pose)
            right_pose = rig.right_from_left @ pose
            right = remeasure_board(images[1], board, view.found("right"), rig.right, right_pose)
            placed = pose_of_board(rig, StereoView("verify", board, left, right))
        if isinstance(placed, NotDetected):
            reason = reason or placed.reason
            continue
        check = check_board(rig, *placed)
        found = _judged(check.epipolar_rms_px, (check.size,), limits, check)
        return replace(found, cameras=_cameras(rig, linear, *placed))
    return Finding("UNDECIDED", math.nan, (), reason)


def _cameras(
    rig: StereoRig, linear: tuple[Image, Image], view: StereoView, left_from_board: FloatArray
) -> tuple[Remark, ...]:
    """Findings on the cameras from the board's edges. linear : images corrected for the known response."""
    sides: list[Imaging] = []
    for side, image in zip(SIDES, linear, strict=True):
        camera = rig.camera(side)
        edges = edges_of(image, view.board, view.found(side))
        sides.append(imaging_of([] if edges is None else [edges], (camera.width, camera.height)))
    depth_mm = float(apply(left_from_board, view.board.points_mm)[:, 2].mean())
    return findings((sides[0], sides[1]), rig, depth_mm)


def by_part(
    rig: StereoRig, images: tuple[Image, Image], job: Job, known: Mapping[str, float], limits: Limits
) -> Finding:
    """Check the rig with one pair of a taught part.

    known : true lengths, mm, by the name of a measurement of the job, of a circle (its diameter), or of two
    circles as A-B (the distance of their centres). Raises `UserError` for another name.
    """
    outcome = locate(FramePair.of_images(*images), job, prepare(rig))
    measured = [target for target in outcome.targets if not target.reject & ~DRIFT_REJECTS]
    if not measured:
        return Finding("UNDECIDED", math.nan, (), f"the part was not measured: {outcome.status}")
    target = without_doubt(measured[0], rig.baseline_mm)
    lengths = tuple(length_of(target, name, true_mm) for name, true_mm in known.items())
    return _judged(target.epipolar_rms_px, lengths, limits, None)


def offered_lengths(job: Job) -> list[tuple[str, float | None]]:
    """Lengths of a job that `by_part` can check, with their size as taught, mm, where that is known.

    Taught lengths are sorted longest first, as these show scale errors best; only the first ones are offered.
    """
    sizes: list[tuple[str, float | None]] = [
        (spec.name, spec.nominal)
        for spec in job.measurements
        if spec.kind not in ("angle", "flatness", "radius")  # a circle is asked for by its diameter
    ]
    taught = [(circle.name, 2 * circle.radius_mm) for circle in job.circles]
    for first, second in itertools.combinations(job.circles, 2):
        distance_mm = float(np.linalg.norm(second.centre_mm - first.centre_mm))
        taught.append((f"{first.name}-{second.name}", distance_mm))
    taught.sort(key=lambda length: -length[1])
    return [*sizes, *taught][:MAX_OFFERED]


def _judged(
    epipolar_px: float, lengths: tuple[Length, ...], limits: Limits, board: BoardCheck | None
) -> Finding:
    verdicts = {length.verdict(limits.length_percent) for length in lengths}
    if not epipolar_px <= limits.epipolar_px or "NOT_OK" in verdicts:
        return Finding("NOT_OK", epipolar_px, lengths, "", board)
    return Finding("UNDECIDED" if "UNDECIDED" in verdicts else "OK", epipolar_px, lengths, "", board)


def length_of(target: Target, name: str, true_mm: float) -> Length:
    """Measured length of a name: a measurement of the job, a circle's diameter, or two centres' distance."""
    circles = {circle.name: circle for circle in target.circles}
    for measurement in target.measurements:
        if measurement.name == name and measurement.unit == "mm":
            return Length(name, true_mm, measurement.value, measurement.sigma)
    if name in circles:
        circle = circles[name]
        return Length(name, true_mm, 2 * circle.radius_mm, 2 * circle.sigma_radius_mm)
    for cut in (i for i, letter in enumerate(name) if letter == "-"):
        pair = circles.get(name[:cut]), circles.get(name[cut + 1 :])
        if pair[0] is not None and pair[1] is not None:
            return _distance(name, true_mm, pair[0], pair[1])
    known = [*circles, *(m.name for m in target.measurements if m.unit == "mm")]
    raise UserError(
        f"length {name}: the job has {', '.join(known) or 'no circle'}; expected one of them (a circle "
        "stands for its diameter) or two circles as A-B (distance of their centres)"
    )


def _distance(name: str, true_mm: float, first: Circle3D, second: Circle3D) -> Length:
    between = second.centre_mm - first.centre_mm
    distance = float(np.linalg.norm(between))
    direction = between / max(distance, 1e-9)
    covariance = first.covariance[:3, :3] + second.covariance[:3, :3]
    return Length(name, true_mm, distance, float(np.sqrt(direction @ covariance @ direction)))
