"""The pose by whole grey-value profiles across all edges, and what its blocks of curves say of its error.

A profile is a constant and blurred steps of free height, at the sample's own edge and at its neighbours where
the model has them: one shift for all. Two edges that the lens merges are then two steps, not one edge
somewhere between.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import B8, I64, FloatArray
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.projection import shifts_by_calibration
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.kernels.jit import for_both, kernel
from edged.vision.kernels.median import median
from edged.vision.kernels.robust import SIGMA_PER_MEDIAN, tukey_weights
from edged.vision.solid.arcs import ArcShifts, across_breaks, arc_shifts, deeper, if_rounded
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
    """What the profiles of both cameras say, those of the left one first.

    seen : the samples.  camera (M,) : 0 left, 1 right.  points (M, 3) : of the part frame.
    shift_px (M,) : of all edges of a profile along the normal.  weight (M,) : 1 / px², 0 where the profile
    says nothing.  height (M,) : of the sample's own step, grey values.
    across_px (M,) : along the normal, from one end of the break that an edge belongs to, to the other.
    rounded_px (M,) : by which an edge shifts if its break is a rounding, a sigma; as of `if_rounded`.
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
        """(M,) px / mm by the width of the break that an edge belongs to; 0 of one without."""
        return np.where(are_unbroken(self.seen.curve), 0.0, self.seen.by_break)

    @property
    def unknown(self) -> FloatArray:
        """(M, 2) px by which edges shift if light shows the upper ends of breaks that nobody has seen, and if
        the others are roundings: a sigma each."""
        upper = np.where(are_unbroken(self.seen.curve), PROFILE.unseen_mm * self.seen.by_break, 0.0)
        return np.stack([upper, self.rounded_px], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ProfileFit:
    """A pose rig_from_part (4, 4) by profiles.

    edges (6, 6) : covariance of the twist (turn about the part's axes and centre, shift along them) by the
    edges, jackknifed, by light that draws all of them alike, and by the widths of the edge breaks.
    calibration (6, 6).
    rms_px : of the residuals, weighted.
    row_shift_px, row_sigma_px : by which the right picture shows the part across its rows.
    growth, growth_sigma : by which share the part seems larger.
    """

    pose: FloatArray
    edges: FloatArray
    calibration: FloatArray
    rms_px: float
    row_shift_px: float
    row_sigma_px: float
    growth: float
    growth_sigma: float


def profiles_of(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray, blur_px: float
) -> Profiles:
    """Shifts of the profiles in both pictures at a pose."""
    samples = samples_at(model, scale_at(images.rig, pose, model), PROFILE.drawn_px)

    def measured(k: int) -> tuple[VisibleSamples, list[FloatArray]]:
        """What one camera sees, and shift, weight and height of it, and how wide its breaks are."""
        dense, near = seen_with_neighbours(model, samples, pyramids, pose, k, PROFILE.reach_px)
        some = slice(None, None, PROFILE.every)
        seen = VisibleSamples._make(np.ascontiguousarray(field[some]) for field in dense)
        grey, _ = edge_profiles(images.raw[k], seen.pixels, seen.normals, PROFILE.half_px, PROFILE.step_px)
        near = np.ascontiguousarray(near[some])
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
    model: EdgeModel, samples: EdgePoints, pyramids: Pyramids, pose: FloatArray, camera: int, reach_px: float
) -> tuple[VisibleSamples, FloatArray]:
    """What a camera (0 left, 1 right) sees of samples at a pose, and (M, 4) px to other edges beside each.

    NaN where there are fewer within reach_px.
    """
    dense = see(model, samples, pyramids.cameras[0].view(camera, model, pose), VISIBILITY.buffer_px[0])
    near = np.empty((len(dense.row), NEAR))
    drawn = pyramids.pictures[0][camera].drawn
    find_neighbours(dense.pixels, dense.normals, dense.curve, drawn, PROFILE.own_px, reach_px, near)
    return dense, near


@dataclass(frozen=True, slots=True, eq=False)
class _Adjusted:
    """A pose by profiles, and what its covariance is made of.

    before : the pose that the profiles were taken at.  scale (6,) : of its unknowns.
    design (M, 6 + K) : of them, and of what else is not known, in sigmas.  arcs : of what is not known of
    single curves.  left, weights (M,) : of the profiles.  aside (M,) px : by the heights of single curves.
    inverse (6 + K, 6 + K) : of the normal equations without the arcs' unknowns.
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


def pose_by_profiles(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray, blur_px: float,
    held: FloatArray | None = None, *, alike: bool = False,
) -> FloatArray | None:  # fmt: skip
    """The pose (4, 4) by profiles from one that is good to a pixel; None where they say too little.

    held (3,) : axis of the part about which nothing tells its turn.  alike : all curves are worth the same,
    as long as their breaks are not known.
    """
    fit = _adjusted(model, pyramids, images, pose, blur_px, held, alike)
    return None if fit is None else fit.pose


def best_fit(
    model: EdgeModel,
    pyramids: Pyramids,
    images: StereoImages,
    pose: FloatArray,
    held: FloatArray | None = None,
) -> ProfileFit | None:
    """The fit of profiles with the blur that leaves least; None where they say too little."""
    best: _Adjusted | None = None
    for blur in PROFILE.blurs_px:
        fit = _adjusted(model, pyramids, images, pose, blur, held, alike=False)
        if fit is None or (best is not None and fit.rms_px > best.rms_px):
            break
        best = fit
    return None if best is None else _with_covariance(model, images, best)


def _adjusted(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray, blur_px: float,
    held: FloatArray | None, alike: bool,
) -> _Adjusted | None:  # fmt: skip
    fit: _Adjusted | None = None
    for first_sigma_px in PROFILE.first_sigmas_px:
        profiles = profiles_of(model, pyramids, images, pose, blur_px)
        fit = adjusted_to(model, pose, profiles, first_sigma_px, held, alike)
        if fit is None:
            return None
        pose = fit.pose
    return fit


def adjusted_to(
    model: EdgeModel, pose: FloatArray, profiles: Profiles, first_sigma_px: float,
    held: FloatArray | None, alike: bool,
) -> _Adjusted | None:  # fmt: skip
    """The motion of a pose that explains most profiles best."""
    scale = np.r_[np.full(3, 0.5 * model.size_mm), np.ones(3)]
    known = np.hstack([profiles.seen.design / scale, profiles.unknown])
    heights, height_mm = _heights(model, profiles), model.height_mm
    design = np.hstack([known, height_mm * heights])
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
            grown = _grown(delta, inverse, heights)
            height_mm *= grown
            delta[known.shape[1] :] /= grown
            design = np.hstack([known, height_mm * heights])
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
    aside = design[:, known.shape[1] :] @ delta[known.shape[1] :]
    return _Adjusted(there, pose, profiles, scale, design, arcs, left, aside, weights, inverse)


def _heights(model: EdgeModel, profiles: Profiles) -> FloatArray:
    """(M, C) px / mm by the height of each curve, where a pair has taught uneven ones; else (M, 0).

    Light shows either camera another end of a wall's shade: a hole seems deeper or higher by half a
    millimetre then, another one by less, at teaching as well as now.
    """
    if not model.height_mm:
        return np.zeros((len(profiles.camera), 0))
    good = np.where(profiles.weight > PROFILE.min_weight, profiles.seen.design[:, 5], 0.0)
    by_curve = _by_curve(profiles, good)
    return by_curve[by_curve.any(axis=1)].T


def _grown(delta: FloatArray, inverse: FloatArray, heights: FloatArray) -> float:
    """By which factor the sigma of the curves' heights is larger than it was taken to be, by EM as the arcs'.

    delta, inverse : of all unknowns, those of the heights (M, C) last, in sigmas.
    """
    count = heights.shape[1]
    if not count:
        return 1.0
    variance = PROFILE.correlated * np.diag(inverse)[-count:]
    return math.sqrt(float(np.mean(delta[-count:] ** 2 + variance)))


def _normal(design: FloatArray, freed: FloatArray, weights: FloatArray) -> FloatArray:
    """Normal equations of a pose and of what else is not known, whose sigma is 1 before anything is seen.

    freed (M, 6 + K) : what the arcs leave of the design.
    """
    normal = design.T @ (weights[:, None] * freed)
    beside = np.arange(6, len(normal))
    normal[beside, beside] += PROFILE.correlated
    return np.asarray(normal)


def _with_covariance(model: EdgeModel, images: StereoImages, fit: _Adjusted) -> ProfileFit:
    """A fit with what its blocks of curves, light, the part's breaks and the rig say of its error."""
    profiles = fit.profiles
    design, left, weights = fit.design, fit.left, fit.weights
    inverse, freed = fit.inverse[:6], fit.arcs.free(weights, design)
    response = inverse @ (weights[:, None] * freed).T  # (6, M): of the twist to each shift
    by_light = PROFILE.light_px * (response @ np.sign(profiles.height))
    block = _blocks(2 * profiles.seen.curve + profiles.camera, fit.arcs)
    edges = _jackknife(design, freed, weights, left, fit.inverse, block)[:6, :6] + np.outer(
        by_light, by_light
    )
    if model.taught_px:  # what single curves are off by, light may draw all of them by, as at teaching
        drawn_px = math.hypot(model.taught_px, disagreement_px(profiles, left + fit.aside))
        for camera, axis in itertools.product((0, 1), (0, 1)):
            by_camera = response @ np.where(profiles.camera == camera, profiles.seen.normals[:, axis], 0.0)
            edges += drawn_px**2 * np.outer(by_camera, by_camera)
        # what moved curves of one face apart at teaching moved all of them as far
        edges[5, 5] += model.height_mm**2
    # how much more the edges scatter than their weights say, as the jackknife has seen it
    excess = max(float(np.trace(edges @ np.linalg.inv(inverse[:, :6]))) / 6, 1.0)
    by_breaks = model.sigma_break_mm * profiles.by_width[None]
    if model.sigma_own_mm:
        by_breaks = np.vstack([by_breaks, model.sigma_own_mm * _by_curve(profiles, profiles.by_width)])
    by_breaks = np.vstack([by_breaks, fit.arcs.sigma * deeper(model, profiles.seen)])
    # widths that were settled, and what the edges leave open of the rest
    moves = np.hstack([response @ by_breaks.T, PROFILE.correlated * inverse[:, 6:]])
    edges += moves @ moves.T
    units = np.outer(fit.scale, fit.scale)
    calibration = _by_calibration(images, fit.before, profiles, response)
    # a width that a pair has shown explains no growth; roundings of other radii do, where edges wander
    unknown = by_breaks if model.sigma_own_mm or model.merged_mm else by_breaks[:0]
    rounded = fit.arcs.sigma / PROFILE.on_arc * _by_curve(profiles, profiles.rounded_px)
    unknown = np.vstack([unknown, rounded])
    extra = _extra(_added(model, images, profiles), fit, freed, excess, unknown)
    return ProfileFit(fit.pose, edges / units, calibration / units, fit.rms_px, *extra)


def _by_curve(profiles: Profiles, values: FloatArray) -> FloatArray:
    """(C, M) of values (M,) those of each curve, 0 of the others."""
    curve = chains_of(profiles.seen.curve)
    found = np.zeros((int(curve.max()) + 1, len(curve)))
    found[curve, np.arange(len(curve))] = values
    return found


@kernel("f8[::1](f8[::1], i8[::1], b1[::1])")
def scatter_of(left: FloatArray, stretch: I64, good: B8) -> FloatArray:
    """(M,) robust sigma of the residuals left (M,) about 0, px, each of the stretch of a curve it belongs to.

    A rounded or glinting edge errs as a whole, and where its wall is seen otherwise than where it is not; so
    does each say by its own scatter what it is worth. A short one is taken to be like all others as far as
    it does not say more.
    Source: W. Förstner, "Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten", 1979.

    stretch (M,) : numbers from 0 on.  good (M,) : which residuals count, one at least.
    """
    count, numbers = len(left), 0
    for m in range(count):
        numbers = max(numbers, stretch[m] + 1)
    # all good residuals, those of one stretch behind each other
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


def disagreement_px(profiles: Profiles, left: FloatArray) -> float:
    """By how much the cameras see single curves elsewhere than the pose has it, along either axis, rms.

    Where their views differ, light shows the upper end of a break to one of them and the lower one to the
    other: a curve is then off in parallax as a whole. 0 where no curve is seen by both.

    left (M,) : residuals of the fit.
    """
    chain, good = chains_of(profiles.seen.curve), profiles.weight > PROFILE.min_weight
    squares, expected = (
        np.zeros(2),
        np.zeros(2),
    )  # of differences, and what they are where a shift has sigma 1
    for number in np.unique(chain[good]):
        apart, shares = np.zeros(2), np.zeros(2)
        for camera, sign in ((0, 1.0), (1, -1.0)):
            own = good & (chain == number) & (profiles.camera == camera)
            normals = profiles.seen.normals[own]
            information = normals.T @ normals / PROFILE.correlated
            known = np.linalg.inv(np.eye(2) + information)  # a straight edge tells of its shift across only
            apart += sign * (known @ (normals.T @ left[own])) / PROFILE.correlated
            shares += np.square(known @ information).sum(axis=1)
        squares += apart**2
        expected += shares
    return math.sqrt(float((squares / np.maximum(expected, 1.0)).max()))


def _blocks(curve: I64, arcs: ArcShifts) -> I64:
    """(M,) numbers of the blocks of a jackknife: each curve in each camera, long ones cut.

    What shares an unknown of an arc is one block.
    """
    longest = max(PROFILE.block, len(curve) // PROFILE.most_blocks)
    _, number, count = np.unique(curve, return_inverse=True, return_counts=True)
    place = np.empty(len(curve), np.int64)
    place[np.argsort(number, kind="stable")] = np.concatenate([np.arange(n) for n in count])
    own = np.where(arcs.across_px != 0, -1 - arcs.group, number * 10_000 + place // longest)
    _, result = np.unique(own, return_inverse=True)
    return np.asarray(result, np.int64)


def _jackknife(
    design: FloatArray,
    freed: FloatArray,
    weights: FloatArray,
    left: FloatArray,
    inverse: FloatArray,
    block: I64,
) -> FloatArray:
    """Covariance of the unknowns, each block left out once.

    Source: C. F. J. Wu, "Jackknife, bootstrap and other resampling methods", Annals of Statistics, 1986.

    freed (M, 6 + K) : what the arcs leave of the design.  left (M,) : residuals of the fit.
    """
    count, size = int(block.max()) + 1, design.shape[1]
    normals, rights = np.zeros((count, size, size)), np.zeros((count, size))
    weighted = weights[:, None] * design
    np.add.at(rights, block, weighted * left[:, None])
    np.add.at(normals, block, weighted[:, :, None] * freed[:, None, :])
    whole = np.linalg.inv(inverse)
    moves = []
    for normal, right in zip(normals, rights, strict=True):
        rest = whole - normal
        if np.linalg.cond(rest) < PROFILE.max_condition:
            moves.append(-np.linalg.solve(rest, right))
    spread = np.array(moves)
    return np.asarray((len(spread) - 1) / len(spread) * (spread.T @ spread))


def _by_calibration(
    images: StereoImages, pose: FloatArray, profiles: Profiles, response: FloatArray
) -> FloatArray:
    """(6, 6) of the twist by the rig's covariance."""
    covariance = images.rig.covariance
    if covariance is None:
        return np.zeros((6, 6))
    points, normals = apply(pose, profiles.points), profiles.seen.normals
    shifts = shifts_by_calibration(images.rig, points, normals, normals)
    by_parameter = response @ shifts[profiles.camera, np.arange(len(points))]
    return np.asarray(by_parameter @ covariance @ by_parameter.T)


def _added(model: EdgeModel, images: StereoImages, profiles: Profiles) -> tuple[FloatArray, FloatArray]:
    """(M,) motion along the normals by a shift of the right picture across its rows, and by growth."""
    rows, right = np.zeros(len(profiles.camera)), profiles.camera == 1
    rows[right] = profiles.seen.normals[right] @ _across_rows(images)
    return rows, np.einsum("mj,mj->m", profiles.seen.design[:, 3:], profiles.points - model.centre)


def _extra(
    added: tuple[FloatArray, FloatArray], fit: _Adjusted, freed: FloatArray, excess: float, drawn: FloatArray
) -> tuple[float, float, float, float]:
    """Row shift and growth with their sigmas: each as one more unknown beside the pose.

    freed (M, 6 + K) : what the arcs leave of the design.  excess : how much more the edges scatter than their
    weights say.  drawn (K, M) : px, by which what is not known of the part moves its edges, one sigma each.
    """
    found, weights = [], fit.weights
    for column in added:
        rest = column - fit.design @ (fit.inverse @ (freed.T @ (weights * column)))
        open_rest = fit.arcs.free(weights, rest)
        power = float(open_rest @ (weights * column))
        if not power > 0:
            found += [math.nan, math.inf]
            continue
        by_part = drawn @ (weights * open_rest) / power
        found += [
            float(rest @ (weights * fit.left)) / power,
            math.sqrt(excess / power + float(by_part @ by_part)),
        ]
    return found[0], found[1], found[2], found[3]


def _across_rows(images: StereoImages) -> FloatArray:
    """(2,) unit: in the right raw picture, across the rows, at its middle."""
    camera, rectification = images.rig.right, images.rectification
    middle = rectification.rectify_points("right", np.array([[0.5 * camera.width, 0.5 * camera.height]]))
    ends = rectification.raw_points("right", np.vstack([middle, np.add(middle, (0.0, 1.0))]))
    along = ends[1] - ends[0]
    return np.asarray(along / np.linalg.norm(along))
