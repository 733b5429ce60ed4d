"""Verdict on a calibration: whether it is good enough, why, and which pictures to add."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain.arrays import SIDES
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.coverage import coverage_in_words, coverage_of
from edged.vision.calibration.crossvalidation import HeldOutView
from edged.vision.calibration.imaging import Imaging
from edged.vision.calibration.nextbestview import best_next_view, volume_points
from edged.vision.calibration.params import GUIDANCE, IMAGING
from edged.vision.geometry.triangulation import raw_covariance
from edged.vision.geometry.uncertainty import calibration_covariance

Grade = Literal["good", "usable", "repeat"]


@dataclass(frozen=True, slots=True)
class CalibrationVerdict:
    """Grade and reasons in words.  add : the most useful further view; "" if none is worth it."""

    grade: Grade
    why: tuple[str, ...]
    add: str

    def __str__(self) -> str:
        add = f"; to add: {self.add}" if self.add else ""
        return f"verdict: {self.grade}: {'; '.join(self.why)}{add}"


def judge_calibration(
    calibration: Calibration, held: Sequence[HeldOutView], imaging: Sequence[Imaging] = ()
) -> CalibrationVerdict:
    """Grade a calibration by its held-out views, its covariance and the quality of the pictures.

    imaging : of the left and the right camera, if known.
    """
    suggestion = best_next_view(calibration)
    add = ""
    if suggestion is not None and suggestion.gain >= GUIDANCE.worth_adding:
        add = f"{suggestion.where} ({100 * suggestion.gain:.0f} % smaller error)"
    findings = [*_findings(calibration, held), *_picture_findings(imaging)]
    for grade in ("repeat", "usable"):
        if why := tuple(text for found, text in findings if found == grade):
            return CalibrationVerdict(grade, why, add)
    return CalibrationVerdict("good", tuple(text for _, text in findings), "")


def _findings(calibration: Calibration, held: Sequence[HeldOutView]) -> list[tuple[Grade, str]]:
    views = len(calibration.views)
    findings = [(_grade(-views, -GUIDANCE.good_views, -GUIDANCE.min_views), f"{views} views")]
    # if a camera moved after these views, the rig is out of date
    findings += [
        ("repeat" if movement.since else "usable", str(movement)) for movement in calibration.movements
    ]
    if not held:
        return [("repeat", f"{views} views are too few to hold any of them out"), *findings]
    epipolar_px = _rms([view.epipolar_rms_px for view in held])
    findings.append(
        (
            _grade(epipolar_px, GUIDANCE.good_epipolar_px, GUIDANCE.worst_epipolar_px),
            f"epipolar rms of held-out views {epipolar_px:.3f} px",
        )
    )
    overfit = _rms([view.reprojection_rms_px for view in held]) / max(calibration.rms_px, 1e-6)
    if overfit > GUIDANCE.good_overfit:
        text = f"residuals of held-out views {overfit:.1f}× those of fitted ones"
        findings.append((_grade(overfit, GUIDANCE.good_overfit, GUIDANCE.worst_overfit), text))
    size_percent = 100 * abs(float(np.mean([view.scale for view in held])) - 1)
    findings.append(
        (
            _grade(size_percent, GUIDANCE.good_size_percent, GUIDANCE.worst_size_percent),
            f"their board size error {size_percent:.3f} %",
        )
    )
    coverage = [coverage_of(calibration, side) for side in SIDES]
    least = min(image.share for image in coverage)
    findings.append(
        (_grade(-least, -GUIDANCE.good_coverage, -GUIDANCE.worst_coverage), coverage_in_words(coverage))
    )
    points = volume_points(calibration)
    if calibration.rig.covariance is not None and len(points):
        ours = np.sqrt(np.mean(calibration_covariance(calibration.rig, points)[:, 2, 2]))
        noise = np.sqrt(np.mean(raw_covariance(calibration.rig, points, IMAGING.noise_px)[:, 2, 2]))
        text = f"its depth uncertainty {1000 * ours:.0f} µm, single-edge noise {1000 * noise:.0f} µm"
        findings.append((_grade(float(ours / noise), GUIDANCE.good_share, GUIDANCE.worst_share), text))
    return findings


def _picture_findings(imaging: Sequence[Imaging]) -> list[tuple[Grade, str]]:
    """Findings on image processing by the cameras, which hardly displaces marks, but does displace edges."""
    found = list[tuple[Grade, str]]()
    for side, camera in zip(SIDES, imaging, strict=False):
        if camera.halo > IMAGING.max_halo:
            found.append(("usable", f"the {side} camera sharpens: switch it off"))
        if camera.saturated > IMAGING.much_saturated:
            found.append(("usable", f"whites of the {side} camera are clipped: less exposure"))
    return found


def _grade(value: float, good: float, worst: float) -> Grade:
    if not value <= worst:  # also for NaN
        return "repeat"
    return "good" if value <= good else "usable"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
