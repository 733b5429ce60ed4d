"""Plain-loop twins of the kernels of `vision/shape`: slow, but simple enough to trust."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.shape.chance import Chance
from edged.vision.shape.params import RotationParams


def shape_responses(gx: np.ndarray, gy: np.ndarray, minimum: int, unsigned: bool) -> np.ndarray:
    """(16, H, W): 7 cos(gradient direction - orientation), not rounded; of twice the angle when unsigned."""
    maps = np.zeros((16, *gx.shape))
    for y in range(gx.shape[0]):
        for x in range(gx.shape[1]):
            if math.hypot(gx[y, x], gy[y, x]) < max(math.sqrt(minimum), 1):
                continue
            direction = math.atan2(gy[y, x], gx[y, x])
            for o in range(16):
                turn = direction - 2 * math.pi * o / 16
                maps[o, y, x] = 7 * math.cos(2 * turn if unsigned else turn)
    return maps


def shape_similarity(
    maps: np.ndarray, points: np.ndarray, directions: np.ndarray, x: int, y: int, pose: np.ndarray
) -> int:
    """Sum of the responses (16, H, W) under the points of a pose (angle, scale x, scale y) at (x, y)."""
    total = 0
    for (px, py), direction in zip(points, directions, strict=True):
        u, v = px * pose[1], py * pose[2]
        i = x + math.floor(math.cos(pose[0]) * u - math.sin(pose[0]) * v + 0.5)
        j = y + math.floor(math.sin(pose[0]) * u + math.cos(pose[0]) * v + 0.5)
        o = math.floor((direction + pose[0]) * 16 / (2 * math.pi) + 0.5) % 16
        if 0 <= i < maps.shape[2] and 0 <= j < maps.shape[1]:
            total += int(maps[o, j, i])
    return total


def shape_point(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Image position of a model point under a pose vector."""
    return pose[:2] + pose[2:6].reshape(2, 2) @ point / (1 + pose[6:] @ point)


def shape_step(pose: np.ndarray, step: np.ndarray, freedom: int) -> np.ndarray:
    """A pose after a step of 3, 4, 5, 6 or 8 unknowns."""
    moved = pose.copy()
    moved[:2] += step[:2]
    if freedom <= 5:
        scales = {3: (1, 1), 4: (1 + step[-1], 1 + step[-1]), 5: (1 + step[-2], 1 + step[-1])}[freedom]
        turn = np.array([[math.cos(step[2]), -math.sin(step[2])], [math.sin(step[2]), math.cos(step[2])]])
        moved[2:6] = (turn @ pose[2:6].reshape(2, 2) @ np.diag(scales)).ravel()
    else:
        moved[2:freedom] += step[2:]
    return moved


def shape_edge(
    gx: np.ndarray, gy: np.ndarray, place: np.ndarray, reach: float, sign: int, minimum: float
) -> tuple[float, float]:
    """Offset and cos of the strongest, nearest extremum of the gradient along a normal; NaN, 0 for none."""

    def at(image: np.ndarray, x: float, y: float) -> float:
        i, j = math.floor(x), math.floor(y)
        a, b = x - i, y - j
        top = (1 - a) * image[j, i] + a * image[j, i + 1]
        return float((1 - b) * top + b * ((1 - a) * image[j + 1, i] + a * image[j + 1, i + 1]))

    x, y, nx, ny = place
    inner = math.ceil(reach) + 1
    best, offset, cosine = 0.0, math.nan, 0.0
    samples = []
    for s in range(-inner, inner + 1):
        u, v = at(gx, x + s * nx, y + s * ny), at(gy, x + s * nx, y + s * ny)
        samples.append((u * nx + v * ny, math.hypot(u, v)))
    for s in range(1, 2 * inner):
        factor = -1 if sign < 0 or (sign == 0 and samples[s][0] < 0) else 1
        before, here, after = (factor * samples[s + k][0] for k in (-1, 0, 1))
        if here < minimum or here < before or here <= after:
            continue
        position = s - inner + (before - after) / (2 * (before - 2 * here + after))
        weight = here * math.exp(-0.5 * (position / reach) ** 2)
        if abs(position) <= reach and weight > best:
            best, offset, cosine = weight, position, here / samples[s][1]
    return offset, cosine


def shape_agreement(gx: np.ndarray, gy: np.ndarray, place: np.ndarray, sign: int, minimum: float) -> float:
    """cos, of twice the angle for sign 0, between a placed normal and the gradient at the nearest pixel."""
    i, j = math.floor(place[0] + 0.5), math.floor(place[1] + 0.5)
    if not (0 <= i < gx.shape[1] and 0 <= j < gx.shape[0]):
        return 0.0
    if math.hypot(gx[j, i], gy[j, i]) < max(minimum, 1e-9):
        return 0.0
    turn = math.atan2(gy[j, i], gx[j, i]) - math.atan2(place[3], place[2])
    return math.cos(2 * turn) if sign == 0 else sign * math.cos(turn)


def shape_motion(points: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Largest displacement along x or y of any of the points between two poses."""
    return max(
        float(np.abs(shape_point(after, point) - shape_point(before, point)).max()) for point in points
    )


def meets(
    place: np.ndarray, outline: np.ndarray, across: float, along: float, alike: float
) -> tuple[float, float]:
    """Offset along its normal from a place (x, y, nx, ny) to the nearest point of the outline (M, 4) within
    reach, and the cosine of their normals; NaN and 0 without one."""
    best, found = math.inf, (math.nan, 0.0)
    for other in outline:
        dx, dy = other[:2] - place[:2]
        off, beside = dx * place[2] + dy * place[3], dx * place[3] - dy * place[2]
        cosine = abs(place[2:] @ other[2:])
        near = abs(off) < across and abs(beside) < along and cosine > alike
        if near and math.hypot(off, beside) < best:
            best, found = math.hypot(off, beside), (off, cosine)
    return found


def tukey_fit(design: np.ndarray, values: np.ndarray, iterations: int, floor: float) -> np.ndarray:
    """Robust least squares with Tukey's weights, by numpy's solver."""
    weights = np.ones(len(values))
    solution = np.zeros(design.shape[1])
    for _ in range(iterations):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        residuals = values - design @ solution
        ratio = residuals / (4.685 * max(1.4826 * float(np.median(np.abs(residuals))), floor))
        weights = np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
    return solution


def repetition(points: FloatArray) -> float:
    """Mean over the points p of the sum over all points q of exp(-2 d^2), where d is their distance."""
    return sum(math.exp(-2 * math.dist(p, q) ** 2) for p in points for q in points) / len(points)


def clumping(
    slope: np.ndarray, known: np.ndarray, sets: np.ndarray, often: float, few_places: int
) -> tuple[float, float]:
    """Excess scatter of edges, from slopes (PLACES, U), NaN where no face was seen, of points known (U,)."""
    scatter, freedom, points = [], 0, []
    for members in sets:
        rows = slope[:, members[known]]
        looked, met = np.isfinite(rows).sum(axis=1), (rows >= often).sum(axis=1)
        used = looked > 1
        if used.sum() <= few_places or not met.any():
            continue
        share = met.sum() / looked.sum()
        freedom += used.sum() - 1
        expected = looked[used] * share
        scatter += list((met[used] - expected) ** 2 / np.maximum(expected * (1 - share), 1e-9))
        points += list(looked[used])
    return (max(sum(scatter) / freedom, 1.0), float(np.mean(points))) if freedom else (1.0, 1.0)


def chance_of(
    slope: np.ndarray, sets: np.ndarray, strong: float, wanted: tuple[float, ...], params: RotationParams
) -> Chance:
    """Chance from slopes (PLACES, N) at each place, NaN where no face was seen."""
    ordered = sorted(slope[np.isfinite(slope)])
    exceeded = [ordered[math.ceil((1 - share) * len(ordered)) - 1] for share in wanted]
    known = np.flatnonzero(np.isfinite(slope).any(axis=0))
    scatter = max(
        clumping(slope[:, known], known, sets, max(level, params.min_slope), params.few_places)
        for level in exceeded[:-1]
    )
    thresholds = np.maximum(exceeded[1:], strong)
    looked = np.isfinite(slope[:, known]).sum(axis=0).astype(np.float64)
    met = np.array([(slope[:, known] >= level).sum(axis=0) for level in thresholds], np.float64)
    return Chance(known, looked, met, thresholds, *scatter)


def chance_shares(chance: Chance, sets: np.ndarray, params: RotationParams) -> np.ndarray:
    """Shares (T, K) of sets (K, N) that show an edge by chance."""
    shares = np.empty((len(chance.thresholds), len(sets)))
    for k, members in enumerate(sets[:, chance.known]):
        if chance.looked[members].sum() < params.few_looks:
            members = np.ones(len(members), bool)
        looked, met = chance.looked[members].sum(), chance.met[:, members].sum(axis=1)
        shares[:, k] = (met + 0.5) / (looked + 1) if looked else params.unknown
    return shares


def chance_evidence(
    chance: Chance,
    sets: np.ndarray,
    slopes: np.ndarray,
    strong: float,
    shares: np.ndarray,
    params: RotationParams,
) -> np.ndarray:
    """Nats (K,) of sets (K, N) by slopes (N,) or (K, N): Chernoff's bound at the best threshold."""
    nats = []
    for k, members in enumerate(sets):
        row = (slopes if slopes.ndim == 1 else slopes[k])[members]
        count = max(len(row), 1)
        shared = min((chance.repeated - 1) / max(chance.many - 1, 1), 1)
        independent = count / (1 + (min(count, params.curve_points) - 1) * shared)
        found = []
        for level, share in zip(np.maximum(chance.thresholds, strong), shares[:, k], strict=True):
            seen = min(max((row >= level).sum() / count, share), 1.0)
            rest = (1 - seen) * math.log((1 - seen) / (1 - share)) if seen < 1 else 0.0
            found.append(independent * (seen * math.log(seen / share) + rest))
        nats.append(max(found) - math.log(len(found)))
    return np.array(nats)


def shape_is_within(
    pose: np.ndarray,
    sizes: tuple[float, float],
    sizes_y: tuple[float, float] | None,
    view_stretch: float | None,
    turns: tuple[float, float],
    slack: float,
    max_stretch: float,
) -> bool:
    """Whether a pose's size, stretch and turn lie in ranges; turns : start and extent."""
    linear = pose[2:6].reshape(2, 2)
    if not np.isfinite(pose).all() or not np.linalg.det(linear) > 0:
        return False
    along = np.linalg.norm(linear, axis=0)
    size, ratio = math.sqrt(np.linalg.det(linear)), max(along) / min(along)
    if view_stretch is not None:
        scales = np.linalg.svd(linear, compute_uv=False)
        size, ratio = scales[0], scales[0] / scales[1] / view_stretch
    elif sizes_y is not None:
        size, ratio = along[0], 0.0
        if not (1 - slack) * sizes_y[0] <= along[1] <= (1 + slack) * sizes_y[1]:
            return False
    if not (1 - slack) * sizes[0] <= size <= (1 + slack) * sizes[1] or not ratio < max_stretch:
        return False
    turn = math.atan2(pose[4] - pose[3], pose[2] + pose[5])
    return any(
        turns[0] - slack <= turn + whole <= turns[0] + turns[1] + slack
        for whole in (-2 * math.pi, 0.0, 2 * math.pi, 4 * math.pi)
    )


def shape_covariance(matrix: np.ndarray, freedom: int, sigma: float, pose: np.ndarray) -> np.ndarray:
    """Covariance (5, 5) of x, y, angle, scale x, scale y by differences of what a step does."""

    def numbers(step: np.ndarray) -> np.ndarray:
        moved = shape_step(pose, step, freedom)
        a, b, c, d = moved[2:6]
        return np.array([*moved[:2], math.atan2(c - b, a + d), math.hypot(a, c), math.hypot(b, d)])

    unit = 1e-6 * np.eye(freedom)
    by_step = np.column_stack([(numbers(row) - numbers(-row)) / 2e-6 for row in unit])
    inner = np.linalg.inv(matrix[:freedom, :freedom] + 1e-9 * np.eye(freedom)) * sigma**2
    return by_step @ inner @ by_step.T


def shape_odd_signs(
    points: np.ndarray, slopes: np.ndarray, cell_px: float, offsets: np.ndarray
) -> np.ndarray:
    """Offsets (N,), NaN where the contrast is opposite to that of the other edges in its cell."""
    cells: dict[tuple[float, ...], float] = {}
    cell = [tuple(np.floor((point - points.min(axis=0)) / cell_px)) for point in points]
    for where, slope, offset in zip(cell, slopes, offsets, strict=True):
        cells[where] = cells.get(where, 0.0) + (np.sign(slope) if np.isfinite(offset) else 0.0)
    return np.array(
        [
            math.nan if np.sign(slope) * cells[where] < 0 else offset
            for where, slope, offset in zip(cell, slopes, offsets, strict=True)
        ]
    )
