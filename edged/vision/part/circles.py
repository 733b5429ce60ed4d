"""From a found shape to a part in space: circles, pose, covariance and reject reasons."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import median
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Match, Reject, Target
from edged.vision.curves.outlines import PLANE_PARAMETERS, SIZES, Curve, Face
from edged.vision.curves.params import BREAKS, FitParams
from edged.vision.curves.planefit import CircleGuess, CurveFit, PlaneFit, fit_circle, fit_plane
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import (
    Plane,
    about_z,
    angle_between,
    apply,
    cross,
    length_of,
    transform,
    unit,
)
from edged.vision.kernels.robust import mad_sigma
from edged.vision.part.consistency import distance_share, scale_deviation
from edged.vision.part.edgeidentity import is_doubtful
from edged.vision.part.frames import FoundCircle, by_edges_alone, circle_in_rig, circles_in_rig
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import LIGHT_PX, CircleFeature, Job
from edged.vision.part.measured import Evidence, MeasuredPart
from edged.vision.part.params import MEASURING
from edged.vision.part.prediction import match_in_raw, poses_of_face, predicted, seen_depth_mm, taught_points
from edged.vision.shape.params import EACH_EDGE_ITSELF
from edged.vision.shape.search import ShapeMatch


def measure(images: StereoImages, job: Job, match: ShapeMatch) -> MeasuredPart | None:
    """Measure one found part; None when the right camera does not show what the left one found.

    First the reference circle, for the plane of the face; then the other circles near the places predicted by
    the pose; then all that were found, together.
    """
    main = _reference(images, job, match)
    if main is None:
        return None
    start = _start_rotation(images, job, match, main.circle)
    fit = _together(images, job, main, _others(images, job, match, main, start), start)
    measured = None if fit is None else circle_in_rig(fit, job.reference)
    if fit is None or measured is None:
        return None
    main, radius_mm = measured, job.reference_circle.radius_mm
    if abs(main.circle.radius_mm - radius_mm) > 0.1 * radius_mm:
        return None
    start = _start_rotation(images, job, match, main.circle)
    mismatch_px, reject = _epipolar_rms(images.rectification, main.fit), Reject.NONE
    if match.ambiguous:
        reject = Reject.AMBIGUOUS_ROTATION
    seen_at = match_in_raw(images.rectification, match)
    agreeing, target = placed(job, seen_at, fit, start, mismatch_px, reject)
    if is_doubtful(images, job, main, agreeing, target.rig_from_part[:3, :3]):
        target = replace(target, reject=reject | Reject.AMBIGUOUS_EDGE)
    evidence = Evidence(
        main.fit.least_support,
        main.fit.rms_px,
        fit.row_shift_px,
        fit.row_sigma_px,
        *_growth(images, job, fit),
    )
    return MeasuredPart(target, evidence, tuple([circle.fit for circle in (main, *agreeing)]))


def placed(
    job: Job,
    match: Match,
    fit: PlaneFit,
    start: FloatArray,
    epipolar_rms_px: float = math.nan,
    reject: Reject = Reject.NONE,
) -> tuple[list[FoundCircle], Target]:
    """The circles of a fit, besides the reference, that agree with the part's rotation; and the target.

    start (3, 3) : rig_from_part's rotation, but for its turn about the normal.  epipolar_rms_px, reject : of
    the target.  Raises ValueError for a fit
    without the reference circle.
    """
    found, by_edges = circles_in_rig(fit), circle_in_rig(by_edges_alone(fit), job.reference)
    main = next((circle for circle in found if circle.circle.name == job.reference), None)
    if main is None or by_edges is None:
        raise ValueError("the reference circle was not measured")
    beside = [circle for circle in found if circle is not main]
    turned = _rotation(job, fit, main, beside, start)
    agreeing = [beside[index] for index in turned.agreeing]
    target = Target(
        job=job.name,
        match=match,
        rig_from_part=transform(turned.rotation, main.circle.centre_mm),
        covariance=_pose_covariance(main, turned.sigma),
        by_edges=_pose_covariance(by_edges, turned.sigma_by_edges),
        circles=_in_order(job, [main, *agreeing]),
        epipolar_rms_px=epipolar_rms_px,
        reject=reject,
    )
    return agreeing, target


def _growth(images: StereoImages, job: Job, fit: PlaneFit) -> tuple[float, float]:
    """Relative excess of the circles over the taught ones, and its sigma, including that of the depth."""
    same_rig = job.calibration_id == images.rig.calibration_id
    found = circles_in_rig(by_edges_alone(fit) if same_rig else fit)
    growth, sigma = scale_deviation(job, [circle.circle for circle in found])
    (main,) = [circle for circle in found if circle.circle.name == job.reference]
    known = distance_share(main.circle.centre_mm, main.pose_covariance[:3, :3])
    return growth, math.hypot(sigma, known)


def _reference(images: StereoImages, job: Job, match: ShapeMatch) -> FoundCircle | None:
    """The reference circle, measured on its own, from the start that both cameras agree with best.

    The foot of a thick disc's wall, a shadow or a chamfer beside the rim is an edge, too, and in one view it
    may be the stronger one over a third of the circle. From a poor start a tilted circle through both would
    be found; so each start is first fitted with the taught radius fixed.
    """
    best: FoundCircle | None = None
    for start in _starts(images, job, match):
        radius_mm = job.reference_circle.radius_mm
        guess = CircleGuess(start.centre_mm, start.normal, radius_mm, start.polarity, job.reference)
        fit = fit_circle(images.rig, images.raw, guess, start.params, fixed_radius=True)
        locked = None if fit is None else circle_in_rig(fit, job.reference)
        if locked is None or not _plausible(locked, start):
            continue
        if best is None or locked.fit.support.sum() > best.fit.support.sum():
            best = locked
        if best.fit.least_support > MEASURING.enough_support:
            break
    return best


def _plausible(found: FoundCircle, start: _Start) -> bool:
    moved = length_of(found.circle.centre_mm - start.centre_mm)
    return moved < 0.2 * found.circle.radius_mm and found.fit.least_support >= MEASURING.min_support


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """A start for the reference circle: centre and normal (3,), rig frame; polarity and fit parameters."""

    centre_mm: FloatArray
    normal: FloatArray
    polarity: int
    params: FitParams


def _starts(images: StereoImages, job: Job, match: ShapeMatch) -> Iterator[_Start]:
    """Likely places of the reference circle, best first.

    The match allows two poses in space. Where both fail, the plane of the outline is found by its rows in
    both images.
    """
    reference = job.reference_circle
    expected = _polarity(reference, match)
    if job.search.polarity in EACH_EDGE_ITSELF:
        expected = _seen_polarity(images, job, match)
    polarities = (expected,) if job.search.polarity == "same" else (expected, -expected)
    taught = taught_points(images.rectification, job)
    for pose in poses_of_face(images, taught.flat_mm, match.apply(taught.flat)):
        yield _Start(apply(pose, reference.centre_mm), -pose[:3, 2], expected, MEASURING.lock)
    rays = images.rays("left", predicted(images.rectification, job, match, reference.centre_mm[None]))
    for polarity in polarities:
        face = _face(images, job, match, polarity)
        if face is not None and np.isfinite(rays).all():
            yield _Start(face.meet(rays)[0], face.normal, polarity, MEASURING.wide_lock)


def _face_curves(job: Job, main: FoundCircle, rotation: FloatArray) -> tuple[Face, Curve]:
    """The plane of the reference circle with the axes of the part, and the circle at its origin."""
    circle = main.circle
    face = Face(circle.centre_mm, rotation.T)
    return face, Curve(
        job.reference, "circle", np.array([0.0, 0.0, circle.radius_mm]), main.fit.curve.polarity
    )


def _others(
    images: StereoImages, job: Job, match: ShapeMatch, main: FoundCircle, rotation: FloatArray
) -> list[CurveFit]:
    """The other circles of the face that lie where this rotation of the part puts them, in its axes.

    A circle that was taught off the face keeps its height.
    """
    face, first = _face_curves(job, main, rotation)
    # a bright table seen through a hole of a dark part, a lit wall: each contrast may be its own
    sign = 0 if job.search.polarity in EACH_EDGE_ITSELF else -1 if match.inverted else 1
    wanted = taught_beside(job, sign)
    if not wanted:
        return []
    fit = fit_plane(
        images.rig, images.raw, face, [first, *wanted.values()], MEASURING.other_lock, fixed_normal=True
    )
    if fit is None:
        return []
    limit = tolerance_mm(job)
    rise = float(face.from_rig(fit.face.origin)[2])
    found = []
    for other in fit.fits:
        if other.curve.name == job.reference:
            continue
        x, y, grown = other.curve.parameters - wanted[other.curve.name].parameters
        if x * x + y * y + rise * rise < limit * limit and -limit < grown < limit:
            found.append(other)
    return found


@lru_cache(maxsize=16)
def taught_beside(job: Job, sign: int) -> Mapping[str, Curve]:
    """The circles besides the reference by name, as taught, about the reference circle's centre.

    sign : 1 for the taught contrasts, -1 for opposite ones, 0 for any.
    """
    centre = job.reference_circle.centre_mm
    return {
        circle.name: Curve(
            circle.name,
            "circle",
            np.append((circle.centre_mm - centre)[:2], circle.radius_mm),
            sign * circle.polarity,
            height_mm=float(circle.centre_mm[2] - centre[2]),
        )
        for circle in job.circles
        if circle.name != job.reference
    }


def tolerance_mm(job: Job) -> float:
    """Largest deviation of a circle from its place, and of its radius."""
    return MEASURING.place_tolerance * job.reference_circle.radius_mm + MEASURING.place_margin_mm


def rival_turns(job: Job) -> list[float]:
    """Turns about the reference circle's axis that put one circle of the part in the place of another."""
    arms = np.array([c.centre_mm[:2] - job.reference_circle.centre_mm[:2] for c in job.circles])
    lengths = np.linalg.norm(arms, axis=1)
    tolerance = tolerance_mm(job)
    turns: list[float] = []
    for i, j in itertools.permutations(range(len(arms)), 2):
        if min(lengths[i], lengths[j]) < 2 * tolerance or abs(lengths[i] - lengths[j]) > tolerance:
            continue
        turn = float(np.arctan2(arms[j, 1], arms[j, 0]) - np.arctan2(arms[i, 1], arms[i, 0])) % (2 * np.pi)
        if all(angle_between(turn, other) * lengths[i] > tolerance for other in turns):
            turns.append(turn)
    return sorted(turns)[: MEASURING.max_rivals]


def _together(
    images: StereoImages, job: Job, main: FoundCircle, others: list[CurveFit], rotation: FloatArray
) -> PlaneFit | None:
    """Measure all circles in one common plane, now with free radii.  others : in the axes of the rotation."""
    face, first = _face_curves(job, main, rotation)
    curves = [first, *[other.curve for other in others]]
    fit = fit_plane(images.rig, images.raw, face, curves, MEASURING.together)
    if (fit is None or fit.fit_of(job.reference) is None) and others:  # one of the others may be at fault
        curves = [first]
        fit = fit_plane(images.rig, images.raw, face, curves, MEASURING.together)
    other_end_mm = 0.0 if fit is None else _other_end_mm(images, job, fit)
    if fit is not None and other_end_mm:
        fits = [replace(edge.curve, break_mm=max(other_end_mm, BREAKS.usual_mm)) for edge in fit.fits]
        fit = fit_plane(images.rig, images.raw, fit.face, fits, MEASURING.together)
    return fit


def _other_end_mm(images: StereoImages, job: Job, fit: PlaneFit) -> float:
    """Largest difference of a radius from its taught one if edges are broken; 0 for sharp edges.

    A larger difference than light can cause means that an edge is seen at the other end of its break than it
    was taught at. A common growth of all sizes is a doubt about the distance, so a smaller difference counts
    only where it remains without that growth. A reference beyond the tolerance of the job is no edge of this
    part.
    """
    taught = {circle.name: circle.radius_mm for circle in job.circles}
    found = [circle.circle for circle in circles_in_rig(by_edges_alone(fit))]
    sizes = np.array([taught[circle.name] for circle in found])
    apart = np.array([circle.radius_mm for circle in found]) - sizes
    allowed_mm = job.limits.radius_tolerance_mm
    of_reference = [circle.radius_mm for circle in found if circle.name == job.reference]
    if allowed_mm is not None and [r for r in of_reference if abs(r - taught[job.reference]) > allowed_mm]:
        return 0.0
    variances = np.array([circle.covariance[3, 3] for circle in found])
    sigmas = np.sqrt(variances)
    weighted = sizes / sigmas**2
    growth = float(weighted @ apart / (weighted @ sizes))
    pixel_mm = float(fit.face.origin[2]) / images.rectification.focal_px
    chance_mm = MEASURING.other_end * sigmas
    displaced = np.abs(apart) > np.maximum(chance_mm, MEASURING.displaced_px * pixel_mm)
    displaced |= np.abs(apart - growth * sizes) > np.maximum(chance_mm, LIGHT_PX * pixel_mm)
    return float(np.abs(apart).max()) if displaced.any() else 0.0


def _face(images: StereoImages, job: Job, match: ShapeMatch, polarity: int) -> Plane | None:
    """Plane of the part's face, from the reference circle's outline in both rectified images."""
    rectification = images.rectification
    points, normals = _predicted_outline(rectification, job, match)
    depth = seen_depth_mm(rectification, job, match)
    return find_plane(
        images,
        points,
        normals,
        polarity,
        (depth * (1 - MEASURING.depth_margin), depth * (1 + MEASURING.depth_margin)),
    )


def _predicted_outline(
    rectification: Rectification, job: Job, match: ShapeMatch
) -> tuple[FloatArray, FloatArray]:
    """Points (N, 2) and outward normals of the reference circle in the rectified left image, by the match."""
    points = match.apply(taught_points(rectification, job).outline)
    chords, normals = _chords(points), np.empty(points.shape)
    length = np.sqrt(chords[:, 0] ** 2 + chords[:, 1] ** 2)
    normals[:, 0], normals[:, 1] = chords[:, 1] / length, -chords[:, 0] / length
    away = points - points.sum(axis=0) / len(points)
    outward = normals[:, 0] * away[:, 0] + normals[:, 1] * away[:, 1]
    return points, normals * np.where(outward < 0, -1.0, 1.0)[:, None]


def _seen_polarity(images: StereoImages, job: Job, match: ShapeMatch) -> int:
    """+1 when most of the reference circle's contrast in the left image is brighter outside, else -1."""
    points, normals = _predicted_outline(images.rectification, job, match)
    _, slopes = edges_along_normals(images.rectified_left, points, normals, MEASURING.outline_reach_px, 0)
    strong = slopes[np.abs(slopes) >= job.search.min_contrast]  # False for NaN
    return 1 if strong.sum() > 0 else -1


def _polarity(circle: CircleFeature, match: ShapeMatch) -> int:
    return -circle.polarity if match.inverted else circle.polarity


def _start_rotation(images: StereoImages, job: Job, match: ShapeMatch, main: Circle3D) -> FloatArray:
    """Rotation of rig_from_part from the match alone: the part's axes projected onto the measured face."""
    face, taught = Plane.through(main.centre_mm, main.normal), taught_points(images.rectification, job)
    space = face.meet(images.rays("left", match.apply(taught.tips)))
    return _frame(main.normal, space[0] - space[1], space[2] - space[3])


def _frame(normal: FloatArray, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    """Columns x, y, z: z away from the cameras, x the mean of what both directions in the face give."""
    z = -normal
    x = unit(along_x) + cross(unit(along_y), z)
    x = unit(x - (x @ z) * z)
    frame = np.empty((3, 3))
    frame[:, 0], frame[:, 1], frame[:, 2] = x, cross(z, x), z
    return frame


class _Turned(NamedTuple):
    """rotation (3, 3) rig_from_part; sigma about the normal, rad, and the sigma from the edges alone.

    agreeing : indices of the circles that agree.
    """

    rotation: FloatArray
    sigma: float
    sigma_by_edges: float
    agreeing: list[int]


def _rotation(
    job: Job, fit: PlaneFit, main: FoundCircle, others: list[FoundCircle], start: FloatArray
) -> _Turned:
    """Turn the start rotation about the normal until the circles lie where they were taught.

    A part with one circle, or only concentric ones, keeps the rotation of the match. The edges of each circle
    err independently; an error of the rig turns all of them alike.
    """
    arms = _arms(job)
    indices = [index for index, other in enumerate(others) if other.circle.name in arms]
    concentric = [index for index, other in enumerate(others) if other.circle.name not in arms]
    if not indices:
        # the shape's own precision: a few hundredths of a pixel at the rim
        sigma = 0.05 * job.reference_circle.radius_mm / job.shape.radius_px
        return _Turned(start, sigma, sigma, concentric)
    in_face = fit.face.axes[:2] @ start[:, :2]
    sizes = [SIZES[found.curve.kind] for found in fit.fits]
    places = itertools.accumulate(sizes, initial=PLANE_PARAMETERS)
    firsts = dict(zip([found.curve.name for found in fit.fits], places, strict=False))
    values, rows, angles = np.empty(len(indices)), np.zeros((len(indices), len(fit.covariance))), []
    for row, index in zip(rows, indices, strict=True):
        circle = others[index].circle
        arm, across_arm, lever = arms[circle.name]
        seen = (start.T @ (circle.centre_mm - main.circle.centre_mm))[:2]
        angles.append(math.atan2(arm[0] * seen[1] - arm[1] * seen[0], arm @ seen))
        across = in_face @ across_arm / lever**2
        for name, sign in ((circle.name, 1.0), (job.reference, -1.0)):
            row[firsts[name] : firsts[name] + 2] += sign * across
    weights = 1 / np.maximum(np.einsum("ij,jk,ik->i", rows, fit.edge_covariance, rows), 1e-10)
    values[:] = angles
    middle = median(angles)
    spread = max(mad_sigma(values - middle), 2e-4)
    good = np.abs(values - middle) < 4 * spread
    values, weights, total = values[good], weights[good], weights[good].sum()
    turn = float((values * weights).sum() / total)
    chi2 = float((weights * (values - turn) ** 2).sum()) / max(len(values) - 1, 1)
    gain = weights @ rows[good] / total
    # no result is better than the smallest sigma that is assumed for one hole
    by_edges = max(chi2, 1.0) * max(float(gain @ fit.edge_covariance @ gain), 1 / float(total))
    by_rig = float(gain @ (fit.covariance - fit.edge_covariance) @ gain)
    agreeing = [index for index, use in zip(indices, good, strict=True) if use]
    return _Turned(
        start @ about_z(turn),
        math.sqrt(by_edges + max(by_rig, 0.0)),
        math.sqrt(by_edges),
        sorted(concentric + agreeing),
    )


@lru_cache(maxsize=16)
def _arms(job: Job) -> dict[str, tuple[FloatArray, FloatArray, float]]:
    """Arm (2,) from the reference circle to each circle, the same turned by 90°, and its length, by name.

    Without those that are too short to tell a rotation.
    """
    reference, arms = job.place_of(job.reference), {}
    for circle in job.circles:
        arm = (circle.centre_mm - reference)[:2]
        lever = math.hypot(*arm.tolist())
        if lever >= MEASURING.short_arm * job.reference_circle.radius_mm:
            arms[circle.name] = arm, np.array([-arm[1], arm[0]]), lever
    return arms


def _pose_covariance(main: FoundCircle, sigma_turn: float) -> FloatArray:
    """Covariance (6, 6) of position (mm) and rotation vector (rad, rig axes)."""
    covariance = main.pose_covariance.copy()
    normal = main.circle.normal
    covariance[3:, 3:] += sigma_turn**2 * (normal[:, None] * normal)
    return covariance


def _epipolar_rms(rectification: Rectification, fit: CurveFit) -> float:
    """Rms row difference of the reference circle's stretches, left against right.

    It is taken over stretches, not single edge points: noise is no mismatch. Both cameras measure the same
    points of the circle only up to a motion along the edge, so edges that run down the image are left out.
    """
    both = np.minimum(*fit.weights) > 0.1
    shown = both.nonzero()[0]
    if len(shown) < 8:
        return float("nan")
    right = rectification.rectify_points("right", fit.points[1])
    rows = rectification.rectify_points("left", fit.points[0][both])[:, 1] - right[both, 1]
    along, down = _chords(right)[both].T
    # the edge runs down the image: its row is not defined by it
    vague = np.abs(down / np.sqrt(along**2 + down**2)) > 0.7
    usable = ~vague & np.isfinite(rows)
    stretch = shown[usable] // MEASURING.row_stretch
    if len(stretch) < MEASURING.min_rows:
        return float("nan")
    count = np.bincount(stretch)
    many = count[count > 0]
    means = np.bincount(stretch, rows[usable])[count > 0] / many
    return math.sqrt(float((means**2 * many).sum() / many.sum()))


def _chords(points: FloatArray) -> FloatArray:
    """(N, 2) chords of a closed line (N, 2), from the point before each point to the one after it."""
    chords = np.empty_like(points)
    chords[1:-1] = points[2:] - points[:-2]
    chords[0], chords[-1] = points[1] - points[-1], points[0] - points[-2]
    return chords


def _in_order(job: Job, found: list[FoundCircle]) -> tuple[Circle3D, ...]:
    by_name = {circle.circle.name: circle.circle for circle in found}
    return tuple([by_name[circle.name] for circle in job.circles if circle.name in by_name])
