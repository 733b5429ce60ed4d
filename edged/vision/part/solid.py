"""Thick parts and parts of several heights: measured as one rigid whole, from a locked pose.

Walls, edge breaks and shadows give a curve a second edge beside it over some of its length, and invert its
contrast elsewhere. So each stretch of each curve is examined from the locked pose, in each camera separately:
which sign its edge has, and whether it has a rival. A stretch is not measured where the picture does not tell
which of two edges is the right one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from edged.domain.arrays import B8, SIDES, FloatArray, Image
from edged.domain.measurement import Match, Reject, Target
from edged.vision.curves.outlines import Curve, Face, project_outline
from edged.vision.curves.params import FitParams
from edged.vision.curves.planefit import PlaneFit, fit_plane
from edged.vision.edges.candidates import candidates
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, transform, turn_about_z, turn_between, turned_to, wrapped
from edged.vision.part.body import PartBody
from edged.vision.part.circles import rival_turns
from edged.vision.part.consistency import distance_share
from edged.vision.part.curvevisibility import curve_visibility
from edged.vision.part.frames import circles_in_rig, measure_sizes, with_features
from edged.vision.part.initialpose import start_pose
from edged.vision.part.job import Job
from edged.vision.part.measured import Evidence, MeasuredPart
from edged.vision.part.params import MEASURING, SOLID
from edged.vision.part.pose import circle_curve, edge_curve, slot_curve
from edged.vision.part.prediction import match_in_raw, poses_of_match
from edged.vision.part.rigidlock import (
    TURN_HELD,
    Lock,
    lock,
    quick_agreement,
    spread,
)
from edged.vision.part.tiltedstarts import tilted_starts
from edged.vision.shape.search import ShapeMatch


@lru_cache(maxsize=16)  # a job stays the same from image to image
def curves_of(job: Job) -> tuple[Curve, ...]:
    """All features of a job as curves of its part frame."""
    return (
        *(circle_curve(circle, free_polarity=False) for circle in job.circles),
        *(edge_curve(edge, free_polarity=False) for edge in job.edges),
        *(slot_curve(slot, free_polarity=False) for slot in job.slots),
    )


def measure_solid(images: StereoImages, job: Job, match: ShapeMatch) -> MeasuredPart | Reject:
    """Measure a found part as one rigid whole; the reason when that is not possible.

    Its pose comes from all curves together. Its sizes do not: each curve that has enough edges without rivals
    is measured again, freely, and the others have no size.
    """
    locked = best_lock(images, job, match)
    if locked is None:
        return Reject.LEFT_RIGHT_MISMATCH
    best, margin = locked
    whole = fitted(images, job, best.pose)
    if whole is None:
        return Reject.FEW_EDGES
    whole, alone = whole.with_breaks(images)
    fit, rigid = whole.fit, whole.fit.rigid
    if rigid is None:
        return Reject.FEW_EDGES
    in_raw = match_in_raw(images.rectification, match)
    target = target_of(job, in_raw, fit)
    reject = Reject.NONE
    if margin < SOLID.min_margin:
        reject |= Reject.AMBIGUOUS_ROTATION
    fitted_ones = {found.name for found in fit.fits}
    circles = sum(
        curve.kind == "circle" and curve.name in fitted_ones and share >= SOLID.plain_share
        for curve, share in zip(whole.curves, best.by_curve.mean(axis=0), strict=True)
    )
    shown = [curve for curve in whole.curves if curve.name in whole.shown]
    shown_circles = sum(curve.kind == "circle" for curve in shown)
    fewest = max(SOLID.min_found * len(shown), min(SOLID.min_curves, SOLID.min_found * len(whole.curves)))
    if len(fit.fits) < fewest or circles < SOLID.min_found * shown_circles:
        reject |= Reject.FEW_EDGES
    if alone is not None:
        target = replace(target, circles=tuple(circle.circle for circle in circles_in_rig(alone)))
        target = with_features(target, job, alone)
    target = replace(target, reject=reject, measurements=measure_sizes(job, alone, target.circles))
    by_edges = fit.by_edges() if job.calibration_id == images.rig.calibration_id else fit
    assert by_edges.rigid is not None
    place = target_of(job, in_raw, by_edges)
    evidence = Evidence(
        best.share,
        float(np.sqrt(np.mean([found.rms_px**2 for found in fit.fits]))),
        fit.row_shift_px,
        fit.row_sigma_px,
        rigid.growth,
        math.hypot(
            math.sqrt(max(float(by_edges.rigid.covariance[6, 6]), 0.0)),
            distance_share(place.position_mm, place.covariance[:3, :3]),
        ),
    )
    return MeasuredPart(target, evidence, fit.fits)


def best_lock(images: StereoImages, job: Job, match: ShapeMatch) -> tuple[Lock, float] | None:
    """The pose that most of the part agrees with, and its lead in agreement over any other turn.

    The lead is 0 where several turns agree and the best is not the one that the search decided on; and where
    the search could not tell turns apart and the features offer none to try. None where too little agrees.
    """
    curves = curves_of(job)
    best = _best_of(images, curves, _starts(images, job, match))
    if best is None or (best.share < SOLID.good_share and not _tells_turn(job, best)):
        poses = list(_starts(images, job, match))
        best = _best_of(images, curves, _turned(images, curves, job, poses), best)
    if job.tilt_rad is not None and (
        best is None or best.share < SOLID.min_camera_share or best.mean < SOLID.min_share
    ):
        best = _leaning(images, job, match, job.tilt_rad)
    if best is None or best.share < SOLID.poor_share:
        return None
    found, motions, roundish = [best], _rival_motions(job), _is_roundish(job)
    if roundish and not _tells_turn(job, best):
        others = [lock(images, curves, pose) for pose in _turned(images, curves, job, [best.pose])]
        found += [candidate for candidate in others if candidate is not None]
        best = max(found, key=lambda candidate: candidate.mean)
    for motion in motions:
        turned = best.pose @ motion
        if quick_agreement(images, curves, turned) > best.mean - SOLID.rival_share:
            candidate = lock(images, curves, turned, rival_of=best)
            found += [] if candidate is None else [candidate]
    found.sort(key=lambda candidate: -candidate.mean)
    best = found[0]
    if best.share < SOLID.min_camera_share or best.mean < SOLID.min_share:
        return None
    if match.ambiguous and not roundish and not motions:
        return best, 0.0
    other = next(
        (candidate for candidate in found if turn_between(candidate.pose, best.pose) > SOLID.same_turn_rad),
        None,
    )
    if other is None:
        return best, 1.0
    # a single curve may tell turns apart, and on a face full of edges it may agree by chance: 0.85 was seen
    is_open = match.ambiguous or _is_turned(images, job, match, best)
    return best, 0.0 if is_open else best.mean - other.mean


def _leaning(images: StereoImages, job: Job, match: ShapeMatch, tilt_rad: float) -> Lock | None:
    """The lock that most of the part agrees with, from poses with other leans than that of the match."""
    curves, main = curves_of(job), _main_face(job)
    by_rows = start_pose(images, job, match, main)
    starts = _by_match(images, job, match, main)[:1] + ([] if by_rows is None else [by_rows])
    if _is_roundish(job):  # first the circles about the axis, then the turn
        axis = _about_axis(job)
        leant = tilted_starts(images, axis, starts, tilt_rad, TURN_HELD)
        locks = [lock(images, axis, pose, unknowns=TURN_HELD) for pose in leant]
        rims = sorted(
            (candidate for candidate in locks if candidate is not None), key=lambda candidate: -candidate.mean
        )
        poses = _turned(images, curves, job, [candidate.pose for candidate in rims[:1]])
    else:
        poses = tilted_starts(images, curves, starts, tilt_rad)
    best = _best_of(images, curves, poses)
    return best if best is not None and best.mean >= SOLID.leant_share else None


def _about_axis(job: Job) -> list[Curve]:
    """The circles concentric with the reference."""
    centre = job.place_of(job.reference)[:2]
    return [
        curve
        for curve in curves_of(job)
        if curve.kind == "circle"
        and float(np.linalg.norm(curve.parameters[:2] - centre)) < SOLID.concentric * curve.parameters[2]
    ]


def _best_of(
    images: StereoImages,
    curves: Sequence[Curve],
    poses: Iterable[FloatArray],
    best: Lock | None = None,
) -> Lock | None:
    """The lock that most of the part agrees with, from several starts; the first good one ends the search."""
    for pose in poses:
        candidate = lock(images, curves, pose)
        if candidate is not None and (best is None or candidate.mean > best.mean):
            best = candidate
        if candidate is not None and candidate.share >= SOLID.good_share:
            break
    return best


def _is_roundish(job: Job) -> bool:
    """Whether the outline hardly determines the part's turn: then every turn is a rival."""
    around = 2 * math.pi * max((circle.radius_mm for circle in job.circles), default=0.0)
    return sum(edge.length_mm for edge in job.edges) < around


def _tells_turn(job: Job, found: Lock) -> bool:
    """Whether the eccentric curves agree: concentric ones, such as a rim or a bore, do so at any turn.

    Turns that put one feature in the place of another like it are left to `_rival_motions`.
    """
    curves, centre = curves_of(job), job.place_of(job.reference)[:2]
    lengths = np.array([curve.perimeter_mm for curve in curves])
    away = np.array([float(np.linalg.norm(curve.parameters[:2] - centre)) for curve in curves])
    beside = np.where(away > SOLID.concentric * lengths / (2 * math.pi), lengths, 0.0)
    return bool(beside.any() and (found.by_curve @ beside >= SOLID.plain_share * beside.sum()).all())


def _turned(
    images: StereoImages, curves: Sequence[Curve], job: Job, poses: Sequence[FloatArray]
) -> list[FloatArray]:
    """Starts turned about the part's normal, likely ones first: the match of a round part may be turned."""
    centre = job.place_of(job.reference)
    turned = [pose @ turned_to(turn, centre, centre) for pose in poses for turn in SOLID.turns_rad]
    order = np.argsort(
        [-quick_agreement(images, curves, pose, SOLID.turn_reach_px) for pose in turned], kind="stable"
    )
    return [turned[k] for k in order[: SOLID.turned_starts]]


def _rival_motions(job: Job) -> list[FloatArray]:
    """Motions (4, 4) in the face that put one feature of the part in the place of another like it.

    Only those that keep the part's middle about where it is: farther away lies the next part.
    """
    places = np.array([curve.parameters[:2] for curve in curves_of(job)])
    middle = np.append(0.5 * (places.min(axis=0) + places.max(axis=0)), 0.0)
    aside_mm = SOLID.aside * float(np.linalg.norm(np.ptp(places, axis=0)))
    motions = []
    if job.circles:
        centre = job.place_of(job.reference)
        motions = [turned_to(turn, centre, centre) for turn in rival_turns(job)]
    for edge, other in itertools.product(job.edges, job.edges):
        if abs(edge.length_mm - other.length_mm) > SOLID.like * edge.length_mm:
            continue
        turn = other.angle_rad - edge.angle_rad
        middles = 0.5 * (edge.start_mm + edge.end_mm), 0.5 * (other.start_mm + other.end_mm)
        for half in (0.0, math.pi):
            if abs(wrapped(turn + half)) > SOLID.same_turn_rad:
                motions.append(turned_to(turn + half, *middles))
    near = [motion for motion in motions if float(np.linalg.norm(apply(motion, middle) - middle)) <= aside_mm]
    return near[: SOLID.max_rivals]


def _is_turned(images: StereoImages, job: Job, match: ShapeMatch, found: Lock) -> bool:
    """Whether a lock contradicts the rotation of its match; False for a symmetric one."""
    if match.symmetric:
        return False
    turns = []
    for pose in _by_match(images, job, match, _main_face(job)):
        between = pose[:3, :3].T @ found.pose[:3, :3]
        turns.append(abs(turn_about_z(between)))
    return bool(turns) and min(turns) > SOLID.same_turn_rad


def _starts(images: StereoImages, job: Job, match: ShapeMatch) -> Iterator[FloatArray]:
    """Likely poses rig_from_part (4, 4): by the match alone, and by the rows of both images."""
    main = _main_face(job)
    yield from _by_match(images, job, match, main)
    by_rows = start_pose(images, job, match, main)
    if by_rows is not None:
        yield by_rows


def _by_match(images: StereoImages, job: Job, match: ShapeMatch, main: Sequence[Curve]) -> list[FloatArray]:
    share = np.linspace(0, 1, SOLID.outline_points, endpoint=False)
    flat = np.concatenate([curve.outline(share).points for curve in main])
    flat[:, 2] = 0.0
    return poses_of_match(images, job, match, np.ascontiguousarray(flat))


def _main_face(job: Job) -> list[Curve]:
    """The curves of the face that is searched for."""
    level = float(job.place_of(job.reference)[2])
    return [curve for curve in curves_of(job) if abs(curve.height_mm - level) < MEASURING.solid_mm]


@dataclass(frozen=True, slots=True, eq=False)
class _Whole:
    """All curves of a part fitted as one.

    curves : with their signs.  clear : names of curves of which enough has no rival.  shown : names of curves
    that both cameras should see well.  params, rigid_mm : as used in the fit.
    """

    fit: PlaneFit
    curves: tuple[Curve, ...]
    clear: frozenset[str]
    shown: frozenset[str]
    params: FitParams
    rigid_mm: float

    def alone(self, images: StereoImages) -> PlaneFit | None:
        """Free fits of the curves that can be measured separately; None if there are none."""
        curves = [curve for curve in self.curves if curve.name in self.clear]
        if not curves:
            return None
        return fit_plane(images.rig, images.raw, self.fit.face, curves, SOLID.alone_fit)

    def with_breaks(self, images: StereoImages) -> tuple[_Whole, PlaneFit | None]:
        """This fit and that of the separate curves, both with the widest edge break that either shows."""
        alone = self.alone(images)
        widths = [
            {found.scatter.break_mm for found in fit.fits} for fit in (self.fit, alone) if fit is not None
        ]
        if len(set.union(*widths)) == 1:
            return self, alone
        curves = tuple(replace(curve, break_mm=max(set.union(*widths))) for curve in self.curves)
        fit = fit_plane(images.rig, images.raw, self.fit.face, curves, self.params, rigid_mm=self.rigid_mm)
        again = self if fit is None else replace(self, fit=fit, curves=curves)
        return again, again.alone(images)


def fitted(images: StereoImages, job: Job, pose: FloatArray) -> _Whole | None:
    """All curves of the part measured together from a locked pose rig_from_part (4, 4)."""
    curves, clear, shown = _with_signs(images, curves_of(job), pose, job.body)
    face = Face(pose[:3, 3], pose[:3, :3].T)
    rigid_mm = taught_sigma_mm(images.rig, pose)
    params = SOLID.fit if job.body is None else SOLID.known_fit
    fit = fit_plane(images.rig, images.raw, face, curves, params, rigid_mm=rigid_mm)
    return None if fit is None else _Whole(fit, tuple(curves), clear, shown, params, rigid_mm)


def taught_sigma_mm(rig: StereoRig, pose: FloatArray) -> float:
    """Sigma of a feature's taught place and size at a pose, rig_from_part (4, 4)."""
    return SOLID.rigid_px * float(pose[2, 3]) / rig.left.fx


def _with_signs(
    images: StereoImages, curves: Sequence[Curve], pose: FloatArray, body: PartBody | None
) -> tuple[list[Curve], frozenset[str], frozenset[str]]:
    """The curves with the sign of each stretch as both images show it at a pose rig_from_part (4, 4).

    Further, the names of curves with enough stretches without a rival in either image: only these stretches
    are used; and the names of curves that the part's body, if known, neither hides nor blurs.
    """
    outline, starts = spread(images, curves, pose, SOLID.spacing_px)
    face = Face(pose[:3, 3], pose[:3, :3].T)
    counts = np.diff(starts)
    signs = [np.zeros((2, min(SOLID.stretches, count)), np.int64) for count in counts]
    lone = [np.zeros(sign.shape, bool) for sign in signs]
    clean = [np.ones(sign.shape, bool) for sign in signs]
    seen_of = [np.ones(sign.shape) for sign in signs]
    for side, (name, image) in enumerate(zip(SIDES, images.raw, strict=True)):
        seen = project_outline(images.rig, name, face, outline)
        edges = candidates(
            image, seen.pixels, seen.normals, starts, SOLID.reach_px, round(SOLID.along_px / SOLID.spacing_px)
        )
        away = np.nan_to_num(np.abs(edges.offset_px), nan=np.inf)
        own, rows = away.argmin(axis=1), np.arange(len(away))
        sign = np.where(away[rows, own] < 2 * SOLID.agree_px, np.sign(edges.slope[rows, own]), 0.0)
        sight = None if body is None else curve_visibility(body, images.rig, name, pose, outline, seen)
        if sight is not None:
            sign[sight.hidden] = 0.0
            doubtful = sight.merged | _beside_glare(image, seen.pixels)
        gap = np.abs(edges.offset_px - edges.offset_px[rows, own][:, None])
        gap[rows, own] = np.inf
        single = ~(np.nan_to_num(gap, nan=np.inf) < SOLID.rival_px).any(axis=1)
        for k in range(len(curves)):
            rows_of, wanted = slice(starts[k], starts[k + 1]), signs[k].shape[1]
            stretch = ((np.arange(counts[k]) + 0.5) / counts[k] * wanted).astype(np.int64)
            many = np.bincount(stretch, minlength=wanted)
            total = np.bincount(stretch, sign[rows_of], wanted)
            signs[k][side] = np.where(np.abs(total) > 0.5 * many, np.sign(total), 0)
            lone[k][side] = np.bincount(stretch, single[rows_of], wanted) > 0.5 * many
            lone[k][side] &= signs[k][side] != 0
            if sight is not None:
                seen_of[k][side] = 1.0 - np.bincount(stretch, sight.hidden[rows_of], wanted) / many
                clean[k][side] = np.bincount(stretch, doubtful[rows_of], wanted) < 0.5 * many
    good = [unblurred & (sign != 0) for unblurred, sign in zip(clean, signs, strict=True)]
    known = np.average([used.mean(axis=1) for used in good], axis=0, weights=counts)
    if body is not None and known.min() >= SOLID.enough_clean:
        signs = [np.where(used, sign, 0) for used, sign in zip(good, signs, strict=True)]
        lone = [used & single for used, single in zip(good, lone, strict=True)]
        seen_of = [used * share for used, share in zip(clean, seen_of, strict=True)]
    found, clear, shown = [], set(), set()
    for k, curve in enumerate(curves):
        enough = lone[k].mean(axis=1) >= SOLID.enough
        mine = np.where(lone[k] | ~enough[:, None], signs[k], 0)
        if enough.all():
            clear.add(curve.name)
        if (seen_of[k].mean(axis=1) >= SOLID.min_shown).all():
            shown.add(curve.name)
        found.append(replace(curve, signs=mine, polarity=1 if mine.sum() >= 0 else -1))
    return found, frozenset(clear), frozenset(shown)


def _beside_glare(image: Image, pixels: FloatArray) -> B8:
    """(N,) whether points (N, 2) of an image lie beside a saturated surface."""
    bright = cv2.dilate(
        (image >= SOLID.saturated).astype(np.uint8), np.ones((2 * SOLID.glare_px + 1,) * 2, np.uint8)
    )
    height, width = image.shape
    x, y = np.rint(np.clip(np.nan_to_num(pixels), 0, [width - 1, height - 1])).astype(np.int64).T
    return np.asarray(bright[y, x] > 0)


def target_of(job: Job, match: Match, fit: PlaneFit) -> Target:
    """The target of a rigid fit, still without features and sizes."""
    assert fit.rigid is not None
    face = fit.face
    u, v, n = face.axes
    x, y, z = job.place_of(job.reference)
    lift = np.zeros((6, 7))  # derivatives by height, slopes, shift, turn, growth
    lift[:3, 0] = n
    lift[:3, 1], lift[:3, 2] = x * n - z * u, y * n - z * v
    lift[:3, 3], lift[:3, 4], lift[:3, 5] = u, v, x * v - y * u
    lift[:3, 6] = x * u + y * v
    lift[3:, 1], lift[3:, 2], lift[3:, 5] = -v, u, n
    return Target(
        job=job.name,
        match=match,
        rig_from_part=transform(face.axes.T, face.to_rig(np.array([[x, y, z]]))[0]),
        covariance=lift @ fit.rigid.covariance @ lift.T,
        by_edges=lift @ fit.rigid.edge_covariance @ lift.T,
        circles=(),
        epipolar_rms_px=math.nan,
    )
