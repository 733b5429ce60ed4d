"""From a found shape to a part in space: circles, pose, covariance, and what speaks against it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import median

import cv2
import numpy as np

from edged.domain import Circle3D, FloatArray, Match, Reject, Target
from edged.vision.curves.circle import CircleFit, CircleFitParams, CircleGuess, FaceFit
from edged.vision.curves.circlefit import fit_circle, fit_face
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.plane import Plane
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import about_z, apply, cross, rotation_matrix, transform, unit
from edged.vision.part.consistency import growth_of, row_shift_px
from edged.vision.part.edgeidentity import is_doubtful
from edged.vision.part.initialplane import find_plane
from edged.vision.part.job import CircleFeature, Job
from edged.vision.part.measured import Evidence, Images, Measured
from edged.vision.part.prediction import predicted
from edged.vision.part.prediction import rays as rays_of
from edged.vision.shape.search import ShapeMatch

DEPTH_MARGIN = 0.05
"""The size of the match tells the depth to about 1 %; a tilt and a bad scale are allowed for."""
OUTLINE_POINTS = 240
OUTLINE_REACH_PX = 4.0
EACH_EDGE_ITSELF = ("local", "ignore")
"""Polarity modes of the search in which an edge may have either sign."""
PLACE_TOLERANCE = 0.02
"""A feature farther from its place than this share of the part's size is another edge."""
PLACE_MARGIN_MM = 0.1
MAX_RIVALS = 12
MIN_SUPPORT = 0.15
"""Share of the reference circle that each camera must show to be measured at all; the job asks for more."""
MIN_OTHER_SUPPORT = 0.4
ENOUGH_SUPPORT = 0.8
"""Of a start that both cameras agree with this much there is no better one."""
PNP_POINTS = 16
LOCK_PARAMS = CircleFitParams(reach_px=(3.0, 2.5, 2.0, 2.0), repeats=0)
WIDE_LOCK_PARAMS = CircleFitParams(reach_px=(6.0, 4.0, 2.5, 2.0), repeats=0)
OTHER_PARAMS = CircleFitParams(reach_px=(3.0, 2.0), repeats=0)
TOGETHER_PARAMS = CircleFitParams(reach_px=(2.0,))


def measure(images: Images, rectification: Rectification, job: Job, match: ShapeMatch) -> Measured | None:
    """Measure one found part; None when the right camera does not show what the left one found.

    First the reference circle, for the plane of the face; then the other circles near the places where
    the pose puts them; then all that were found, together.
    """
    main = _reference(images, rectification, job, match)
    if main is None:
        return None
    start = _start_rotation(rectification, job, match, main)
    turn, others, ambiguous = _decided(images, rectification, job, match, main, start)
    together = _together(images, rectification, job, main, others)
    if together is None:
        return None
    main, others = together.first, [fit for fit in together.others if fit is not None]
    if abs(main.circle.radius_mm - job.reference_circle.radius_mm) > 0.1 * job.reference_circle.radius_mm:
        return None
    start = _start_rotation(rectification, job, match, main) @ about_z(turn)
    rotation, sigma_turn, used = _rotation(job, main, others, start)
    rig_from_part = np.eye(4)
    rig_from_part[:3, :3] = rotation
    rig_from_part[:3, 3] = main.circle.centre_mm
    fits = (main, *(others[index] for index in used))
    origin = rectification.raw_points("left", np.array([[match.x_px, match.y_px]]))[0]
    circles = tuple(_in_order(job, fits))
    target = Target(
        job=job.name,
        match=Match(
            float(origin[0]), float(origin[1]), match.angle_rad, match.scale_x, match.scale_y, match.score
        ),
        rig_from_part=rig_from_part,
        covariance=_pose_covariance(main, sigma_turn),
        circles=circles,
        epipolar_rms_px=_epipolar_rms(rectification, main),
        reject=Reject.AMBIGUOUS_ROTATION if ambiguous else Reject.NONE,
    )
    if is_doubtful((images.left, images.right), rectification, job, main, fits[1:], rotation):
        target = replace(target, reject=target.reject | Reject.AMBIGUOUS_EDGE)
    evidence = Evidence(
        min(main.support_left, main.support_right),
        main.rms_px,
        row_shift_px(rectification, main),
        *growth_of(job, circles),
    )
    return Measured(target, evidence, fits)


def _reference(images: Images, rectification: Rectification, job: Job, match: ShapeMatch) -> CircleFit | None:
    """The reference circle, measured on its own, from the start that both cameras agree with best.

    The foot of a thick disc's wall, a shadow or a chamfer beside the rim is an edge, too, and in one view it
    may be the stronger one over a third of the circle. From a poor start a tilted circle through both
    would be found; so each start locks on with the taught radius first.
    """
    best: CircleFit | None = None
    for start in _starts(images, rectification, job, match):
        locked = fit_circle(
            rectification.rig,
            images.left,
            images.right,
            start.guess,
            start.normal,
            start.params,
            fixed_radius=True,
        )
        if locked is None or not _plausible(locked, start):
            continue
        if best is None or _agreement(locked) > _agreement(best):
            best = locked
        if min(best.support_left, best.support_right) > ENOUGH_SUPPORT:
            break
    return best


def _agreement(fit: CircleFit) -> float:
    return fit.support_left + fit.support_right


def _plausible(fit: CircleFit, start: _Start) -> bool:
    moved = float(np.linalg.norm(fit.circle.centre_mm - start.guess.centre_mm))
    return moved < 0.2 * start.guess.radius_mm and min(fit.support_left, fit.support_right) >= MIN_SUPPORT


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Where the reference circle may be, and how far to look around."""

    guess: CircleGuess
    normal: FloatArray
    params: CircleFitParams


def _starts(images: Images, rectification: Rectification, job: Job, match: ShapeMatch) -> Iterator[_Start]:
    """Likely places of the reference circle, best first.

    The match is a perspective view of a known plane: it has two poses in space (T. Collins and A. Bartoli,
    "Infinitesimal Plane-Based Pose Estimation", IJCV 2014), good to a few hundredths of a mm in depth and
    some tenths of a degree. Where they fail, the right image tells by itself where the outline's plane is.
    """
    reference = job.reference_circle
    expected = _polarity(reference, match)
    if job.search.polarity in EACH_EDGE_ITSELF:
        expected = _seen_polarity(images, rectification, job, match)
    polarities = (expected,) if job.search.polarity == "same" else (expected, -expected)
    for pose in _plane_poses(rectification, job, match):
        centre = apply(pose, reference.centre_mm)
        guess = CircleGuess(reference.name, centre, reference.radius_mm, expected)
        yield _Start(guess, -pose[:3, 2], LOCK_PARAMS)
    rays = rays_of(rectification, predicted(rectification, job, match, reference.centre_mm[None]))
    for polarity in polarities:
        face = _face(images, rectification, job, match, polarity)
        if face is not None and np.isfinite(rays).all():
            guess = CircleGuess(reference.name, face.meet(rays)[0], reference.radius_mm, polarity)
            yield _Start(guess, face.normal, WIDE_LOCK_PARAMS)


def _plane_poses(rectification: Rectification, job: Job, match: ShapeMatch) -> list[FloatArray]:
    """The rig_from_part (4, 4) under which the part's face looks like the match; better one first."""
    flat = _outline(job.reference_circle, PNP_POINTS)
    flat[:, 2] = 0.0
    rays = rays_of(rectification, predicted(rectification, job, match, flat))
    if not np.isfinite(rays).all():
        return []
    count, turns, places, _ = cv2.solvePnPGeneric(
        flat, np.ascontiguousarray(rays[:, :2]), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    poses = []
    for vectors in zip(turns[:count], places[:count], strict=True):
        turn, place = (np.asarray(vector, dtype=np.float64).ravel() for vector in vectors)
        pose = transform(rotation_matrix(turn), place)
        if np.isfinite(pose).all() and pose[2, 3] > 0 and pose[2, 2] > 0:  # a face turned away is none
            poses.append(pose)
    return poses


def _others(
    images: Images,
    rectification: Rectification,
    job: Job,
    match: ShapeMatch,
    main: CircleFit,
    rotation: FloatArray,
) -> list[CircleFit]:
    """The other circles of the face that are where this rotation of the part puts them."""
    wanted = [circle for circle in job.circles if circle.name != job.reference]
    if not wanted:
        return []
    origin = main.circle.centre_mm - rotation @ job.reference_circle.centre_mm
    places = {circle.name: origin + rotation @ circle.centre_mm for circle in wanted}
    guesses = [CircleGuess(main.circle.name, main.circle.centre_mm, main.circle.radius_mm, main.polarity)]
    for circle in wanted:
        # a bright table seen through a hole of a dark part, a lit wall: each contrast may be its own
        polarity = 0 if job.search.polarity in EACH_EDGE_ITSELF else _polarity(circle, match)
        guesses.append(CircleGuess(circle.name, places[circle.name], circle.radius_mm, polarity))
    face = fit_face(
        rectification.rig,
        images.left,
        images.right,
        guesses,
        main.circle.normal,
        OTHER_PARAMS,
        fixed_normal=True,
    )
    if face is None:
        return []
    limit = PLACE_TOLERANCE * job.reference_circle.radius_mm + PLACE_MARGIN_MM
    found = []
    for circle, fit in zip(wanted, face.others, strict=True):
        if fit is None or min(fit.support_left, fit.support_right) < MIN_OTHER_SUPPORT:
            continue
        near = np.linalg.norm(fit.circle.centre_mm - places[circle.name]) < limit
        if near and abs(fit.circle.radius_mm - circle.radius_mm) < limit:
            found.append(fit)
    return found


def _decided(
    images: Images,
    rectification: Rectification,
    job: Job,
    match: ShapeMatch,
    main: CircleFit,
    start: FloatArray,
) -> tuple[float, list[CircleFit], bool]:
    """The turn about the normal against the match, the other circles there, and whether it is in doubt.

    Where the search could not tell nearly equal rotations apart, the circles can: at a wrong rotation one of
    them has another size, or none is there.
    """
    others = _others(images, rectification, job, match, main, start)
    if not match.ambiguous:
        return 0.0, others, False
    turns = _rival_turns(job)
    if any(_maps_on_itself(job, turn) for turn in turns):
        # they are the same circles under other names: one half hidden may count under one and not the other
        return 0.0, others, True
    if turns and len(others) == len(job.circles) - 1:
        return 0.0, others, False  # each lies where it was taught, in its size
    best, best_turn, rival_count = others, 0.0, 0
    for turn in turns:
        rivals = _others(images, rectification, job, match, main, start @ about_z(turn))
        if len(rivals) > len(best):
            best, best_turn, rival_count = rivals, turn, len(best)
        else:
            rival_count = max(rival_count, len(rivals))
    return best_turn, best, len(best) == rival_count or not turns


def _rival_turns(job: Job) -> list[float]:
    """Turns about the reference circle's axis that lay one circle of the part on another one's place."""
    arms = np.array([c.centre_mm[:2] - job.reference_circle.centre_mm[:2] for c in job.circles])
    lengths = np.linalg.norm(arms, axis=1)
    tolerance = PLACE_TOLERANCE * job.reference_circle.radius_mm + PLACE_MARGIN_MM
    turns: list[float] = []
    for i, j in itertools.permutations(range(len(arms)), 2):
        if min(lengths[i], lengths[j]) < 2 * tolerance or abs(lengths[i] - lengths[j]) > tolerance:
            continue
        turn = float(np.arctan2(arms[j, 1], arms[j, 0]) - np.arctan2(arms[i, 1], arms[i, 0])) % (2 * np.pi)
        if all(abs((turn - other + np.pi) % (2 * np.pi) - np.pi) * lengths[i] > tolerance for other in turns):
            turns.append(turn)
    return sorted(turns)[:MAX_RIVALS]


def _maps_on_itself(job: Job, turn: float) -> bool:
    """Whether this turn about the reference circle's axis lays each circle on one of its size."""
    centre = job.reference_circle.centre_mm
    limit = PLACE_TOLERANCE * job.reference_circle.radius_mm + PLACE_MARGIN_MM
    return all(
        any(
            np.linalg.norm(centre + about_z(turn) @ (circle.centre_mm - centre) - other.centre_mm) < limit
            and abs(circle.radius_mm - other.radius_mm) < limit
            for other in job.circles
        )
        for circle in job.circles
    )


def _together(
    images: Images, rectification: Rectification, job: Job, main: CircleFit, others: list[CircleFit]
) -> FaceFit | None:
    """Measure all circles in one common plane, now with free radii.

    A circle that was taught off the face keeps that distance.
    """
    normal = main.circle.normal
    heights = {circle.name: float(circle.centre_mm[2]) for circle in job.circles}
    guesses = [CircleGuess(main.circle.name, main.circle.centre_mm, main.circle.radius_mm, main.polarity)]
    for fit in others:
        off = float(normal @ (fit.circle.centre_mm - main.circle.centre_mm))
        wanted = heights[main.circle.name] - heights[fit.circle.name]  # part z points away from the cameras
        centre = fit.circle.centre_mm + (wanted - off) * normal
        guesses.append(CircleGuess(fit.circle.name, centre, fit.circle.radius_mm, fit.polarity))
    rig, left, right = rectification.rig, images.left, images.right
    face = fit_face(rig, left, right, guesses, normal, TOGETHER_PARAMS)
    if face is None and others:  # one of the others may be at fault
        face = fit_face(rig, left, right, guesses[:1], normal, TOGETHER_PARAMS)
    return face


def _outline(circle: CircleFeature, count: int) -> FloatArray:
    phase = np.arange(count) * (2 * np.pi / count)
    ring = np.column_stack([np.cos(phase), np.sin(phase), np.zeros(count)])
    return np.asarray(circle.centre_mm + circle.radius_mm * ring)


def _face(
    images: Images, rectification: Rectification, job: Job, match: ShapeMatch, polarity: int
) -> Plane | None:
    """The plane of the part's face, from the reference circle's outline in both rectified images."""
    points, normals = _predicted_outline(rectification, job, match)
    taught_depth = float((rectification.rectified_from_left @ job.rig_from_part[:3, 3])[2])
    depth = taught_depth / np.sqrt(match.scale_x * match.scale_y)
    return find_plane(
        rectification,
        images.rectified_left,
        images.rectified_right,
        points,
        normals,
        polarity,
        (depth * (1 - DEPTH_MARGIN), depth * (1 + DEPTH_MARGIN)),
    )


def _predicted_outline(
    rectification: Rectification, job: Job, match: ShapeMatch
) -> tuple[FloatArray, FloatArray]:
    """Points (N, 2) and outward normals of the reference circle in the rectified left image, by the match."""
    points = predicted(rectification, job, match, _outline(job.reference_circle, OUTLINE_POINTS))
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    normals = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outward = np.sum(normals * (points - points.mean(axis=0)), axis=1)
    return points, normals * np.where(outward < 0, -1.0, 1.0)[:, None]


def _seen_polarity(images: Images, rectification: Rectification, job: Job, match: ShapeMatch) -> int:
    """+1 when most of the reference circle's contrast in the left image is brighter outside, else -1."""
    points, normals = _predicted_outline(rectification, job, match)
    _, slopes = edges_along_normals(images.rectified_left, points, normals, OUTLINE_REACH_PX, 0)
    strong = np.nan_to_num(slopes)[np.abs(np.nan_to_num(slopes)) >= job.search.min_contrast]
    return 1 if strong.sum() > 0 else -1


def _polarity(circle: CircleFeature, match: ShapeMatch) -> int:
    return -circle.polarity if match.inverted else circle.polarity


def _start_rotation(rectification: Rectification, job: Job, match: ShapeMatch, main: CircleFit) -> FloatArray:
    """rig_from_part rotation from the match alone: the part's x axis, drawn on the measured face."""
    normal = main.circle.normal
    face = Plane(normal, float(normal @ main.circle.centre_mm))
    radius = job.reference_circle.radius_mm
    tips = np.array([[radius, 0.0, 0.0], [-radius, 0.0, 0.0], [0.0, radius, 0.0], [0.0, -radius, 0.0]])
    space = face.meet(rays_of(rectification, predicted(rectification, job, match, tips)))
    return _frame(main.circle.normal, space[0] - space[1], space[2] - space[3])


def _frame(normal: FloatArray, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    """Columns x, y, z with z away from the cameras and x as both directions in the face want it."""
    z = -normal
    x = unit(along_x) + cross(unit(along_y), z)
    x = unit(x - (x @ z) * z)
    return np.column_stack([x, cross(z, x), z])


def _rotation(
    job: Job, main: CircleFit, others: list[CircleFit], start: FloatArray
) -> tuple[FloatArray, float, list[int]]:
    """Turn the start rotation about the normal until the circles lie where they were taught.

    Returns the rotation, its sigma about the normal in rad, and the indices of the circles that agree.
    A part with one circle, or only concentric ones, keeps the shape's rotation.
    """
    taught = {circle.name: circle.centre_mm for circle in job.circles}
    reference = taught[job.reference]
    angles, variances, indices = [], [], []
    for index, fit in enumerate(others):
        arm = (taught[fit.circle.name] - reference)[:2]
        lever = float(np.linalg.norm(arm))
        if lever < 0.15 * job.reference_circle.radius_mm:
            continue
        seen = (start.T @ (fit.circle.centre_mm - main.circle.centre_mm))[:2]
        angles.append(math.atan2(arm[0] * seen[1] - arm[1] * seen[0], arm @ seen))
        in_face = (
            start[:, :2].T @ (fit.circle.covariance[:3, :3] + main.circle.covariance[:3, :3]) @ start[:, :2]
        )
        across = np.array([-arm[1], arm[0]]) / lever
        variances.append(float(across @ in_face @ across) / lever**2)
        indices.append(index)
    concentric = [index for index in range(len(others)) if index not in indices]
    if not angles:
        # the shape's own precision: a few hundredths of a pixel at the rim
        return start, 0.05 * job.reference_circle.radius_mm / job.shape.radius_px, concentric
    values, weights = np.array(angles), 1 / np.maximum(np.array(variances), 1e-10)
    middle = median(angles)
    spread = max(1.4826 * median(abs(angle - middle) for angle in angles), 2e-4)
    good = np.abs(values - middle) < 4 * spread
    turn = float(np.sum(values[good] * weights[good]) / np.sum(weights[good]))
    chi2 = float(np.sum(weights[good] * (values[good] - turn) ** 2)) / max(int(good.sum()) - 1, 1)
    sigma = float(np.sqrt(max(chi2, 1.0) / np.sum(weights[good])))
    agreeing = [index for index, use in zip(indices, good, strict=True) if use]
    return start @ about_z(turn), sigma, sorted(concentric + agreeing)


def _pose_covariance(main: CircleFit, sigma_turn: float) -> FloatArray:
    """(6, 6) of position (mm) and rotation vector (rad, rig axes)."""
    u, v = main.axes
    normal = cross(u, v)
    # a tilt about u moves the point at v up the normal: rotation vector +u; about v, the point at u: -v
    spread = np.zeros((6, 6))
    spread[:3, :3] = np.eye(3)
    spread[3:, 3], spread[3:, 4], spread[3:, 5] = u, -v, normal
    inner = np.zeros((6, 6))
    inner[:5, :5] = main.covariance[:5, :5]
    inner[5, 5] = sigma_turn**2
    return np.asarray(spread @ inner @ spread.T)


def _epipolar_rms(rectification: Rectification, fit: CircleFit) -> float:
    """Rms row difference of the reference circle's edge points, left against right.

    Both cameras measure the same points of the circle only up to a motion along the edge; the part of the
    row difference that a motion along the edge can explain is taken out.
    """
    both = (fit.weights_left > 0.1) & (fit.weights_right > 0.1)
    if both.sum() < 8:
        return float("nan")
    right = rectification.rectify_points("right", fit.points_right)
    rows = rectification.rectify_points("left", fit.points_left[both])[:, 1] - right[both, 1]
    tangent = (np.roll(right, -1, axis=0) - np.roll(right, 1, axis=0))[both]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    vague = np.abs(tangent[:, 1]) > 0.7  # the edge runs down the image: its row is not defined by it
    usable = rows[~vague & np.isfinite(rows)]
    return float(np.sqrt(np.mean(usable**2))) if len(usable) >= 4 else float("nan")


def _in_order(job: Job, fits: tuple[CircleFit, ...]) -> list[Circle3D]:
    by_name = {fit.circle.name: fit.circle for fit in fits}
    return [by_name[circle.name] for circle in job.circles if circle.name in by_name]
