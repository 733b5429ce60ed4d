"""What makes a result good: the limits of a job as reasons against a target, and its doubts in its sigma."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Measurement, Reject, Target
from edged.vision.geometry.rectification import Rectification
from edged.vision.part.consistency import doubt_by_rows, doubt_by_sizes, doubted
from edged.vision.part.job import Job
from edged.vision.part.measured import Evidence


def judged(job: Job, rectification: Rectification, target: Target, evidence: Evidence) -> Target:
    """The target with every limit that it fails among its reasons, and with its doubts in every covariance.

    A doubt that by itself makes a result too vague is a reason of its own kind: rows that do not meet are a
    mismatch, sizes that are wrong alike are out of tolerance.
    """
    limits = job.limits
    reject = target.reject | _reasons(job, target, evidence)
    reject |= _out_of_tolerance(job, target, evidence) | size_reasons(target.measurements)
    by_rows = doubt_by_rows(rectification, target, evidence.row_shift_px, evidence.row_sigma_px)
    by_sizes = doubt_by_sizes(evidence.scale, evidence.sigma_scale)
    for share, reason in (
        (by_rows, Reject.LEFT_RIGHT_MISMATCH),
        (by_sizes, Reject.TOLERANCE),
    ):
        if share * float(np.linalg.norm(target.position_mm)) > limits.max_sigma_mm:
            reject |= reason
    return replace(doubted(target, math.hypot(by_rows, by_sizes), rectification.baseline_mm), reject=reject)


def size_reasons(measurements: tuple[Measurement, ...]) -> Reject:
    """What the sizes speak against a part: out of tolerance, or not to be seen."""
    reject = Reject.NONE
    for one in measurements:
        if one.ok is False:
            reject |= Reject.TOLERANCE if math.isfinite(one.value) else Reject.FEW_EDGES
    return reject


def vaguest_mm(job: Job, target: Target) -> float:
    """The largest sigma of a coordinate, and of how high each end of the part's face lies.

    A normal that stands on a small hole is a vague one, and at the far end of the part so is the height. The
    turn about the normal is left out: of a round part nobody needs to know it.
    """
    normal, reference = target.rig_from_part[:3, 2], job.place_of(job.reference)
    arms = (_ends_mm(job) - reference) @ target.rig_from_part[:3, :3].T
    # a rotation w of the part lifts the end of an arm by n (w x arm) = w (arm x n)
    lifts = np.hstack([np.tile(normal, (len(arms), 1)), np.cross(arms, normal)])
    heights = np.einsum("ki,ij,kj->k", lifts, target.covariance, lifts).tolist()
    return math.sqrt(max(*np.diag(target.covariance)[:3].tolist(), *heights))


def _ends_mm(job: Job) -> FloatArray:
    """(N, 3) part frame: how far the features reach."""
    cross = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    ends = [circle.centre_mm + circle.radius_mm * cross for circle in job.circles]
    ends += [slot.centre_mm + 0.5 * slot.length_mm * cross for slot in job.slots]
    ends += [np.stack([edge.start_mm, edge.end_mm]) for edge in job.edges]
    return np.concatenate(ends)


def _reasons(job: Job, target: Target, evidence: Evidence) -> Reject:
    reject, limits = Reject.NONE, job.limits
    if not evidence.support >= limits.min_support:
        reject |= Reject.FEW_EDGES
    if not evidence.rms_px <= limits.max_rms_px:
        reject |= Reject.RESIDUAL
    if not vaguest_mm(job, target) <= limits.max_sigma_mm:
        reject |= Reject.SIGMA_LIMIT
    if target.epipolar_rms_px > limits.max_epipolar_px:  # NaN: no edge tells its row
        reject |= Reject.LEFT_RIGHT_MISMATCH
    if not limits.depth_mm[0] <= target.position_mm[2] <= limits.depth_mm[1]:
        reject |= Reject.OUT_OF_VOLUME
    return reject


def _out_of_tolerance(job: Job, target: Target, evidence: Evidence) -> Reject:
    """Whether the reference circle's size, or the form of a part without circles, is not the taught one."""
    allowed = job.limits.radius_tolerance_mm
    if job.circles and allowed is not None:
        taught = job.reference_circle
        for circle in target.circles:
            if circle.name == taught.name and abs(circle.radius_mm - taught.radius_mm) > allowed:
                return Reject.TOLERANCE
    form = job.limits.form_tolerance_mm
    if form is not None and evidence.form_mm > form:
        return Reject.TOLERANCE
    return Reject.NONE
