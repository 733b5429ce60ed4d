"""Pose of a whole taught part from the edges of both cameras: six unknowns, however many curves.

One curve alone is easily misled: beside a thick part's rim runs the foot of its wall, beside a hole's rim its
ground, and a lit chamfer is brighter than the face. Any of these may be the stronger edge over half of the
curve. But rivals mislead each curve in its own way, while all true edges fit one pose, and over some of each
curve there is only one edge. So the part is fitted as a rigid whole to both images, with all edges near a
curve as candidates; samples with rivals count less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from edged.domain.arrays import B8, F64, I64, SIDES, FloatArray
from edged.vision.curves.outlines import Curve, CurveOutline, Face, project_outline
from edged.vision.edges.candidates import MOST, candidates
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.kernels.cholesky import factorise, substitute
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN, tukey_weight
from edged.vision.part.params import SOLID

STILL_STEPS = 10  # number of steps at the end of `SOLID.near_px`
# numba freezes globals when it compiles: kernels read these by name
ODD_PX = SOLID.odd_px
ODD_SHARE = SOLID.odd_share
LEAST_SIGMA_PX = SOLID.min_sigma_px
ROUNDS = SOLID.lock_rounds
TINY_PIVOT = 1e-8  # relative: singular to rounding
FEWEST = 24  # samples, four for each of six unknowns
ALL, TURN_HELD = 6, 5
"""Unknowns of a pose: its height and slopes, its shift in the face, and its turn."""


@dataclass(frozen=True, slots=True, eq=False)
class Lock:
    """A pose rig_from_part (4, 4), and the share of the curves that agree with it in each camera (2,).

    by_curve (2, K) : that share for each curve.  moved_px : rms by which the last step moved the curves.
    """

    pose: FloatArray
    agreeing: FloatArray
    by_curve: FloatArray
    moved_px: float

    @property
    def share(self) -> float:
        """Agreement in the camera where it is lower."""
        return float(self.agreeing.min())

    @property
    def mean(self) -> float:
        """Mean agreement of both cameras."""
        return float(self.agreeing.mean())


def lock(
    images: StereoImages,
    curves: Sequence[Curve],
    pose: FloatArray,
    rival_of: Lock | None = None,
    *,
    unknowns: int = ALL,
) -> Lock | None:
    """Fit curves of the part frame to the edges of both images, from a pose rig_from_part (4, 4).

    unknowns : `TURN_HELD` for circles about one axis.  rival_of : the lock of another pose, if this start is
    a rival of it: good to a few px, and given up if it agrees much less.
    None where the images do not show enough of the curves, or the pose runs away.
    """
    found: Lock | None = None
    phases: tuple[tuple[tuple[float, ...], float], ...] = (
        (SOLID.far_px, SOLID.far_spacing_px),
        (SOLID.near_px, SOLID.spacing_px),
    )
    if rival_of is not None:
        phases = (
            (SOLID.lock_rival_px, SOLID.far_spacing_px),
            (SOLID.near_px[-STILL_STEPS:], SOLID.spacing_px),
        )
    for reaches, spacing_px in phases:
        if pose[2, 3] <= 0 or (found is not None and found.share < SOLID.hopeless):
            return None
        if found is not None and rival_of is not None and found.mean < rival_of.mean - SOLID.rival_lacks:
            return None
        laid = spread(images, curves, pose, spacing_px)
        together = max(1, round(SOLID.along_px / spacing_px))
        for reach in reaches:
            found = _step(images, curves, laid, pose, reach, together, unknowns=unknowns)
            if found is None:
                return None
            pose = found.pose
            if reach == SOLID.near_px[-1] and found.moved_px < SOLID.still_px:
                break
    if found is None or found.share >= SOLID.good_share:
        return found
    tight = found
    for _ in range(SOLID.tight_steps):
        moved = _step(
            images,
            curves,
            laid,
            tight.pose,
            SOLID.near_px[-1],
            together,
            most_sigma_px=SOLID.tight_sigma_px,
        )
        if moved is None:
            return found
        tight = moved
        if tight.moved_px < SOLID.still_px:
            break
    return max(found, tight, key=lambda candidate: candidate.mean)


def quick_agreement(
    images: StereoImages,
    curves: Sequence[Curve],
    pose: FloatArray,
    reach_px: float = SOLID.glance_px,
    unknowns: int = ALL,
) -> float:
    """Mean agreement of both cameras after one step from a pose good to a few px; 0 if the step fails."""
    if pose[2, 3] <= 0:
        return 0.0
    laid = spread(images, curves, pose, SOLID.far_spacing_px)
    together = round(SOLID.along_px / SOLID.far_spacing_px)
    seen = _step(images, curves, laid, pose, reach_px, together, unknowns=unknowns)
    return 0.0 if seen is None else seen.mean


def spread(
    images: StereoImages, curves: Sequence[Curve], pose: FloatArray, spacing_px: float
) -> tuple[CurveOutline, I64]:
    """Samples of all curves, with their motion by shift and turn in the face; starts of curves (K + 1,)."""
    px_per_mm = images.rig.left.fx / float(pose[2, 3])
    return _spread(tuple(curves), round(math.log(px_per_mm) / SOLID.alike), spacing_px)


@lru_cache(maxsize=32)  # the curves of a few jobs, at both spacings, at a few distances
def _spread(curves: tuple[Curve, ...], size: int, spacing_px: float) -> tuple[CurveOutline, I64]:
    px_per_mm = math.exp(size * SOLID.alike)
    outlines = []
    for curve in curves:
        count = max(int(curve.perimeter_mm * px_per_mm / spacing_px), FEWEST)
        outlines.append(curve.spread(count, 0.0 if curve.closed else SOLID.margin_px / px_per_mm))
    points = np.concatenate([outline.points for outline in outlines])
    normals = np.concatenate([outline.normals for outline in outlines])
    turning = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    starts = np.cumsum([0, *(len(outline.points) for outline in outlines)])
    return CurveOutline(points, normals, np.column_stack([normals, turning])), starts


def _step(
    images: StereoImages,
    curves: Sequence[Curve],
    laid: tuple[CurveOutline, I64],
    pose: FloatArray,
    reach: float,
    together: int,
    *,
    most_sigma_px: float = math.inf,
    unknowns: int = ALL,
) -> Lock | None:
    """One step to the pose that best fits the edges within reach; None where they do not determine it.

    together : samples along a curve whose profiles are averaged.  most_sigma_px : ceiling of the robust
    scale.
    """
    (outline, starts), face = laid, Face(pose[:3, 3], pose[:3, :3].T)
    expected = np.repeat([float(curve.polarity) for curve in curves], np.diff(starts))
    designs, offsets, odds = [], [], []
    for side, image in zip(SIDES, images.raw, strict=True):
        with np.errstate(invalid="ignore", divide="ignore"):
            seen = project_outline(images.rig, side, face, outline)
        if not np.isfinite(seen.design).all():
            return None
        edges = candidates(image, seen.pixels, seen.normals, starts, reach, together)
        offsets.append(edges.offset_px)
        odds.append(edges.slope * expected[:, None] < 0)
        designs.append(seen.design)
    design, offset, odd = np.concatenate(designs), np.concatenate(offsets), np.concatenate(odds)
    delta, left = np.zeros(ALL), np.full(len(offset), np.nan)
    asked = np.ascontiguousarray(design[:, :unknowns])
    if not _settle(asked, offset, odd, most_sigma_px, delta[:unknowns], left):
        return None
    height, slope_u, slope_v, shift_u, shift_v, turn = delta
    if max(abs(slope_u), abs(slope_v), abs(turn)) > SOLID.max_step_rad:
        return None
    # a plane of height a u + b v is the face turned about v by -a, and about u by b
    motion = transform(
        rotation_matrix(np.array([slope_v, -slope_u, turn])), np.array([shift_u, shift_v, height])
    )
    agree = (np.abs(left) < SOLID.agree_px).reshape(2, -1)
    by_curve = np.add.reduceat(agree, starts[:-1], axis=1, dtype=np.float64) / np.diff(starts)
    moved_px = float(np.sqrt(np.mean((design[np.isfinite(left)] @ delta) ** 2)))
    return Lock(np.asarray(pose @ motion), agree.mean(axis=1), by_curve, moved_px)


@kernel("b1(f8[:, ::1], f8[:, ::1], b1[:, ::1], f8, f8[::1], f8[::1])")
def _settle(design: F64, offset: F64, odd: B8, most_sigma_px: float, delta: F64, left: F64) -> bool:
    """Fill delta, the step (up to 6,) by robust least squares, each round to the nearest edge of each sample.

    offset, odd (N, MOST) : all edges of a sample, and which of them have the opposite of the taught sign.
    left (N,) : residual of the nearest edge after the step, NaN where there is none.
    False where the edges do not determine the step.
    """
    count, size = design.shape
    chosen, trust = np.zeros(count, np.int64), np.zeros(count)
    values, kept = np.zeros(count), np.empty(count)
    normal, right_side, scale = np.empty((size, size)), np.empty(size), np.empty(size)
    known = 0
    for n in range(count):
        many = 0
        for m in range(MOST):
            many += np.isfinite(offset[n, m])
        if many:
            trust[n], known = 1.0 / many**2, known + 1
    if known < FEWEST:
        return False
    for _ in range(ROUNDS):
        many = 0
        for n in range(count):
            if trust[n] == 0.0:
                continue
            ahead, nearest = 0.0, np.inf
            for i in range(size):
                ahead += design[n, i] * delta[i]
            for m in range(MOST):
                away = abs(offset[n, m] - ahead) + (ODD_PX if odd[n, m] else 0.0)
                if away < nearest:  # False where there is no edge (NaN)
                    nearest, chosen[n] = away, m
            values[n] = offset[n, chosen[n]]
            kept[many] = left[n] = values[n] - ahead
            kept[many] = abs(kept[many])
            many += 1
        sigma = min(max(SIGMA_PER_MEDIAN * median(kept[:many]), LEAST_SIGMA_PX), most_sigma_px)
        normal[:], right_side[:] = 0.0, 0.0
        for n in range(count):
            if trust[n] == 0.0:
                continue
            weight = trust[n] * tukey_weight(left[n] / sigma)
            if odd[n, chosen[n]]:
                weight *= ODD_SHARE
            if weight == 0.0:
                continue
            for i in range(size):
                heavy = weight * design[n, i]
                right_side[i] += heavy * values[n]
                for j in range(i + 1):
                    normal[i, j] += heavy * design[n, j]
        for i in range(size):
            if not normal[i, i] > 0.0:
                return False
            scale[i] = 1.0 / math.sqrt(normal[i, i])
        for i in range(size):
            delta[i] = scale[i] * right_side[i]
            for j in range(i + 1):
                normal[i, j] *= scale[i] * scale[j]
        if not factorise(normal, size) > TINY_PIVOT:
            return False
        substitute(normal, delta, size)
        for i in range(size):
            delta[i] *= scale[i]
    for n in range(count):
        if trust[n] > 0.0:
            left[n] = values[n]
            for i in range(size):
                left[n] -= design[n, i] * delta[i]
    return True
