"""Text and numbers of a result, for its pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Measurement, NearMiss, NotMeasured, Reject, Target
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart

REASONS = {
    Reject.FEW_EDGES: "too few edges seen",
    Reject.RESIDUAL: "edges do not lie on their curve",
    Reject.SIGMA_LIMIT: "sigma over its limit",
    Reject.LEFT_RIGHT_MISMATCH: "left and right image disagree",
    Reject.OUT_OF_VOLUME: "out of the allowed depth",
    Reject.TOLERANCE: "size out of tolerance",
    Reject.AMBIGUOUS_ROTATION: "rotation ambiguous",
    Reject.LOW_SCORE: "score too low",
    Reject.CALIBRATION: "calibration does not hold",
    Reject.AMBIGUOUS_EDGE: "the reference may be another edge",
    Reject.OUT_OF_LIMITS: "outside of the robot's limits",
    Reject.KEEP_OUT: "in a keep-out zone",
    Reject.NO_GRASP: "no grasp where the robot may go",
    Reject.OUT_OF_MAP: "beyond the map of the robot's error",
    Reject.BLUR: "blurred by the belt",
    Reject.NO_COUNT: "nobody said where the belt was",
}

REMEDIES = {
    Reject.FEW_EDGES: "is a part of it hidden, or out of one picture?",
    Reject.RESIDUAL: "is this the part of the job, in focus?",
    Reject.SIGMA_LIMIT: "more light, or a larger max_sigma_mm",
    Reject.LEFT_RIGHT_MISMATCH: "do both cameras see it, sharp, and is the rig theirs?",
    Reject.OUT_OF_VOLUME: "does it lie within depth_min_mm and depth_max_mm of the job?",
}
"""Remedies for the reasons that keep a match from being measured."""

MAX_REASONS = 3
"""Most reasons in the headline; all of them are listed with their part."""


@dataclass(frozen=True, slots=True)
class FeatureLine:
    """One feature as a row of a table: name, size, residuals and share of edges seen."""

    name: str
    size: str
    rms_px: str
    seen: str


def reasons(reject: Reject) -> list[str]:
    """All reasons of a rejection in words."""
    return [words for bit, words in REASONS.items() if reject & bit]


def why_nothing(dismissed: Sequence[NotMeasured], nearest: NearMiss | None) -> list[str]:
    """Why there is no target: a line for each match, and what to try."""
    lines = []
    for missed in dismissed:
        remedies = [words for bit, words in REMEDIES.items() if missed.reject & bit]
        lines.append(
            f"seen at {missed.match.x_px:.0f}, {missed.match.y_px:.0f} px "
            f"(score {missed.match.score:.2f}), not measured: {', '.join(reasons(missed.reject))} "
            f"({missed.reject.name}). Try: {' '.join(remedies) or 'look at it'}"
        )
    if not dismissed and nearest is not None:
        match = nearest.match
        lines.append(
            f"best score {match.score:.2f} at {match.x_px:.0f}, {match.y_px:.0f} px, "
            f"{nearest.needed_score:.2f} is needed. Try: light and focus as at teaching; a lower min_score "
            "where parts may be half hidden"
        )
    elif not dismissed:
        lines.append(
            "nothing in the left picture is like the part. Try: is it in the picture, at the taught "
            "distance, and in the taught light?"
        )
    return lines


def headline(
    job: Job,
    measured: Sequence[MeasuredPart],
    dismissed: Sequence[NotMeasured],
    nearest: NearMiss | None = None,
) -> str:
    """One line about the whole picture: parts, scores and position, or why there is no part."""
    targets = [part.target for part in measured]
    good = [target for target in targets if not target.reject]
    if not targets and not dismissed:
        best = "nothing is like it" if nearest is None else f"the best scores {nearest.match.score:.2f}"
        return f"{job.name}: {best}, {job.search.min_score:.2f} is needed"
    if not targets:
        why = sorted({word for missed in dismissed for word in reasons(missed.reject)})
        return f"{job.name}: {len(dismissed)} seen, none measured: {', '.join(why)}"
    scores = sorted({f"{target.match.score:.2f}" for target in good or targets})
    score = f"score {scores[0]}" if len(scores) == 1 else f"scores {scores[0]} to {scores[-1]}"
    if not good:
        why = sorted({word for target in targets for word in reasons(target.reject)})
        count = "" if len(targets) == 1 else f"{len(targets)} parts, "
        more = f", and {len(why) - MAX_REASONS} more" if len(why) > MAX_REASONS else ""
        return f"{job.name}: {count}{score}: {', '.join(why[:MAX_REASONS])}{more}"
    bad = len(targets) - len(good) + len(dismissed)
    more = f"; {bad} more not good" if bad else ""
    if len(good) > 1:
        return f"{job.name}: {len(good)} parts, {score}{more}"
    place = "  ".join(f"{name} {value} ± {sigma}" for name, value, sigma in pose_lines(good[0])[:3])
    return f"{job.name}: {score},  {place.replace(' mm', '')} mm{more}"


def pose_lines(target: Target) -> list[tuple[str, str, str]]:
    """Name, value and sigma of x, y, z, tilt and turn; angles in degrees."""
    lines = [
        (name, f"{value:.4f}", f"{sigma:.4f} mm")
        for name, value, sigma in zip("xyz", target.position_mm, target.sigma_mm, strict=True)
    ]
    rotation = target.rig_from_part[:3, :3]
    normal = rotation[:, 2]
    spread = target.covariance[3:, 3:]
    tilt = math.degrees(math.acos(min(1.0, abs(float(normal[2])))))
    lines.append(("tilt", f"{tilt:.3f}", f"{_degrees(_across(spread, normal)):.3f}°"))
    if target.free_axis is None:
        # angle of the part's x axis to the rig's x axis projected onto the face: 0 as taught
        turn = math.degrees(math.atan2(-float(rotation[0, 1]), float(rotation[0, 0])))
        lines.append(("turn", f"{turn:.3f}", f"{_degrees(float(normal @ spread @ normal)):.3f}°"))
    else:
        lines.append(("turn", "not known:", "round"))
    return lines


def size_lines(measurements: Sequence[Measurement]) -> list[tuple[str, str, bool | None]]:
    """Name, measured and nominal value, and whether it is within its tolerance."""
    lines = []
    for measurement in measurements:
        text = (
            "not seen"
            if math.isnan(measurement.value)
            else f"{measurement.value:.4f} ± {measurement.sigma:.4f} {measurement.unit}"
        )
        if measurement.tolerance is not None:
            text += f", wanted {measurement.nominal or 0.0:g} ± {measurement.tolerance:g}"
        lines.append((measurement.name, text, measurement.ok))
    return lines


def feature_lines(job: Job, measured: MeasuredPart) -> list[FeatureLine]:
    """Rows of all features: circles, slots, edges, in the job's order; those not measured last."""
    target = measured.target
    fits = {fit.name: fit for fit in measured.fits}
    sizes = {
        circle.name: f"r {circle.radius_mm:.4f} ± {circle.sigma_radius_mm:.4f} mm"
        for circle in target.circles
    }
    sizes |= {slot.name: f"{slot.length_mm:.4f} x {slot.width_mm:.4f} mm" for slot in target.slots}
    sizes |= {edge.name: "straight edge" for edge in target.edges}
    lines = []
    for name, size in sizes.items():
        fit = fits.get(name)
        rms, seen = ("", "") if fit is None else (f"{fit.rms_px:.2f}", _seen(*fit.support))
        lines.append(FeatureLine(name, size, rms, seen))
    known = measured_names(measured.target)
    taught = [feature.name for features in (job.circles, job.slots, job.edges) for feature in features]
    return lines + [FeatureLine(name, "not measured", "", "") for name in taught if name not in known]


def measured_names(target: Target) -> set[str]:
    """Names of all measured features except corners, which derive from edges."""
    names = [circle.name for circle in target.circles] + [slot.name for slot in target.slots]
    return {*names, *(edge.name for edge in target.edges)}


def reference_name(target: Target) -> str:
    """Name of the feature at the reported position; empty if that feature was not measured."""
    places = [(circle.name, circle.centre_mm) for circle in target.circles]
    places += [(slot.name, slot.centre_mm) for slot in target.slots]
    places += [(corner.name, corner.position_mm) for corner in target.corners]
    near = [(float(np.linalg.norm(place - target.position_mm)), name) for name, place in places]
    distance, name = min(near, default=(math.inf, ""))
    return name if distance < 1e-3 else ""


def _seen(left: float, right: float) -> str:
    return f"{100 * left:.0f}, {100 * right:.0f} %"


def _across(spread: FloatArray, normal: FloatArray) -> float:
    """Largest variance of a rotation about any axis in the face."""
    rest = np.eye(3) - np.outer(normal, normal)
    return float(np.linalg.eigvalsh(rest @ spread @ rest)[-1])


def _degrees(variance: float) -> float:
    return math.degrees(math.sqrt(max(variance, 0.0)))
