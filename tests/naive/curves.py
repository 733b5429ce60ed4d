"""Plain-loop twins of the kernels of `vision/curves`: slow, but simple enough to trust."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.curves.outlines import CurveOutline
from edged.vision.curves.samples import Samples
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.projection import project_with_jacobians
from naive.kernels import median_scale, tukey_weights


def correlation_length(residuals: FloatArray, weights: FloatArray) -> float:
    """1 + 2 x the sum of autocorrelations of a closed curve's samples, up to the first lag without one."""
    good = weights > 0.05
    if not good.any() or not np.sum(residuals[good] ** 2) > 0:
        return 1.0
    power, total = float(np.mean(residuals[good] ** 2)), 1.0
    for lag in range(1, max(2, min(24, len(residuals) // 8))):
        both = good & np.roll(good, lag)
        if both.sum() < 8:
            break
        correlation = float(np.mean((residuals * np.roll(residuals, lag))[both])) / power
        if correlation <= 2 / math.sqrt(both.sum()):
            break
        total += 2 * correlation
    return total


def solve(
    samples: Samples, unknowns: int, priors: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(delta, covariance, weights, bias), where each systematic shift is an explicit unknown with a prior."""
    curves, many, starts = len(samples.kinds), samples.waves.shape[1], samples.starts
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(starts)]
    shared = samples._replace(design=_in_bins(samples.design, parts), waves=_in_bins(samples.waves, parts))
    size = unknowns + curves * many
    prior = np.zeros(size)
    prior[unknowns - priors :] = 1.0
    bias = np.maximum(samples.expected, 0.03)
    dense = _with_shifts(shared, bias, unknowns)
    weights, scale, spread = samples.base.copy(), np.ones(len(parts)), np.ones(len(parts))
    delta, covariance = np.zeros(size), np.eye(size)
    for round_ in range(20):
        precision = weights / np.repeat(scale**2 * spread, np.diff(starts))
        covariance = np.linalg.inv((dense * precision[:, None]).T @ dense + np.diag(prior))
        previous, delta = delta, covariance @ (dense.T @ (precision * samples.values))
        residuals = samples.values - dense @ delta
        for q, rows in enumerate(parts):
            scale[q], weights[rows] = _weighed(residuals[rows], samples.base[rows], round_)
        for k in np.flatnonzero(samples.paired) if round_ >= 3 else ():
            first, second = parts[samples.parts[k]], parts[samples.parts[k] + 1]
            base = samples.base[first]
            both = np.where(base > 0, weights[first] * weights[second] / np.maximum(base, 1e-9), 0.0)
            weights[first] = weights[second] = both
        if round_ in (4, 6):
            spread[:] = [correlation_length(residuals[rows], weights[rows]) for rows in parts]
        if 3 <= round_ <= 6 and many:
            bias = _learned_bias(shared, bias, delta, covariance, unknowns)
            dense = _with_shifts(shared, bias, unknowns)
        if round_ > 6 and np.abs(delta - previous)[: unknowns - priors].max() < 1e-5:
            break
    return delta[:unknowns], covariance[:unknowns, :unknowns], weights, bias


def _in_bins(rows: FloatArray, parts: list[slice]) -> FloatArray:
    """Rows replaced by the mean of their neighbours where a part has enough of them."""
    means = rows.copy()
    for part in parts:
        count = part.stop - part.start
        together = max(1, min(4, count // 32))
        for first in range(part.start, part.stop, together):
            some = slice(first, min(first + together, part.stop))
            means[some] = rows[some].mean(axis=0)
    return means


def _weighed(residuals: FloatArray, base: FloatArray, round_: int) -> tuple[float, FloatArray]:
    """(scale, weights) of a part."""
    scale = max(median_scale(residuals, base), 0.01)
    ratio = residuals / scale
    if round_ < 3:
        return scale, base / np.maximum(1.0, np.abs(ratio))
    weights = base * tukey_weights(ratio)
    total = float(weights.sum())
    if total > 0:
        scale = max(math.sqrt(float(np.sum(weights * residuals**2)) / total) * 1.06, 0.01)
    return scale, weights


def _with_shifts(samples: Samples, bias: FloatArray, unknowns: int) -> FloatArray:
    """The design matrix with the shifts of each curve as unknowns, in units of their sigma."""
    curves, many = len(samples.kinds), samples.waves.shape[1]
    dense = np.zeros((len(samples.design), unknowns + curves * many))
    for k in range(curves):
        rows = slice(*samples.starts[samples.parts[k : k + 2]])
        for c, column in enumerate(samples.columns[k]):
            if column >= 0:
                dense[rows, column] += samples.design[rows, c]
        for first in (unknowns + k * many, samples.shared[k]):
            if first >= 0:
                dense[rows, first : first + many] = samples.waves[rows] * bias[k][samples.families]
    return dense


def _learned_bias(
    samples: Samples, bias: FloatArray, delta: FloatArray, covariance: FloatArray, unknowns: int
) -> FloatArray:
    """Sigmas of the shifts, learned from the estimates of each, all of them being unknowns here."""
    variance, many = np.diag(covariance), samples.waves.shape[1]
    learned = np.zeros_like(bias)
    for kind, family in itertools.product(np.unique(samples.kinds), np.unique(samples.families)):
        members = [int(k) for k in np.flatnonzero(samples.kinds == kind)]
        firsts = [(unknowns + k * many, k) for k in members]
        firsts += [(int(first), min(k for k in members if samples.shared[k] == first))
                   for first in {samples.shared[k] for k in members} if first >= 0]  # fmt: skip
        square = known = chance = 0.0
        for first, k in firsts:
            rows = first + np.flatnonzero(samples.families == family)
            share, ratio = 1 - variance[rows], (bias[k, family] / samples.expected[k, family]) ** 2
            square += float(np.sum(delta[rows] ** 2)) * ratio
            known += float(np.sum(share**2))
            chance += float(np.sum(share * (1 - share))) * ratio
        excess = max(square - chance, 0.0)
        learned[members, family] = samples.expected[members, family] * math.sqrt((1 + excess) / (1 + known))
    return learned


def edge_weights(
    offset: FloatArray, slope: FloatArray, clipped: npt.NDArray[np.bool_], min_slope: float
) -> FloatArray:
    """Prior weights of one curve's edges: none, clipped, or by the contrast around them."""
    known = np.isfinite(offset) & (np.abs(np.nan_to_num(slope)) >= min_slope)
    base = np.where(known, np.where(clipped, 0.02, 1.0), 0.0)
    around = np.zeros(len(offset))
    for n in np.nonzero(known)[0]:
        beside = [(n + shift) % len(offset) for shift in range(-4, 5)]
        around[n] = np.mean([abs(slope[other]) for other in beside if known[other]])
    if known.any():
        base *= np.minimum(1.0, around / np.median(around[known])) ** 2
    return base


def variance_of_mean(
    values: FloatArray, base: FloatArray, waves: FloatArray, rounds: int, shares: FloatArray
) -> tuple[float, float, FloatArray]:
    """Variance of the mean after removing the waves, mean square of the waves, and weights of the samples."""
    if (base > 0).sum() < 12:
        return math.inf, 0.0, shares
    slow = np.zeros_like(values)
    for _ in range(rounds):
        root = np.sqrt(base * shares)
        slow = waves @ np.linalg.lstsq(waves * root[:, None], values * root, rcond=None)[0]
        shares = tukey_weights((values - slow) / max(median_scale(values - slow, base), 1e-3))
    weights = base * shares
    total = float(weights.sum())
    variance = max(float(np.sum(weights * (values - slow) ** 2)) / total, 0.01**2)
    spread = correlation_length(values - slow, weights)
    return variance * spread / total, float(np.sum(weights * slow**2)) / total, shares


def choose_width(
    offset: FloatArray,
    slope: FloatArray,
    clipped: npt.NDArray[np.bool_],
    waves: FloatArray,
    min_slope: float,
    widths: tuple[float, ...],
) -> tuple[int, FloatArray, float, float]:
    """(index of the best width, its weights, bias, blur²) of one curve; offset and slope (W, N)."""
    bases = [edge_weights(o, s, clipped, min_slope) for o, s in zip(offset, slope, strict=True)]
    values = [np.where(base > 0, o, 0.0) for o, base in zip(offset, bases, strict=True)]
    merits, squares = [], []
    shares = alike = np.ones(len(waves))
    for w, (value, base) in enumerate(zip(values, bases, strict=True)):
        variance, _, shares = variance_of_mean(value, base, waves, 2 if w else 4, shares)
        doubt = slow = 0.0
        if w:
            both = np.minimum(base, bases[0])
            doubt, slow, alike = variance_of_mean(value - values[0], both, waves, 4 if w == 1 else 2, alike)
        chance = waves.shape[1] * doubt
        squares.append(slow - chance if slow > 1.6 * chance else 0.0)
        merits.append(variance + (squares[-1] if slow > 3 * chance else 0.0))
    best = int(np.argmin(merits))
    bias = max(1.3 * math.sqrt(squares[2] / waves.shape[1]), 0.0003)
    both = (bases[0] > 0) & (bases[2] > 0)
    if not both.any():
        return best, bases[best], bias, 0.0
    ratio = float(np.median(slope[0, both] / slope[2, both])) ** 2
    narrow, wide = widths[0] ** 2, widths[2] ** 2
    blur2 = float(np.clip((wide - ratio * narrow) / (ratio - 1), 0, wide)) if ratio > 1 else wide
    return best, bases[best], bias, blur2


def outline_samples(
    camera: CameraModel, pose: FloatArray, axes: FloatArray, origin: FloatArray, outline: CurveOutline
) -> FloatArray:
    """(N, 8 + F) of points of a face: pixel, normal, gain, then the design (see `ProjectedOutline`).

    axes (3, 3) : rows u, v, n of the face, origin (3,), rig frame.  pose (4, 4) : camera_from_rig.
    """
    rows = []
    u, v, n = axes
    for (x, y, height), (a, b), speed in zip(outline.points, outline.normals, outline.speed, strict=True):
        across, along = a * u + b * v, a * v - b * u
        point = pose[:3, :3] @ (origin + x * u + y * v + height * n) + pose[:3, 3]
        pixels, by_point, _ = project_with_jacobians(camera, point[None])
        by_rig = by_point[0] @ pose[:3, :3]
        tangent = by_rig @ along
        normal = np.array([tangent[1], -tangent[0]]) / np.linalg.norm(tangent)
        normal *= np.sign(normal @ by_rig @ across)
        motion = normal @ by_rig
        # a slope of 1 along u lifts the point by x, and tilts walls on the plane against u
        plane = [motion @ n, motion @ (x * n - height * u), motion @ (y * n - height * v)]
        rows.append(np.concatenate([pixels[0], normal, [motion @ across], plane, motion @ across * speed]))
    return np.array(rows)


def curvatures(pixels: FloatArray, normals: FloatArray) -> FloatArray:
    """(N,) turn of the normal from each sample's predecessor to its successor, per length, on one curve."""
    angles = np.arctan2(normals[:, 1], normals[:, 0])
    turn = np.abs(np.angle(np.exp(1j * (np.roll(angles, -1) - np.roll(angles, 1)))))
    return turn / np.linalg.norm(np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0), axis=1)


def paired_rows(
    offset: FloatArray, base: FloatArray, gain: FloatArray, starts: FloatArray, together: bool
) -> list[list[tuple[FloatArray, FloatArray, float, float]]]:
    """Parts of each curve: lists of (row of the left image's weights, of the right one's, value, base).

    The first two, (N,), are the weights of a sample's two images in the row. Parts are means, differences,
    left alone, right alone, those with too few edges left out.
    """
    total, most = len(base[0]), np.abs(gain).max()
    share = np.full(total, 0.5)
    both = np.zeros(total, bool)
    if together:
        both = (np.abs(gain).min(axis=0) > 0.05 * most) & (base.min(axis=0) > 0.2 * base.max(axis=0))
        share = _camera_shares(np.nan_to_num(offset) / gain, both, starts)
    found = []
    for first, last in itertools.pairwise(starts):
        parts: dict[str, list[tuple[FloatArray, FloatArray, float, float]]] = {}
        for n in range(first, last):
            unit, middle = np.eye(total)[n], gain[:, n].mean()
            left, right = middle / gain[0, n] * unit, middle / gain[1, n] * unit
            rows = [share[n] * left, left, unit, 0 * unit], [(1 - share[n]) * right, -right, 0 * unit, unit]
            weight = 2 / (1 / base[0, n] + 1 / base[1, n]) if both[n] else 0.0
            weights = [weight, weight, *(0.0 if both[n] else float(value) for value in base[:, n])]
            for name, of_left, of_right, heavy in zip("mdlr", *rows, weights, strict=True):
                value = float((of_left @ np.nan_to_num(offset[0])) + (of_right @ np.nan_to_num(offset[1])))
                parts.setdefault(name, []).append((of_left, of_right, value, heavy))
        found.append([part for part in parts.values() if sum(row[3] > 0 for row in part) >= 12])
    return found


def _camera_shares(places: FloatArray, both: npt.NDArray[np.bool_], starts: FloatArray) -> FloatArray:
    """(N,) share of the left camera, larger the less it scatters."""
    share = np.full(len(both), 0.5)
    for first, last in itertools.pairwise(starts):
        rows = [n for n in range(first, last - 8) if both[n] and both[n + 8]]
        if len(rows) < 12:
            continue
        left, right = (np.array([side[n + 8] - side[n] for n in rows]) for side in places)
        squares = []
        for values in (left, right, left - right):
            limit = 2.5 * median_scale(values, np.ones(len(values)))
            squares.append(float(np.mean(np.minimum(np.abs(values), limit) ** 2)))
        if squares[2] > 0:
            share[first:last] = np.clip(0.5 * (squares[2] + squares[1] - squares[0]) / squares[2], 0.1, 0.9)
    return share


def displaced(normals: FloatArray, gain: FloatArray, slant: FloatArray) -> FloatArray:
    """(2, N, 12) : two waves in space, two waves of the cameras against each other, two walls."""
    angle = np.arctan2(normals[:, 1], normals[:, 0])
    waves = [np.ones(len(angle)), *(f(m * angle) for m in (1, 2) for f in (np.cos, np.sin))]
    waves = np.column_stack(waves) * np.array([1.5, *(math.sqrt(2) * np.array([1.0, 1.0, 0.5, 0.5]))])
    sides = []
    for side, half in enumerate((0.5, -0.5)):
        lit = [np.maximum(sign * slant[side] / 0.05, 0.0) for sign in (1, -1)]
        walls = np.column_stack([1.5 * way * np.exp(1 - way) for way in lit])
        columns = np.hstack([waves, half * waves, walls])
        sides.append(columns * (gain[side] / np.abs(gain.mean(axis=0)))[:, None])
    return np.stack(sides)


def across_rows(rig: StereoRig, points_mm: FloatArray, pixels: FloatArray, normals: FloatArray) -> FloatArray:
    """(2, N) : motion along the normals when the right image moves by 0.3 px across the epipolar lines.

    points_mm (N, 3), rig frame; pixels, normals (2, N, 2).
    """
    rotation, translation = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]
    centre, found = -rotation.T @ translation, np.empty((2, len(points_mm)))
    for n, point in enumerate(points_mm):
        beyond = (
            rig.left.project(point + 1e-3 * (point - centre)),
            rig.right.project(rotation @ (1.001 * point) + translation),
        )
        for side in range(2):
            line = beyond[side] - pixels[side, n]
            across = np.array([-line[1], line[0]]) / np.linalg.norm(line)
            found[side, n] = 0.15 * normals[side, n] @ across
    return found
