"""Fit the pose to whole grey-value profiles across all edges.

A profile is modelled as a constant and blurred steps of free height, at the sample's own edge and at the
neighbours that the model has there, with one shift for all. Two edges that the lens merges are then two
steps, not one edge somewhere between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, I64, FloatArray
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.rectification import StereoImages
from edged.vision.kernels.jit import for_both, kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN, tukey_weights
from edged.vision.solid.arcs import ArcShifts, across_breaks, arc_shifts, if_rounded
from edged.vision.solid.edgemodel import EdgeModel, EdgePoints, are_unbroken, chains_of
from edged.vision.solid.lock import Pyramids, scale_at
from edged.vision.solid.params import PROFILE, VISIBILITY
from edged.vision.solid.shifts import NEAR, find_shifts
from edged.vision.solid.visible import VisibleSamples, find_neighbours, moved, samples_at, see

# numba freezes globals when it compiles: kernels read these by name
CORRELATED = PROFILE.correlated
PRIOR_BLOCKS = PROFILE.prior_blocks
MIN_SIGMA_PX = PROFILE.min_sigma_px


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Results of the profiles of both cameras, those of the left one first.

    seen : the samples.  camera (M,) : 0 left, 1 right.  points (M, 3) : of the part frame.
    shift_px (M,) : of all edges of a profile along the normal.  weight (M,) : 1 / px², 0 where the profile
    shows nothing.  height (M,) : of the sample's own step, grey values.
    across_px (M,) : along the normal, from one end of the break that an edge belongs to, to the other.
    rounded_px (M,) : sigma of an edge's shift if its break is a rounding; see `if_rounded`.
    """

    seen: VisibleSamples
    camera: I64
    points: FloatArray
    shift_px: FloatArray
    weight: FloatArray
    height: FloatArray
    across_px: FloatArray
    rounded_px: FloatArray

    @property
    def by_width(self) -> FloatArray:
        """(M,) px / mm by the width of the break that an edge belongs to; 0 for an edge without one."""
        return np.where(are_unbroken(self.seen.curve), 0.0, self.seen.by_break)

    @property
    def unknown(self) -> FloatArray:
        """Sigmas (M, 2) px of the shifts of edges if light shows the upper ends of breaks that no picture has
        shown, and if the other breaks are roundings."""
        upper = np.where(are_unbroken(self.seen.curve), PROFILE.unseen_mm * self.seen.by_break, 0.0)
        return np.stack([upper, self.rounded_px], axis=1)


def profiles_of(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray, blur_px: float
) -> Profiles:
    """Measure the shifts of the profiles in both pictures at a pose."""
    samples = samples_at(model, scale_at(images.rig, pose, model), PROFILE.drawn_px)

    def measured(k: int) -> tuple[VisibleSamples, list[FloatArray]]:
        """Samples that one camera sees; their shift, weight and height, and `across_px` and `rounded_px`."""
        every, reach_px = PROFILE.every, PROFILE.reach_px
        dense, near = seen_with_neighbours(model, samples, pyramids, pose, k, reach_px, every)
        some = slice(None, None, every)
        seen = VisibleSamples._make(np.ascontiguousarray(field[some]) for field in dense)
        grey, _ = edge_profiles(images.raw[k], seen.pixels, seen.normals, PROFILE.half_px, PROFILE.step_px)
        found = [np.zeros(len(seen.row)) for _ in range(3)]
        find_shifts(grey, seen.curve, near, blur_px, PROFILE.together, *found)
        return seen, [*found, across_breaks(model, samples, seen), if_rounded(model, samples, seen)]

    left, right = for_both(measured)
    by_camera = (left[0], right[0])
    both = VisibleSamples._make(np.concatenate(field) for field in zip(*by_camera, strict=True))
    camera = np.repeat([0, 1], [len(seen.row) for seen in by_camera])
    values = (np.concatenate(each) for each in zip(left[1], right[1], strict=True))
    return Profiles(both, camera, samples.points[both.row], *values)


def seen_with_neighbours(
    model: EdgeModel, samples: EdgePoints, pyramids: Pyramids, pose: FloatArray, camera: int, reach_px: float,
    every: int,
) -> tuple[VisibleSamples, FloatArray]:  # fmt: skip
    """Samples (M) that a camera (0 left, 1 right) sees at a pose, and offsets, px, of other edges nearby.

    every : one of so many of the samples has offsets (K, 4), NaN where there are fewer within reach_px.
    """
    dense = see(model, samples, pyramids.cameras[0].view(camera, model, pose), VISIBILITY.buffer_px[0])
    near = np.empty((math.ceil(len(dense.row) / every), NEAR))
    drawn = pyramids.pictures[0][camera].drawn
    find_neighbours(dense.pixels, dense.normals, dense.curve, drawn, PROFILE.own_px, reach_px, every, near)
    return dense, near


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedPose:
    """A pose fitted to profiles, and what its covariance is computed from.

    before : the pose that the profiles were taken at.  scale (6,) : of the pose's unknowns.
    design (M, 6 + K) : of these, and of K nuisance unknowns in sigmas.  arcs : nuisance unknowns of single
    curves.  left, weights (M,) : residuals and weights of the profiles.  aside (M,) px : shifts explained by
    the heights of single curves.
    inverse (6 + K, 6 + K) : of the normal equations from which the arcs' unknowns are eliminated.
    """

    pose: FloatArray
    before: FloatArray
    profiles: Profiles
    scale: FloatArray
    design: FloatArray
    arcs: ArcShifts
    left: FloatArray
    aside: FloatArray
    weights: FloatArray
    inverse: FloatArray

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals, weighted."""
        return float(np.sqrt(np.sum(self.weights * self.left**2) / self.weights.sum()))


def adjusted(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray, blur_px: float,
    held: FloatArray | None = None,
) -> AdjustedPose | None:  # fmt: skip
    """Fit the motion from a pose good to a pixel, then again with profiles at the new pose; None as below.

    held (3,) : axis of the part about which its turn is undetermined.
    """
    fit: AdjustedPose | None = None
    for first_sigma_px in PROFILE.first_sigmas_px:
        profiles = profiles_of(model, pyramids, images, pose, blur_px)
        fit = adjusted_to(model, pose, profiles, first_sigma_px, held, alike=False)
        if fit is None:
            return None
        pose = fit.pose
    return fit


def adjusted_to(
    model: EdgeModel, pose: FloatArray, profiles: Profiles, first_sigma_px: float,
    held: FloatArray | None, alike: bool,
) -> AdjustedPose | None:  # fmt: skip
    """Fit the motion of a pose robustly to given profiles; None if they show too little.

    held : as in `adjusted`.  alike : all curves have the same weight, as long as their breaks are not known.
    """
    scale = np.r_[np.full(3, 0.5 * model.size_mm), np.ones(3)]
    known = np.hstack([profiles.seen.design / scale, profiles.unknown])
    heights = model.height_mm * _heights(model, profiles)
    design, by_height = np.hstack([known, heights]), slice(known.shape[1], None)
    shift, base = profiles.shift_px, profiles.weight
    good = base > PROFILE.min_weight
    if good.sum() < PROFILE.fewest:
        return None
    variance = 1 / np.maximum(base, 1e-9) + PROFILE.model_px**2
    stretch, arcs = np.zeros(len(shift), np.int64), ArcShifts.none(len(shift))
    if not alike:
        _, stretch = np.unique(2 * chains_of(profiles.seen.curve) + profiles.seen.walled, return_inverse=True)
        arcs = arc_shifts(profiles.seen, profiles.camera, profiles.across_px)
    delta, left, inverse = np.zeros(design.shape[1]), shift, np.eye(design.shape[1])
    weights = np.where(good, 1 / variance, 0.0)
    for number in range(PROFILE.rounds):
        if number > 1:
            arcs = arcs.learnt(weights, shift - design @ delta, design, inverse)
            if heights.size:
                grown = _grown(delta[by_height], inverse[by_height, by_height])
                design[:, by_height] *= grown
                delta[by_height] /= grown
        sigma = scatter_of(left, stretch, good) if number else np.full(len(left), first_sigma_px)
        own = sigma**2 if number else 0.0
        weights = np.where(good, tukey_weights(left / sigma, 1.0), 0.0) / (variance + own)
        freed, freed_shift = arcs.free(weights, design), arcs.free(weights, shift)
        normal = _normal(design, freed, weights)
        if held is not None:
            normal[:3, :3] += np.trace(normal) * np.outer(held, held)
        if not np.linalg.cond(normal) < PROFILE.max_condition:
            return None
        inverse = np.asarray(np.linalg.inv(normal), np.float64)
        new = inverse @ (freed.T @ (weights * shift))
        still, delta = float(np.abs(new - delta).max()) < PROFILE.still_mm, new
        left = freed_shift - freed @ delta
        if still:
            break
    there = moved(model, pose, delta[:6] / scale)
    aside = design[:, by_height] @ delta[by_height]
    return AdjustedPose(there, pose, profiles, scale, design, arcs, left, aside, weights, inverse)


def _heights(model: EdgeModel, profiles: Profiles) -> FloatArray:
    """(M, C) px / mm by the height of each curve, if they were taught at uneven heights; else (M, 0).

    Light shows each camera a different end of a wall's shade: one hole then seems deeper or higher by half a
    millimetre, another one by less, at teaching as well as now.
    """
    if not model.height_mm:
        return np.zeros((len(profiles.camera), 0))
    good = np.where(profiles.weight > PROFILE.min_weight, profiles.seen.design[:, 5], 0.0)
    return by_curve(profiles, good).T


def _grown(found: FloatArray, inverse: FloatArray) -> float:
    """Factor from the assumed sigma of the curves' heights to the estimated one, by EM as for the arcs.

    found (C,) : heights, in sigmas.  inverse (C, C) : of the normal equations.
    """
    return math.sqrt(float(np.mean(found**2 + PROFILE.correlated * np.diag(inverse))))


def _normal(design: FloatArray, freed: FloatArray, weights: FloatArray) -> FloatArray:
    """Matrix of the normal equations of a pose and of nuisance unknowns, which have a prior sigma of 1.

    freed (M, 6 + K) : the design with the arcs' unknowns eliminated.
    """
    normal = design.T @ (weights[:, None] * freed)
    beside = np.arange(6, len(normal))
    normal[beside, beside] += PROFILE.correlated
    return np.asarray(normal)


def by_curve(profiles: Profiles, values: FloatArray) -> FloatArray:
    """Spread values (M,) over a row (C, M) for each curve that has any but 0, with 0 at the other curves."""
    some = np.flatnonzero(values)
    chains, number = np.unique(chains_of(profiles.seen.curve[some]), return_inverse=True)
    found = np.zeros((len(chains), len(values)))
    found[number, some] = values[some]
    return found


@kernel("f8[::1](f8[::1], i8[::1], b1[::1])")
def scatter_of(left: FloatArray, stretch: I64, good: B8) -> FloatArray:
    """(M,) robust sigma of the residuals left (M,) about 0, px, estimated for each stretch of a curve.

    A rounded or glinting edge errs as a whole, and differently where its wall is visible than where it is
    not; so each stretch is weighted by its own scatter. That of a short stretch is drawn towards the scatter
    of all.
    Source: W. Förstner, "Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten", 1979.

    stretch (M,) : numbers from 0 on.  good (M,) : which residuals count, one at least.
    """
    count, numbers = len(left), 0
    for m in range(count):
        numbers = max(numbers, stretch[m] + 1)
    # all good residuals, sorted by stretch
    ends = np.zeros(numbers + 1, np.int64)
    for m in range(count):
        ends[stretch[m] + 1] += good[m]
    for k in range(numbers):
        ends[k + 1] += ends[k]
    sizes, place = np.empty(ends[numbers]), ends[:numbers].copy()
    for m in range(count):
        if good[m]:
            sizes[place[stretch[m]]] = abs(left[m])
            place[stretch[m]] += 1
    common = max(SIGMA_PER_MEDIAN * median(sizes), MIN_SIGMA_PX) ** 2
    sigma = np.empty(numbers)
    for k in range(numbers):
        own, square = sizes[ends[k] : ends[k + 1]], 0.0
        blocks = len(own) / CORRELATED
        if len(own):
            square = (SIGMA_PER_MEDIAN * median(own)) ** 2
        sigma[k] = max(
            np.sqrt((PRIOR_BLOCKS * common + blocks * square) / (PRIOR_BLOCKS + blocks)), MIN_SIGMA_PX
        )
    return sigma[stretch]
