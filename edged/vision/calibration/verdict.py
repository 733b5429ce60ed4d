"""Is a calibration good enough? One word, why, and what to add: for whoever has just taken the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain.arrays import SIDES
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.coverage import coverage_in_words, coverage_of
from edged.vision.calibration.crossvalidation import HeldOutView
from edged.vision.calibration.imaging import MAX_HALO, MUCH_SATURATED, NOISE_PX, Imaging
from edged.vision.calibration.nextbestview import best_next_view, volume_points
from edged.vision.geometry.triangulation import raw_covariance
from edged.vision.geometry.uncertainty import calibration_covariance

Grade = Literal["good", "usable", "repeat"]

GOOD_VIEWS, LEAST_VIEWS = 12, 6
GOOD_EPIPOLAR_PX, WORST_EPIPOLAR_PX = 0.1, 0.3
"""Held out. A tenth of a pixel is what edges scatter by; the other is `edged verify`'s limit."""
GOOD_SIZE_PERCENT, WORST_SIZE_PERCENT = 0.03, 0.1
"""Deviation of the measured from the true size of held-out boards; the other is `edged verify`'s limit."""
GOOD_OVERFIT, WORST_OVERFIT = 1.5, 3.0
"""Error of held-out views over that of fitted ones: more says that the views do not determine the lenses."""
GOOD_SHARE, WORST_SHARE = 1.0, 3.0
"""The calibration's part in the error of a point over that of one picture's noise."""
GOOD_COVERAGE, WORST_COVERAGE = 0.7, 0.4
"""Share of the common view that marks reached, in the worse image: elsewhere the lens is extrapolated."""
WORTH_ADDING = 0.05
"""A view that lowers the calibration's part in the error by less is not worth a picture."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """grade, and why in words.  add : the view that would help most; "" where none is worth it."""

    grade: Grade
    why: tuple[str, ...]
    add: str

    def __str__(self) -> str:
        add = f"; to add: {self.add}" if self.add else ""
        return f"verdict: {self.grade}: {'; '.join(self.why)}{add}"


def judge_calibration(
    calibration: Calibration, held: Sequence[HeldOutView], imaging: Sequence[Imaging] = ()
) -> Verdict:
    """By what views tell that were not used for their own result, by the covariance, and by the pictures.

    imaging : of the left and of the right camera, where it is known.
    """
    suggestion = best_next_view(calibration)
    add = ""
    if suggestion is not None and suggestion.gain >= WORTH_ADDING:
        add = f"{suggestion.where} ({100 * suggestion.gain:.0f} % smaller error)"
    findings = [*_findings(calibration, held), *_picture_findings(imaging)]
    for grade in ("repeat", "usable"):
        if why := tuple(text for found, text in findings if found == grade):
            return Verdict(grade, why, add)
    return Verdict("good", tuple(text for _, text in findings), "")


def _findings(calibration: Calibration, held: Sequence[HeldOutView]) -> list[tuple[Grade, str]]:
    views = len(calibration.views)
    findings = [(_grade(-views, -GOOD_VIEWS, -LEAST_VIEWS), f"{views} views")]
    # cameras that were moved afterwards do not stand as the rig says
    findings += [("repeat" if one.since else "usable", str(one)) for one in calibration.movements]
    if not held:
        return [("repeat", f"{views} views are too few to hold any of them out"), *findings]
    epipolar_px = _rms([view.epipolar_rms_px for view in held])
    findings.append(
        (
            _grade(epipolar_px, GOOD_EPIPOLAR_PX, WORST_EPIPOLAR_PX),
            f"epipolar rms of held-out views {epipolar_px:.3f} px",
        )
    )
    overfit = _rms([view.reprojection_rms_px for view in held]) / max(calibration.rms_px, 1e-6)
    if overfit > GOOD_OVERFIT:
        text = f"residuals of held-out views {overfit:.1f}× those of fitted ones"
        findings.append((_grade(overfit, GOOD_OVERFIT, WORST_OVERFIT), text))
    size_percent = 100 * abs(float(np.mean([view.scale for view in held])) - 1)
    findings.append(
        (
            _grade(size_percent, GOOD_SIZE_PERCENT, WORST_SIZE_PERCENT),
            f"their board size error {size_percent:.3f} %",
        )
    )
    coverage = [coverage_of(calibration, side) for side in SIDES]
    least = min(one.share for one in coverage)
    findings.append((_grade(-least, -GOOD_COVERAGE, -WORST_COVERAGE), coverage_in_words(coverage)))
    points = volume_points(calibration)
    if calibration.rig.covariance is not None and len(points):
        ours = np.sqrt(np.mean(calibration_covariance(calibration.rig, points)[:, 2, 2]))
        noise = np.sqrt(np.mean(raw_covariance(calibration.rig, points, NOISE_PX)[:, 2, 2]))
        text = f"its depth uncertainty {1000 * ours:.0f} µm, single-edge noise {1000 * noise:.0f} µm"
        findings.append((_grade(float(ours / noise), GOOD_SHARE, WORST_SHARE), text))
    return findings


def _picture_findings(imaging: Sequence[Imaging]) -> list[tuple[Grade, str]]:
    """Of cameras that change what they see: places of marks are still right, those of edges are less so."""
    found = list[tuple[Grade, str]]()
    for side, camera in zip(SIDES, imaging, strict=False):
        if camera.halo > MAX_HALO:
            found.append(("usable", f"the {side} camera sharpens: switch it off"))
        if camera.saturated > MUCH_SATURATED:
            found.append(("usable", f"whites of the {side} camera are clipped: less exposure"))
    return found


def _grade(value: float, good: float, worst: float) -> Grade:
    if not value <= worst:  # a NaN is no praise
        return "repeat"
    return "good" if value <= good else "usable"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
