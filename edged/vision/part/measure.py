"""Measure all features of a part: circles, straight edges, slots, corners; and its pose and sizes from them.

The circles are measured first, with the plane of the face (see `circles`); a part without circles gets its
plane from the rows of its edges (see `initialpose`). Then every curve of the face is measured in one fit,
which yields the pose, the features in the rig frame, and the sizes with their tolerances.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Match, Reject, ReportedPose, Target
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face
from edged.vision.curves.planefit import PlaneFit, differentiated, fit_plane
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import about_z, length_of, transform
from edged.vision.geometry.uncertainty import shifted_pose_covariance
from edged.vision.part.circles import measure
from edged.vision.part.consistency import apply_limits, distance_share
from edged.vision.part.flatness import with_flatness
from edged.vision.part.frames import SEPARATE_KINDS, lifted, measure_sizes, place, with_features
from edged.vision.part.heights import with_heights
from edged.vision.part.initialpose import starts
from edged.vision.part.job import Job
from edged.vision.part.measured import Evidence, MeasuredPart
from edged.vision.part.params import MEASURING
from edged.vision.part.pose import (
    InPlaneMotion,
    edge_curve,
    find_motion,
    form_mm,
    scale_of_features,
    slot_curve,
)
from edged.vision.part.prediction import is_contradicted, match_in_raw
from edged.vision.part.solid import curves_of, measure_solid
from edged.vision.shape.params import EACH_EDGE_ITSELF
from edged.vision.shape.search import ShapeMatch

UNKNOWN_TURN = math.pi / math.sqrt(3)  # sigma of an entirely unknown angle


def measure_part(images: StereoImages, job: Job, match: ShapeMatch) -> MeasuredPart | Reject:
    """Measure one found part with all its features; the reason when it cannot be measured at all."""
    if job.solid:
        return _in_model(job, _measured_whole(images, job, match))
    result = _measured_flat(images, job, match)
    # walls may hide single curves, or displace them in one camera, while the whole part can still be located
    if isinstance(result, Reject) or result.target.reject is Reject.LEFT_RIGHT_MISMATCH:
        whole = _measured_whole(images, job, match)
        if isinstance(whole, MeasuredPart) and _is_beyond_doubt(job, whole):
            return _in_model(job, whole)
    return _in_model(job, result)


def _is_beyond_doubt(job: Job, whole: MeasuredPart) -> bool:
    """Whether nothing contradicts a part that was measured as a whole, its rows included.

    A single curve has nothing that could: a long slot of which the ends hardly show slides along itself.
    Glinting broken rims do, if most of them are seen with the opposite of the taught sign: all of them may
    have been measured on the other ends of their breaks.
    """
    if len(whole.fits) < 2:
        return False
    taught = {curve.name: curve.polarity for curve in curves_of(job)}
    odd = sum(found.curve.polarity != taught[found.name] for found in whole.fits)
    broken = any(found.scatter.break_mm > 0.0 for found in whole.fits)
    if broken and odd > 0.5 * len(whole.fits):
        return False
    apart_px = abs(whole.evidence.row_shift_px)
    return not whole.target.reject and not whole.target.doubt_mm and apart_px <= job.limits.max_epipolar_px


def _in_model(job: Job, result: MeasuredPart | Reject) -> MeasuredPart | Reject:
    """The measured part as the job publishes it."""
    if isinstance(result, Reject):
        return result
    target = published(job, result.target)
    return result if target is result.target else replace(result, target=target)


def published(job: Job, target: Target) -> Target:
    """The target with the pose of the job's CAD model, and with the pose that the job is set to publish."""
    if job.sigma_mm:
        target = _with_teaching_uncertainty(job, target)
    if job.part_from_model is None:
        return target
    from_reference = job.reference_from_part
    placed = target.rig_from_part @ from_reference @ job.part_from_model
    target = replace(target, rig_from_model=placed)
    return _with_reported(job, target, target.rig_from_part @ from_reference)


def _with_reported(job: Job, target: Target, rig_from_own: FloatArray) -> Target:
    """The target with the pose that the job publishes; rejected where that pose is too uncertain.

    rig_from_own (4, 4) : pose of the frame that the job's features are in.
    """
    if job.part_from_reported is None:
        return target
    pose = rig_from_own @ job.part_from_reported
    covariance = shifted_pose_covariance(target.covariance, pose[:3, 3] - target.position_mm)
    by_edges = target.by_edges
    if by_edges is not None:
        by_edges = shifted_pose_covariance(by_edges, pose[:3, 3] - target.position_mm)
    vague = not float(np.sqrt(np.diag(covariance)[:3].max())) <= job.limits.max_sigma_mm
    reject = target.reject | (Reject.SIGMA_LIMIT if vague else Reject.NONE)
    return replace(target, reported=ReportedPose(pose, covariance, by_edges), reject=reject)


def _with_teaching_uncertainty(job: Job, target: Target) -> Target:
    """The target with the uncertainty of the taught features (`Job.sigma_mm`) added.

    An edge break moves opposite edges towards each other, and may lower all of them alike; so does a wall as
    bright as the face.
    """
    names = [feature.name for feature in job.circles] + [feature.name for feature in job.edges]
    size_mm = np.linalg.norm(np.ptp(np.array([job.place_of(name)[:2] for name in names]), axis=0))
    reach_mm = max([0.5 * float(size_mm), *(circle.radius_mm for circle in job.circles)])
    normal = target.rig_from_part[:3, 2]
    taught = np.zeros((6, 6))
    taught[:3, :3] = job.sigma_mm**2 * (np.eye(3) + (MEASURING.across**2 - 1) * np.outer(normal, normal))
    taught[3:, 3:] = (job.sigma_mm / reach_mm) ** 2 * np.eye(3)
    covariance = target.covariance + taught
    vague = float(np.sqrt(np.diag(covariance)[:3].max())) > job.limits.max_sigma_mm
    reject = target.reject | (Reject.SIGMA_LIMIT if vague else Reject.NONE)
    by_edges = None if target.by_edges is None else target.by_edges + taught
    return replace(target, covariance=covariance, by_edges=by_edges, reject=reject)


def _measured_flat(images: StereoImages, job: Job, match: ShapeMatch) -> MeasuredPart | Reject:
    """Measure a part of one face, each curve with its own position, and apply the limits of the job."""
    result: MeasuredPart | Reject
    if job.circles:
        measured = measure(images, _by_circle(job), match)
        if measured is None:
            return Reject.LEFT_RIGHT_MISMATCH
        result = _completed(images, job, measured)
    else:
        result = _from_edges(images, job, match)
    if isinstance(result, Reject):
        return result
    result = with_separate_sizes(result, images, job)
    target = apply_limits(job, images.rectification, result.target, result.evidence)
    if target.reject is Reject.NONE and is_contradicted(images, job, match, target):
        target = replace(target, reject=Reject.AMBIGUOUS_ROTATION)
    return result if target is result.target else replace(result, target=target)


@lru_cache(maxsize=16)  # one object, for which others keep what is the same in every cycle
def _by_circle(job: Job) -> Job:
    """The job with a circle as its reference."""
    first = job.reference_circle.name
    return job if job.reference == first else replace(job, reference=first)


def with_separate_sizes(measured: MeasuredPart, images: StereoImages, job: Job) -> MeasuredPart:
    """The measured part with its heights and its flatness, if the job has them."""
    kinds = {spec.kind for spec in job.measurements}
    if "height" in kinds:
        measured = with_heights(measured, images, job)
    return with_flatness(measured, images, job) if "flatness" in kinds else measured


def _measured_whole(images: StereoImages, job: Job, match: ShapeMatch) -> MeasuredPart | Reject:
    """Measure a part as one rigid whole, and apply the limits of the job."""
    result = measure_solid(images, job, match)
    if isinstance(result, Reject):
        return result
    result = with_separate_sizes(result, images, job)
    target = apply_limits(job, images.rectification, with_free_axis(job, result.target), result.evidence)
    return replace(result, target=target)


# --- parts with circles ----------------------------------------------------------------------------


def _completed(images: StereoImages, job: Job, measured: MeasuredPart) -> MeasuredPart:
    """A part whose circles are measured, completed by its other features and its sizes."""
    fit = None
    if needs_all(job, measured.target):
        polarity = {found.name: found.curve.polarity for found in measured.fits}
        face, curves = all_curves(job, measured.target, polarity)
        fit = fit_plane(images.rig, images.raw, face, curves, MEASURING.near)
    beside = () if fit is None else tuple(found for found in fit.fits if found.curve.kind != "circle")
    return MeasuredPart(completed(job, measured.target, fit), measured.evidence, measured.fits + beside)


def needs_all(job: Job, target: Target) -> bool:
    """Whether all features are measured together because the found circles do not suffice."""
    return (not _is_turn_known(job, target) and bool(job.edges or job.slots)) or _sizes_need_all(job)


def completed(job: Job, target: Target, fit: PlaneFit | None) -> Target:
    """A target of measured circles completed by its other features and its sizes, from one fit of all."""
    if fit is not None and not _is_turn_known(job, target):
        target = _turned(job, fit, target)
    if job.measurements:
        target = replace(target, measurements=measure_sizes(job, fit, target.circles))
    if fit is not None:
        target = with_features(target, job, fit)
    target = with_free_axis(job, target)
    if job.kind_of(job.reference) not in ("circle", None):
        target = _referred(job, fit, target)
    return target


def _is_turn_known(job: Job, target: Target) -> bool:
    return _circles_tell_rotation(job, {circle.name for circle in target.circles})


def _circles_tell_rotation(job: Job, found: set[str]) -> bool:
    """Whether a found circle lies far enough from the reference to determine the part's rotation."""
    return not found.isdisjoint(_far_circles(job))


@lru_cache(maxsize=16)
def _far_circles(job: Job) -> frozenset[str]:
    """Names of the circles that determine the part's rotation.

    Holes do that better than outer edges, whose side walls one of the cameras sees.
    """
    reference = job.reference_circle
    return frozenset(
        circle.name
        for circle in job.circles
        if length_of(circle.centre_mm - reference.centre_mm) > MEASURING.concentric * reference.radius_mm
    )


@lru_cache(maxsize=16)
def _sizes_need_all(job: Job) -> bool:
    """Whether the job has measurements or a reference that circles alone do not provide."""
    kinds = {spec.kind for spec in job.measurements}
    return bool(kinds - {"radius", *SEPARATE_KINDS}) or job.kind_of(job.reference) != "circle"


def all_curves(job: Job, target: Target, polarity: dict[str, int]) -> tuple[Face, list[Curve]]:
    """The measured circles, with their polarity, and the edges and slots where the pose puts them."""
    part = _part_pose(job, target)
    face = Face(part[:3, 3], part[:3, :3].T)
    curves = []
    for circle in target.circles:
        x, y, height = face.from_rig(circle.centre_mm)
        parameters = np.array([x, y, circle.radius_mm])
        curves.append(Curve(circle.name, "circle", parameters, polarity[circle.name], height_mm=height))
    free = job.search.polarity != "same"
    curves += [edge_curve(edge, free) for edge in job.edges]
    curves += [slot_curve(slot, free) for slot in job.slots]
    return face, curves


def _part_pose(job: Job, target: Target) -> FloatArray:
    """(4, 4) rig_from_part with its origin at that of the job's coordinates, not at the reference point."""
    rotation = target.rig_from_part[:3, :3]
    return transform(rotation, target.position_mm - rotation @ job.reference_circle.centre_mm)


def _turned(job: Job, fit: PlaneFit, target: Target) -> Target:
    """The target with its rotation about the normal from all features together."""
    motion = find_motion(job, fit)
    if motion is None:
        return target
    rotation = target.rig_from_part[:3, :3] @ about_z(motion.turn)
    normal = target.rig_from_part[:3, 2]
    covariance = _with_turn(target.covariance, normal, motion.covariance[2, 2])
    by_edges = target.by_edges
    if by_edges is not None:
        by_edges = _with_turn(by_edges, normal, motion.edge_covariance[2, 2])
    pose = transform(rotation, target.position_mm)
    return replace(target, rig_from_part=pose, covariance=covariance, by_edges=by_edges)


def _with_turn(covariance: FloatArray, normal: FloatArray, variance: float) -> FloatArray:
    """The covariance (6, 6) of a pose with the variance of the turn about the normal (3,) replaced."""
    known = normal @ covariance[3:, 3:] @ normal
    turned = covariance.copy()
    turned[3:, 3:] += (variance - known) * np.outer(normal, normal)
    return turned


def _referred(job: Job, fit: PlaneFit | None, target: Target) -> Target:
    """The target with its position at a slot or a corner instead of a circle."""
    point = None if fit is None else place(job, fit, job.reference)
    if fit is None or point is None:
        offset = target.rig_from_part[:3, :3] @ (job.place_of(job.reference) - job.reference_circle.centre_mm)
        pose = transform(target.rig_from_part[:3, :3], target.position_mm + offset)
        return replace(target, rig_from_part=pose, reject=target.reject | Reject.FEW_EDGES)
    face = fit.face

    def in_rig(parameters: FloatArray) -> FloatArray:
        return lifted(face, parameters, point(parameters))

    position, jacobian = differentiated(fit, in_rig)
    covariance = _with_place(target.covariance, jacobian @ fit.covariance @ jacobian.T)
    by_edges = target.by_edges
    if by_edges is not None:
        by_edges = _with_place(by_edges, jacobian @ fit.edge_covariance @ jacobian.T)
    pose = transform(target.rig_from_part[:3, :3], position)
    return replace(target, rig_from_part=pose, covariance=covariance, by_edges=by_edges)


def _with_place(covariance: FloatArray, place: FloatArray) -> FloatArray:
    """The covariance (6, 6) of a pose with its position's replaced by (3, 3), independent of the rotation."""
    placed = np.zeros((6, 6))
    placed[:3, :3], placed[3:, 3:] = place, covariance[3:, 3:]
    return placed


def with_free_axis(job: Job, target: Target) -> Target:
    """The target of a round part with its free axis, and an unknown turn about it; others unchanged."""
    return free_about_z(target) if _is_round(job) else target


def free_about_z(target: Target) -> Target:
    """The target of a part whose turn about its own z means nothing."""
    axis = target.rig_from_part[:3, 2]
    unknown = np.zeros((6, 6))
    unknown[3:, 3:] = UNKNOWN_TURN**2 * np.outer(axis, axis)
    by_edges = None if target.by_edges is None else target.by_edges + unknown
    return replace(target, free_axis=axis, covariance=target.covariance + unknown, by_edges=by_edges)


def _is_round(job: Job) -> bool:
    """Whether the part is rotationally symmetric."""
    if not (job.circles and job.shape.round):
        return False
    centre = job.reference_circle.centre_mm
    reach = MEASURING.concentric * job.reference_circle.radius_mm
    concentric = all(np.linalg.norm(circle.centre_mm - centre) < reach for circle in job.circles)
    return concentric and not job.edges and not job.slots


# --- parts without circles -------------------------------------------------------------------------


def _from_edges(images: StereoImages, job: Job, match: ShapeMatch) -> MeasuredPart | Reject:
    """Measure a part that has only edges and slots."""
    free = job.search.polarity in EACH_EDGE_ITSELF
    sign = -1 if match.inverted and not free else 1
    curves = [edge_curve(edge, free, sign) for edge in job.edges]
    curves += [slot_curve(slot, free, sign) for slot in job.slots]
    poor: MeasuredPart | None = None
    failed: Reject | None = None
    for pose in starts(images, job, match, curves):
        result = Reject.LEFT_RIGHT_MISMATCH if pose is None else _from_start(images, job, match, curves, pose)
        if isinstance(result, Reject):
            failed = failed or result
        elif not result.target.reject & Reject.FEW_EDGES:
            return result
        else:
            poor = poor or result
    return poor or failed or Reject.LEFT_RIGHT_MISMATCH


def _from_start(
    images: StereoImages, job: Job, match: ShapeMatch, curves: list[Curve], pose: FloatArray
) -> MeasuredPart | Reject:
    """Measure from an approximate rig_from_part (4, 4)."""
    face = Face(pose[:3, 3], pose[:3, :3].T)
    fit = fit_plane(images.rig, images.raw, face, curves, MEASURING.far)
    motion = None if fit is None else find_motion(job, fit)
    if fit is None or motion is None:
        return Reject.FEW_EDGES
    target = target_from(images.rectification, job, match_in_raw(images.rectification, match), fit, motion)
    reject = Reject.AMBIGUOUS_ROTATION if match.ambiguous else Reject.NONE
    if len(fit.fits) < min(MEASURING.min_edges, len(curves)) and not any(
        found.curve.kind == "slot" for found in fit.fits
    ):
        reject |= Reject.FEW_EDGES
    if math.isnan(target.epipolar_rms_px) and _has_rows(images.rectification, job, fit.face, motion):
        reject |= Reject.LEFT_RIGHT_MISMATCH
    evidence = Evidence(
        _mean_support(curves, fit),
        float(np.sqrt(np.mean([found.rms_px**2 for found in fit.fits]))),
        fit.row_shift_px,
        fit.row_sigma_px,
        *_growth(images, job, fit, motion, target.match),
        form_mm(job, fit, motion),
    )
    return MeasuredPart(replace(target, reject=reject), evidence, fit.fits)


def _growth(
    images: StereoImages, job: Job, fit: PlaneFit, motion: InPlaneMotion, match: Match
) -> tuple[float, float]:
    """Relative growth of the features' distances since teaching, and its sigma, including the depth's."""
    if job.calibration_id == images.rig.calibration_id:
        fit = fit.by_edges()
    growth, sigma = scale_of_features(job, fit)
    target = target_from(images.rectification, job, match, fit, motion)
    return growth, math.hypot(sigma, distance_share(target.position_mm, target.covariance[:3, :3]))


def target_from(
    rectification: Rectification, job: Job, match: Match, fit: PlaneFit, motion: InPlaneMotion
) -> Target:
    """The target of a part without circles, from the fit of its face and the motion of its features in it."""
    face = fit.face
    reference = job.place_of(job.reference)[:2]
    # a corner is where two edges would meet: all edges together tell that better than these two
    point = None if job.kind_of(job.reference) == "corner" else place(job, fit, job.reference)

    def pose(parameters: FloatArray) -> FloatArray:
        in_face = motion.apply(reference) if point is None else point(parameters)
        slope_u, slope_v = parameters[1:PLANE_PARAMETERS]
        tilt = slope_v * face.axes[0] - slope_u * face.axes[1]
        return np.concatenate([lifted(face, parameters, in_face), tilt])

    values, jacobian = differentiated(fit, pose)
    covariance = jacobian @ fit.covariance @ jacobian.T
    by_edges = jacobian @ fit.edge_covariance @ jacobian.T
    if point is None:  # a corner, or hidden: its position follows from all features that are seen
        arm = np.array([[1.0, 0.0, -reference[1]], [0.0, 1.0, reference[0]]])
        in_rig = face.axes[:2].T @ arm
        covariance[:3, :3] += in_rig @ motion.covariance @ in_rig.T
        by_edges[:3, :3] += in_rig @ motion.edge_covariance @ in_rig.T
    about_normal = np.outer(face.normal, face.normal)
    covariance[3:, 3:] += motion.covariance[2, 2] * about_normal
    by_edges[3:, 3:] += motion.edge_covariance[2, 2] * about_normal
    target = Target(
        job=job.name,
        match=match,
        rig_from_part=transform(face.axes.T @ about_z(motion.turn), values[:3]),
        covariance=covariance,
        by_edges=by_edges,
        circles=(),
        epipolar_rms_px=_row_mismatch_px(fit, rectification),
    )
    return with_features(replace(target, measurements=measure_sizes(job, fit, ())), job, fit)


def _mean_support(curves: list[Curve], fit: PlaneFit) -> float:
    """Visible share of all edges in the camera that sees less of them."""
    lengths = {curve.name: curve.perimeter_mm for curve in curves}
    seen = sum(found.support * lengths[found.curve.name] for found in fit.fits)
    return float(np.min(seen) / sum(lengths.values()))


def _row_mismatch_px(fit: PlaneFit, rectification: Rectification) -> float:
    """Rms row difference of the edges whose row is well defined; NaN where there are none.

    The fitted plane absorbs differences along the rows, but not across them.
    """
    differences = []
    for found in fit.fits:
        if found.curve.kind != "edge":
            continue
        known = np.isfinite(found.points[0]).all(axis=1)
        level = _level(rectification, found.points[0][known][[0, -1]])
        if level > MEASURING.min_level:
            differences.append(found.mismatch_px / level)
    return float(np.sqrt(np.mean(np.square(differences)))) if differences else math.nan


def _has_rows(rectification: Rectification, job: Job, face: Face, motion: InPlaneMotion) -> bool:
    """Whether the part, as it lies, has an edge whose row should be well defined.

    If the rows are off by more than the search range, just these edges are not found, and the others show no
    contradiction.
    """
    for edge in job.edges:
        ends = np.stack([motion.apply(edge.start_mm[:2]), motion.apply(edge.end_mm[:2])])
        if _level(rectification, rectification.rig.left.project(face.to_rig(ends))) > MEASURING.min_level:
            return True
    return False


def _level(rectification: Rectification, ends_px: FloatArray) -> float:
    """Cosine of the angle between the rows and a line between two raw points (2, 2) of the left image."""
    ends = rectification.rectify_points("left", ends_px)
    along = ends[1] - ends[0]
    return abs(float(along[0])) / float(np.linalg.norm(along))
