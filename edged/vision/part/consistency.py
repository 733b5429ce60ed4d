"""Acceptance of a result: the limits of the job, and contradictions between the pictures and the rig.

Such contradictions are rows that do not meet, and sizes that are all wrong by one factor.

A camera that was knocked, or a right image that is older than the left one while the part moved on, still
shows one part in both images; only its distance is wrong, and the residuals do not show it. Two things do:

* Rows. A camera that has moved across the rows has also moved along them, by an unknown amount, and a shift
  along the rows is an error of distance.
* Sizes. A part found at a wrong distance is too large, or too small, in all of its features by one factor,
  in radii and positions alike. A part out of tolerance differs in another way. (A warm part differs in just
  this way, 0.02 % for 20 K in steel: no picture tells it from a nearer one.) If the taught sizes were
  measured by this rig, they share the errors of its calibration: then only the uncertainty of the edges
  counts.

Neither makes the result wrong; both make it less certain. Both are doubts about one number, the relative
error of the distance, by which everything is scaled about the left camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Corner3D, Edge3D, Measurement, Reject, Slot3D, Target
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import length_of
from edged.vision.kernels.robust import mad_sigma
from edged.vision.part.job import CircleFeature, Job
from edged.vision.part.measured import Evidence
from edged.vision.part.params import MEASURING

Feature = TypeVar("Feature", Circle3D, Edge3D, Slot3D, Corner3D)


def scale_deviation(job: Job, circles: Sequence[Circle3D]) -> tuple[float, float]:
    """Relative excess of circles' sizes and distances over the taught ones, its sigma; NaN for too few.

    It is the weighted median: a worn hole, or one drilled elsewhere, is a fault of the part and has no
    effect. Its sigma comes from the scatter, and from the stated sigmas as if all errors were fully
    correlated, as they are under one light.
    """
    by_name = {circle.name: circle for circle in circles}
    seen = [(arm, by_name[circle.name]) for circle, arm in _arms_mm(job) if circle.name in by_name]
    radii = {circle.name: circle.radius_mm for circle in job.circles}
    taught = [radii[found.name] for _, found in seen]
    sizes = [found.radius_mm for _, found in seen]
    variances = [found.covariance[3, 3] for _, found in seen]
    hub = by_name.get(job.reference_circle.name)
    far = [(arm, found) for arm, found in seen if arm > 0.0]
    if hub is not None and far:
        gaps = np.array([found.centre_mm for _, found in far]) - hub.centre_mm
        lengths = np.sqrt(gaps[:, 0] ** 2 + gaps[:, 1] ** 2 + gaps[:, 2] ** 2)
        spread = np.array([found.covariance[:3, :3] for _, found in far]) + hub.covariance[:3, :3]
        along = (gaps / lengths[:, None])[:, None]
        taught += [arm for arm, _ in far]
        sizes += lengths.tolist()
        variances += np.maximum(along @ spread @ along.transpose(0, 2, 1), 0.0)[:, 0, 0].tolist()
    if len(taught) < MEASURING.min_sizes:
        return math.nan, math.nan
    return _common_growth(np.array(taught), np.array(sizes), np.sqrt(variances))


def _common_growth(taught: FloatArray, sizes: FloatArray, sigmas: FloatArray) -> tuple[float, float]:
    """Weighted median of the relative excess of sizes (N,) over taught ones, and its sigma."""
    shares, errors = sizes / taught - 1, np.maximum(sigmas / taught, MEASURING.min_size_share)
    weights = errors**-2
    order = shares.argsort()
    total = float(weights.sum())
    half = weights[order].cumsum().searchsorted(0.5 * total)
    growth = float(shares[order][half])
    scatter = mad_sigma((shares - growth) / errors)
    alike = float((weights * errors).sum()) / total
    return growth, math.hypot(scatter * math.sqrt(math.pi / 2 / total), alike)


@lru_cache(maxsize=16)
def _arms_mm(job: Job) -> tuple[tuple[CircleFeature, float], ...]:
    """The circles of a job with their distances from the reference circle; 0 for too short ones."""
    middle = job.reference_circle
    shortest = MEASURING.arm * middle.radius_mm
    arms = [length_of(circle.centre_mm - middle.centre_mm) for circle in job.circles]
    return tuple(
        (circle, arm if arm > shortest else 0.0) for circle, arm in zip(job.circles, arms, strict=True)
    )


def doubt_by_rows(rectification: Rectification, target: Target, shift_px: float, sigma_px: float) -> float:
    """Relative sigma of the distance implied by a shift across the rows; 0 if that shift is explained."""
    depth = float(rectification.rectified_from_left[2] @ target.position_mm)
    floor_px = MEASURING.min_rows_px if rectification.rig.covariance is not None else MEASURING.wall_px
    beyond_px = MEASURING.along_per_across * _beyond(shift_px, max(MEASURING.certain * sigma_px, floor_px))
    return beyond_px * depth / (rectification.focal_px * rectification.baseline_mm)


def distance_share(place_mm: FloatArray, covariance: FloatArray) -> float:
    """Relative sigma of the distance of a place (3,) over the taught one, if both have covariance (3, 3)."""
    distance = length_of(place_mm)
    ray = place_mm / distance
    return math.sqrt(2 * max(float(ray @ covariance @ ray), 0.0)) / distance


def doubt_by_sizes(growth: float, sigma: float) -> float:
    """Relative sigma of the distance implied by a common growth of all sizes; 0 if that is explained."""
    return _beyond(growth, MEASURING.certain * sigma)


def _beyond(value: float, explained: float) -> float:
    """Full magnitude of a value that exceeds what is explained; 0 otherwise, and for NaN."""
    return abs(value) if abs(value) > explained else 0.0


def doubted(target: Target, share: float, baseline_mm: float) -> Target:
    """The target with a relative doubt about its distance added to every covariance."""
    if share == 0:
        return target
    doubt_mm = share * float(np.linalg.norm(target.position_mm))
    return replace(_widened(target, share**2, baseline_mm), doubt_mm=doubt_mm)


def without_doubt(target: Target, baseline_mm: float) -> Target:
    """The target without the doubt about its distance, for callers that judge the rig by it."""
    share = target.doubt_mm / float(np.linalg.norm(target.position_mm))
    return replace(_widened(target, -(share**2), baseline_mm), doubt_mm=0.0, by_doubt=np.zeros((6, 6)))


def _widened(target: Target, square: float, baseline_mm: float) -> Target:
    """The target with a relative variance of the distance added to every covariance.

    A shift of one image by s moves the mean of both by s / 2: the position across the ray is in doubt, too,
    by the same share of half a baseline.
    """
    normal = target.rig_from_part[:3, 2]
    covariance, by_doubt = target.covariance.copy(), target.by_doubt.copy()
    along = square * np.outer(target.position_mm, target.position_mm)
    covariance[:3, :3] += along
    ray = target.position_mm / np.linalg.norm(target.position_mm)
    aside = square * (0.5 * baseline_mm) ** 2 * (np.eye(3) - np.outer(ray, ray))
    covariance[:3, :3] += aside
    by_doubt[:3, :3] += along + aside
    return replace(
        target,
        covariance=covariance,
        by_doubt=by_doubt,
        circles=tuple(
            _grown(circle, square, aside, circle.centre_mm, circle.radius_mm) for circle in target.circles
        ),
        edges=tuple(
            _grown(edge, square, _aside_of(edge, normal, aside), _across(edge, normal), 0.0)
            for edge in target.edges
        ),
        slots=tuple(
            _grown(slot, square, aside, slot.centre_mm, slot.length_mm, slot.width_mm)
            for slot in target.slots
        ),
        corners=tuple(_grown(corner, square, aside, corner.position_mm) for corner in target.corners),
        measurements=tuple(_measurement(size, square) for size in target.measurements),
    )


def _grown(feature: Feature, square: float, aside: FloatArray, *lengths_mm: FloatArray | float) -> Feature:
    """The feature with a relative variance of the distance added to its covariance.

    lengths_mm : the quantities of its covariance, all of which grow with the distance.  aside (k, k) :
    further variance of the first k of them.
    """
    growth = np.hstack(lengths_mm)
    covariance = feature.covariance + square * np.outer(growth, growth)
    covariance[: len(aside), : len(aside)] += aside
    return replace(feature, covariance=covariance)


def _aside_of(edge: Edge3D, normal: FloatArray, aside: FloatArray) -> FloatArray:
    """(1, 1) variance across an edge, from a covariance in space (3, 3)."""
    across = _direction_across(edge, normal)
    return np.array([[across @ aside @ across]])


def _direction_across(edge: Edge3D, normal: FloatArray) -> FloatArray:
    along = edge.end_mm - edge.start_mm
    return np.asarray(np.cross(normal, along / np.linalg.norm(along)))


def _across(edge: Edge3D, normal: FloatArray) -> float:
    """Offset of the edge's middle from the left camera, across the edge within the face."""
    return float(_direction_across(edge, normal) @ (0.5 * (edge.start_mm + edge.end_mm)))


def _measurement(size: Measurement, square: float) -> Measurement:
    if size.unit != "mm":
        return size
    return replace(size, sigma=float(np.sqrt(size.sigma**2 + square * size.value**2)))


def apply_limits(job: Job, rectification: Rectification, target: Target, evidence: Evidence) -> Target:
    """The target with a reject reason for every failed limit, and with its doubts added to every covariance.

    A doubt that by itself makes a result too uncertain has a reason of its own: LEFT_RIGHT_MISMATCH for rows
    that do not meet, TOLERANCE for sizes that are all wrong by one factor.
    """
    limits = job.limits
    reject = target.reject
    for reasons in (
        _reasons(job, target, evidence),
        _out_of_tolerance(job, target, evidence),
        size_reasons(target.measurements),
    ):
        if reasons is not Reject.NONE:
            reject |= reasons
    by_rows = doubt_by_rows(rectification, target, evidence.row_shift_px, evidence.row_sigma_px)
    by_sizes = doubt_by_sizes(evidence.scale, evidence.sigma_scale)
    for share, reason in (
        (by_rows, Reject.LEFT_RIGHT_MISMATCH),
        (by_sizes, Reject.TOLERANCE),
    ):
        if share * length_of(target.position_mm) > limits.max_sigma_mm:
            reject |= reason
    target = doubted(target, math.hypot(by_rows, by_sizes), rectification.baseline_mm)
    return target if reject == target.reject else replace(target, reject=reject)


def size_reasons(measurements: tuple[Measurement, ...]) -> Reject:
    """Reject reasons from the sizes: out of tolerance, or not visible."""
    reject = Reject.NONE
    for size in measurements:
        if size.ok is False:
            reject |= Reject.TOLERANCE if math.isfinite(size.value) else Reject.FEW_EDGES
    return reject


def vaguest_mm(job: Job, target: Target) -> float:
    """Largest sigma of the position's coordinates and of the heights of the ends of the part's face.

    A normal measured on a small hole is uncertain, and so then is the height of the far end of the part. The
    turn about the normal is left out: a round part has none.
    """
    normal, reference = target.rig_from_part[:3, 2], job.place_of(job.reference)
    arms = (_ends_mm(job) - reference) @ target.rig_from_part[:3, :3].T
    # a rotation w of the part lifts the end of an arm by n (w x arm) = w (arm x n)
    lifts = np.empty((len(arms), 6))
    lifts[:, :3] = normal
    lifts[:, 3:] = arms[:, (1, 2, 0)] * normal[[2, 0, 1]] - arms[:, (2, 0, 1)] * normal[[1, 2, 0]]
    heights = np.einsum("ki,ij,kj->k", lifts, target.covariance, lifts).tolist()
    return math.sqrt(max(*target.covariance.diagonal()[:3].tolist(), *heights))


@lru_cache(maxsize=16)
def _ends_mm(job: Job) -> FloatArray:
    """(N, 3) extreme points of the features, part frame."""
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
    """TOLERANCE if the reference circle's size, or the form of a part without circles, exceeds its limit."""
    allowed = job.limits.radius_tolerance_mm
    if job.circles and allowed is not None:
        taught = job.reference_circle
        for circle in target.circles:
            if circle.name != taught.name:
                continue
            if abs(circle.radius_mm - taught.radius_mm) - evidence.break_mm > allowed:
                return Reject.TOLERANCE
    form = job.limits.form_tolerance_mm
    if form is not None and evidence.form_mm > form:
        return Reject.TOLERANCE
    return Reject.NONE
