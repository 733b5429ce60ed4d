"""`edged verify`: does the stored rig still hold? One fresh pair of a board, or of a part of known size."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from edged.domain import SIDES, Circle3D, FloatArray, Frame, FramePair, Image, Target
from edged.drift import TELLING
from edged.errors import ImageError, UserError
from edged.files.images import load_image
from edged.files.jobs import load_job
from edged.files.rig import load_rig
from edged.pipeline import locate, prepare
from edged.vision.boards.board import NotDetected, StereoView, parse_boards
from edged.vision.boards.detection import detect_board, remeasure_board
from edged.vision.calibration.imaging import Finding as Remark
from edged.vision.calibration.imaging import Imaging, edges_of, findings, imaging_of
from edged.vision.calibration.verification import (
    COVERAGE,
    BoardCheck,
    Length,
    Verdict,
    check_board,
    pose_of_board,
)
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.stereoimages import linear_image
from edged.vision.part.consistency import undoubted

_WARNING = (
    "Rows alone do not see a wrong baseline or focal length: those scale the world and leave every point on "
    "its row. The length does."
)


@dataclass(frozen=True, slots=True)
class Limits:
    """What is still good: epipolar rms in px, length errors in percent."""

    epipolar_px: float
    length_percent: float


@dataclass(frozen=True, slots=True)
class Finding:
    """What a pair says of a rig. reason : why there are no figures, or empty.

    cameras : what the board's edges say of response, blur and light.
    """

    verdict: Verdict
    epipolar_rms_px: float
    lengths: tuple[Length, ...]
    reason: str = ""
    board: BoardCheck | None = None
    cameras: tuple[Remark, ...] = ()


def verify(
    rig_path: Path,
    left: Path,
    right: Path,
    board: str | None,
    job: Path | None,
    lengths: list[str],
    limits: Limits,
    as_json: bool,
    console: Console,
) -> int:
    """Print the verdict; 0 if the rig holds, 1 if it does not or that cannot be said."""
    if not (math.isfinite(limits.epipolar_px) and math.isfinite(limits.length_percent)):
        raise UserError("--max-epipolar and --max-length-error: expected finite numbers")
    rig = load_rig(rig_path)
    images = _fitting(left, rig, "left"), _fitting(right, rig, "right")
    if board is not None and job is None:
        if lengths:
            raise UserError("--length belongs to --job; the length of a board is in its specification")
        finding = _by_board(rig, images, board, limits)
    elif job is not None and board is None:
        if not lengths:
            raise UserError(f"--job needs --length NAME=MM. {_WARNING}")
        finding = _by_part(rig, images, job, dict(map(_parse_length, lengths)), limits)
    else:
        raise UserError("state either --board SPEC or --job DIR, whichever the images show")
    if as_json:
        print(json.dumps(_to_json(finding, rig, limits)))
    else:
        _print(finding, rig, limits, console)
    return 0 if finding.verdict == "OK" else 1


def _fitting(path: Path, rig: StereoRig, side: str) -> Image:
    image = load_image(path)
    camera = rig.left if side == "left" else rig.right
    if image.shape != (camera.height, camera.width):
        raise ImageError(
            f"{path}: {image.shape[1]} x {image.shape[0]}, the rig's {side} camera was calibrated for "
            f"{camera.width} x {camera.height}"
        )
    return image


def _by_board(rig: StereoRig, images: tuple[Image, Image], spec: str, limits: Limits) -> Finding:
    reason = ""
    for board in parse_boards(spec):
        view = StereoView("verify", board, *(detect_board(image, board) for image in images))
        placed = pose_of_board(rig, view)
        if not isinstance(placed, NotDetected):
            # measured again with lens and pose known, as for the calibration
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
        return replace(found, cameras=_cameras(rig, images, *placed))
    return Finding("UNDECIDED", math.nan, (), reason)


def _cameras(
    rig: StereoRig, images: tuple[Image, Image], view: StereoView, left_from_board: FloatArray
) -> tuple[Remark, ...]:
    """What the board's edges say of the cameras, the response that the rig knows of taken out."""
    sides: list[Imaging] = []
    for side, image in zip(SIDES, images, strict=True):
        camera = rig.left if side == "left" else rig.right
        edges = edges_of(linear_image(image, camera.gamma), view.board, view.found(side))
        sides.append(imaging_of([] if edges is None else [edges], (camera.width, camera.height)))
    depth_mm = float(apply(left_from_board, view.board.points_mm)[:, 2].mean())
    return findings((sides[0], sides[1]), rig, depth_mm)


def _by_part(
    rig: StereoRig, images: tuple[Image, Image], job_path: Path, known: dict[str, float], limits: Limits
) -> Finding:
    pair = FramePair(Frame("left", 0, images[0], 0, 0), Frame("right", 0, images[1], 0, 0))
    outcome = locate(pair, load_job(job_path), prepare(rig))
    measured = [target for target in outcome.targets if not target.reject & ~TELLING]
    if not measured:
        return Finding("UNDECIDED", math.nan, (), f"the part was not measured: {outcome.status}")
    target = undoubted(measured[0], rig.baseline_mm)
    lengths = tuple(_length_of(target, name, true_mm) for name, true_mm in known.items())
    return _judged(target.epipolar_rms_px, lengths, limits, None)


def _judged(
    epipolar_px: float, lengths: tuple[Length, ...], limits: Limits, board: BoardCheck | None
) -> Finding:
    verdicts = {length.verdict(limits.length_percent) for length in lengths}
    if not epipolar_px <= limits.epipolar_px or "NOT_OK" in verdicts:
        return Finding("NOT_OK", epipolar_px, lengths, "", board)
    return Finding("UNDECIDED" if "UNDECIDED" in verdicts else "OK", epipolar_px, lengths, "", board)


# --- lengths of parts ---------------------------------------------------------------------------


def _parse_length(text: str) -> tuple[str, float]:
    name, equals, value = text.rpartition("=")
    try:
        millimetres = float(value)
    except ValueError:
        millimetres = math.nan
    if not (equals and name and 0.001 <= millimetres <= 100_000):
        raise UserError(f"--length {text!r}: expected NAME=MM, e.g. c0=40.0 or c0-c1=60.0")
    return name, millimetres


def _length_of(target: Target, name: str, true_mm: float) -> Length:
    """A measurement of the job, a circle's diameter, or the distance of two circles' centres."""
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
        f"--length {name}: the job has {', '.join(known) or 'no circle'}; expected one of them (a circle "
        "stands for its diameter) or two circles as A-B (distance of their centres)"
    )


def _distance(name: str, true_mm: float, first: Circle3D, second: Circle3D) -> Length:
    between = second.centre_mm - first.centre_mm
    distance = float(np.linalg.norm(between))
    direction = between / max(distance, 1e-9)
    covariance = first.covariance[:3, :3] + second.covariance[:3, :3]
    return Length(name, true_mm, distance, float(np.sqrt(direction @ covariance @ direction)))


# --- output -------------------------------------------------------------------------------------


def _to_json(finding: Finding, rig: StereoRig, limits: Limits) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "verdict": finding.verdict,
        "calibration": rig.calibration_id,
        "reason": finding.reason,
        "epipolar_rms_px": number(finding.epipolar_rms_px),
        "max_epipolar_px": limits.epipolar_px,
        "max_length_error_percent": limits.length_percent,
        "lengths": [
            {
                "name": length.name,
                "true_mm": length.true_mm,
                "measured_mm": number(length.measured_mm),
                "sigma_mm": number(length.sigma_mm),
                "error_mm": number(length.error_mm),
                "error_percent": number(length.error_percent),
                "verdict": length.verdict(limits.length_percent),
            }
            for length in finding.lengths
        ],
        "cameras": [asdict(remark) for remark in finding.cameras],
        "board": None
        if finding.board is None
        else {name: value for name, value in asdict(finding.board).items() if name != "size"},
    }


def _print(finding: Finding, rig: StereoRig, limits: Limits, console: Console) -> None:
    colour = {"OK": "green", "NOT_OK": "red", "UNDECIDED": "yellow"}[finding.verdict]
    console.print(f"[{colour}]{finding.verdict}[/] {escape(rig.calibration_id)} {escape(finding.reason)}")
    if finding.reason:
        return
    table = Table("", "measured", "limit", "", box=None)
    good = "ok" if finding.epipolar_rms_px <= limits.epipolar_px else "too large"
    table.add_row("epipolar rms", f"{finding.epipolar_rms_px:.3f} px", f"{limits.epipolar_px:g} px", good)
    for length in finding.lengths:
        verdict = length.verdict(limits.length_percent)
        sigma_percent = COVERAGE * 100 * length.sigma_mm / length.true_mm
        words = {
            "OK": "ok",
            "NOT_OK": "too large",
            "UNDECIDED": f"length uncertainty of this view ±{sigma_percent:.2g} % only",
        }
        table.add_row(
            f"{escape(length.name)}, true {length.true_mm:.4g} mm",
            f"{length.error_mm:+.4f} mm ({length.error_percent:+.3f} ± {sigma_percent:.3f} %)",
            f"{limits.length_percent:g} %",
            words[verdict],
        )
    console.print(table)
    for remark in finding.cameras:
        if remark.remedy:
            console.print(f"[yellow]note[/] {escape(remark.text)}", soft_wrap=True)
    console.print(_WARNING, soft_wrap=True)
