"""Fit the pose to profiles with the best blur, and estimate its covariance from blocks of curves."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import I64, FloatArray
from edged.vision.geometry.projection import shifts_by_calibration
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.solid.arcs import ArcShifts, deeper, facing
from edged.vision.solid.edgemodel import EdgeModel, chains_of
from edged.vision.solid.forms import PosedPair, likely_by, misfits_of, sigmas_behind, spread_of, twist_between
from edged.vision.solid.lock import Pyramids, scale_at
from edged.vision.solid.params import DECISION, PROFILE
from edged.vision.solid.profiles import AdjustedPose, Profiles, adjusted, by_curve
from edged.vision.solid.visible import moved


@dataclass(frozen=True, slots=True, eq=False)
class ProfileFit:
    """A pose rig_from_part (4, 4) by profiles.

    edges (6, 6) : covariance of the twist (turn about the part's axes and centre, shift along them) by the
    edges (jackknife), by light that shifts all of them alike, and by the widths of the edge breaks.
    calibration (6, 6) : the same by the rig's covariance.
    rms_px : of the residuals, weighted.
    row_shift_px, row_sigma_px : shift of the part in the right picture, across its rows, and sigma.
    growth, growth_sigma : share by which the part appears larger, and sigma.
    """

    pose: FloatArray
    edges: FloatArray
    calibration: FloatArray
    rms_px: float
    row_shift_px: float
    row_sigma_px: float
    growth: float
    growth_sigma: float


def best_fit(
    model: EdgeModel,
    pyramids: Pyramids,
    images: StereoImages,
    pose: FloatArray,
    held: FloatArray | None = None,
) -> ProfileFit | None:
    """Fit profiles with the blur that gives the smallest residuals; None if they show too little.

    The lock is good to a pixel, which turns a bar of a few pixels by degrees: its other edge is then as near.
    So the fit starts from poses turned so, too; those that explain the pictures as well widen the covariance.
    """
    fits = [_fitted(model, pyramids, images, start, held) for start in _starts(model, images, pose)]
    found = [fit for fit in fits if fit is not None]
    if not found:
        return None
    best = min(found, key=lambda fit: fit.rms_px)
    result = _with_covariance(model, images, best)
    if len(found) == 1:
        return result
    squares = [misfits_of(model, [PosedPair(images, pyramids, fit.pose)])[1] for fit in found]
    behind = np.array([sigmas_behind(each, squares[found.index(best)]) for each in squares])
    twists = np.array([twist_between(model, best.pose, fit.pose) for fit in found])
    return replace(result, edges=result.edges + spread_of(twists, likely_by(behind)))


def _starts(model: EdgeModel, images: StereoImages, pose: FloatArray) -> list[FloatArray]:
    """Poses to fit from: the locked one, and, of a narrow part, those a pixel of its rim to either side."""
    middles = (0.5 * (model.start + model.end) - model.centre)[:, :2]
    lengths = np.linalg.norm(model.end - model.start, axis=1)
    along = np.linalg.eigh(middles.T @ (lengths[:, None] * middles))[1][:, 1]
    half_px = np.abs(middles @ (-along[1], along[0])).max() * scale_at(images.rig, pose, model)
    turn = 1.0 / max(float(half_px), 1.0)
    if turn < DECISION.same_turn_rad:
        return [pose]
    twist = np.array([*(turn * along), 0.0, 0.0, 0.0, 0.0])
    return [pose, *(moved(model, pose, way * twist) for way in (1.0, -1.0))]


def _fitted(
    model: EdgeModel, pyramids: Pyramids, images: StereoImages, pose: FloatArray, held: FloatArray | None
) -> AdjustedPose | None:
    """The fit from one start, with the blur that gives the smallest residuals."""
    best: AdjustedPose | None = None
    for blur in PROFILE.blurs_px:
        fit = adjusted(model, pyramids, images, pose, blur, held)
        if fit is None or (best is not None and fit.rms_px > best.rms_px):
            break
        best = fit
    return best


def _with_covariance(model: EdgeModel, images: StereoImages, fit: AdjustedPose) -> ProfileFit:
    """Add to a fit its covariance by blocks of curves, light, the part's breaks and the rig."""
    profiles = fit.profiles
    design, left, weights = fit.design, fit.left, fit.weights
    inverse, freed = fit.inverse[:6], fit.arcs.free(weights, design)
    response = inverse @ (weights[:, None] * freed).T  # (6, M): motion of the twist by each shift
    by_light = PROFILE.light_px * (response @ np.sign(profiles.height))
    block = _blocks(2 * profiles.seen.curve + profiles.camera, fit.arcs)
    edges = jackknife(design, freed, weights, left, fit.inverse, block)[:6, :6] + np.outer(by_light, by_light)
    if model.taught_px:  # light may shift all curves by what single ones are off, as at teaching
        drawn_px = math.hypot(model.taught_px, disagreement_px(profiles, left + fit.aside))
        for camera, axis in itertools.product((0, 1), (0, 1)):
            by_camera = response @ np.where(profiles.camera == camera, profiles.seen.normals[:, axis], 0.0)
            edges += drawn_px**2 * np.outer(by_camera, by_camera)
    else:  # what faces one way in a picture, light shifts alike, whatever curve it belongs to
        edges += jackknife(design, freed, weights, left, fit.inverse, blocks_alike(profiles))[:6, :6]
    # how much more the edges scatter than their weights say, by the jackknife
    excess = max(float(np.trace(edges @ np.linalg.inv(inverse[:, :6]))) / 6, 1.0)
    by_breaks = model.sigma_break_mm * profiles.by_width[None]
    if model.sigma_own_mm:
        by_breaks = np.vstack([by_breaks, model.sigma_own_mm * by_curve(profiles, profiles.by_width)])
    by_breaks = np.vstack([by_breaks, fit.arcs.sigma * deeper(model, profiles.seen)])
    # known widths by their sigma, and what the edges leave open of the nuisance unknowns
    moves = np.hstack([response @ by_breaks.T, PROFILE.correlated * inverse[:, 6:]])
    edges += moves @ moves.T
    # what moved curves of one face apart at teaching may have moved all of them as far
    edges[5, 5] += model.height_mm**2
    units = np.outer(fit.scale, fit.scale)
    calibration = _by_calibration(images, fit.before, profiles, response)
    # a width that a pair has shown cannot explain growth; roundings of other radii can, where edges wander
    unknown = by_breaks if model.sigma_own_mm or model.merged_mm else by_breaks[:0]
    rounded = fit.arcs.sigma / PROFILE.on_arc * by_curve(profiles, profiles.rounded_px)
    unknown = np.vstack([unknown, rounded])
    extra = _extra(_added(model, images, profiles), fit, freed, excess, unknown)
    return ProfileFit(fit.pose, edges / units, calibration / units, fit.rms_px, *extra)


def disagreement_px(profiles: Profiles, left: FloatArray) -> float:
    """Rms by which the cameras disagree about the places of single curves, along the worse image axis.

    Where their views differ, light shows the upper end of a break to one camera and the lower one to the
    other: the curve as a whole is then off in parallax. 0 if no curve is seen.

    left (M,) : residuals of the fit.
    """
    chain, good = chains_of(profiles.seen.curve), profiles.weight > PROFILE.min_weight
    squares, expected = (
        np.zeros(2),
        np.zeros(2),
    )  # of differences, and their expectation for a shift of sigma 1
    for number in np.unique(chain[good]):
        apart, shares = np.zeros(2), np.zeros(2)
        for camera, sign in ((0, 1.0), (1, -1.0)):
            own = good & (chain == number) & (profiles.camera == camera)
            normals = profiles.seen.normals[own]
            information = normals.T @ normals / PROFILE.correlated
            known = np.linalg.inv(np.eye(2) + information)  # a straight edge shows only its shift across
            apart += sign * (known @ (normals.T @ left[own])) / PROFILE.correlated
            shares += np.square(known @ information).sum(axis=1)
        squares += apart**2
        expected += shares
    return math.sqrt(float((squares / np.maximum(expected, 1.0)).max()))


def _blocks(curve: I64, arcs: ArcShifts) -> I64:
    """(M,) numbers of the blocks of a jackknife: each curve in each camera, long ones cut.

    Profiles that share an unknown of an arc form one block.
    """
    longest = max(PROFILE.block, len(curve) // PROFILE.most_blocks)
    _, number, count = np.unique(curve, return_inverse=True, return_counts=True)
    place = np.empty(len(curve), np.int64)
    place[np.argsort(number, kind="stable")] = np.concatenate([np.arange(n) for n in count])
    own = np.where(arcs.across_px != 0, -1 - arcs.group, number * 10_000 + place // longest)
    _, result = np.unique(own, return_inverse=True)
    return np.asarray(result, np.int64)


def blocks_alike(profiles: Profiles) -> I64:
    """(M,) numbers of other blocks: of what becomes brighter in one direction in a camera.

    Errors are clustered two ways, by curves and so. The sum of both covariances is an upper bound: it has
    twice what the blocks share.  Source: A. C. Cameron, J. B. Gelbach, D. L. Miller, "Robust inference with
    multiway clustering", Journal of Business & Economic Statistics 29, 2011.
    """
    sector = facing(profiles.seen.normals * np.sign(profiles.height)[:, None])
    _, number = np.unique(profiles.camera * PROFILE.ways + sector, return_inverse=True)
    return np.asarray(number, np.int64)


def jackknife(
    design: FloatArray,
    freed: FloatArray,
    weights: FloatArray,
    left: FloatArray,
    inverse: FloatArray,
    block: I64,
) -> FloatArray:
    """Covariance of the unknowns by the jackknife: each block is left out once.

    Source: C. F. J. Wu, "Jackknife, bootstrap and other resampling methods", Annals of Statistics, 1986.

    freed (M, 6 + K) : the design with the arcs' unknowns eliminated.  left (M,) : residuals of the fit.
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
    """Covariance (6, 6) of the twist by that of the rig."""
    covariance = images.rig.covariance
    if covariance is None:
        return np.zeros((6, 6))
    points, normals = apply(pose, profiles.points), profiles.seen.normals
    shifts = shifts_by_calibration(images.rig, points, normals, normals)
    by_parameter = response @ shifts[profiles.camera, np.arange(len(points))]
    return np.asarray(by_parameter @ covariance @ by_parameter.T)


def _added(model: EdgeModel, images: StereoImages, profiles: Profiles) -> tuple[FloatArray, FloatArray]:
    """Motions (M,) along the normals by a shift of the right picture across its rows, and by growth."""
    rows, right = np.zeros(len(profiles.camera)), profiles.camera == 1
    rows[right] = profiles.seen.normals[right] @ _across_rows(images)
    return rows, np.einsum("mj,mj->m", profiles.seen.design[:, 3:], profiles.points - model.centre)


def _extra(
    added: tuple[FloatArray, FloatArray],
    fit: AdjustedPose,
    freed: FloatArray,
    excess: float,
    drawn: FloatArray,
) -> tuple[float, float, float, float]:
    """Row shift and growth with their sigmas: each as one more unknown beside the pose.

    freed (M, 6 + K) : the design with the arcs' unknowns eliminated.  excess : how much more the edges
    scatter than their weights say.  drawn (K, M) px : motion of the edges by each unknown of the part, one
    sigma each.
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
    """(2,) unit vector across the rectified rows, in the middle of the raw right picture."""
    camera, rectification = images.rig.right, images.rectification
    middle = rectification.rectify_points("right", np.array([[0.5 * camera.width, 0.5 * camera.height]]))
    ends = rectification.raw_points("right", np.vstack([middle, np.add(middle, (0.0, 1.0))]))
    along = ends[1] - ends[0]
    return np.asarray(along / np.linalg.norm(along))
