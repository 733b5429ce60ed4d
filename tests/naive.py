"""Plain-loop twins of the kernels: slow, short, and obviously right.

A kernel is tested against its twin, the twin against the eye of the reader.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.sim.render import scene
from edged.vision.curves.adjustment import Samples
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.projection import project_with_jacobians

# --- edged.sim.raster ------------------------------------------------------------------------


def half_plane_coverage(distance: float, slope_x: float, slope_y: float, n: int = 400) -> float:
    """Share of n x n points of the unit cell on the negative side of a line."""
    steps = (np.arange(n) + 0.5) / n - 0.5
    return float(np.mean(distance + slope_x * steps[None, :] + slope_y * steps[:, None] < 0))


def shape_covers(shape: scene.Shape, u: float, v: float) -> bool:
    """Whether a point of the plane lies in a shape, from the words that define it."""
    match shape:
        case scene.Disc(x, y, radius):
            return (u - x) ** 2 + (v - y) ** 2 < radius**2
        case scene.Slot(x, y, length, width, angle):
            a = math.cos(angle) * (u - x) + math.sin(angle) * (v - y)
            b = -math.sin(angle) * (u - x) + math.cos(angle) * (v - y)
            along = min(max(a, -(length - width) / 2), (length - width) / 2)
            return (a - along) ** 2 + b**2 < (width / 2) ** 2
        case scene.Box(x, y, width, height, corner, angle):
            a = abs(math.cos(angle) * (u - x) + math.sin(angle) * (v - y))
            b = abs(-math.sin(angle) * (u - x) + math.cos(angle) * (v - y))
            if a > width / 2 - corner and b > height / 2 - corner:
                return (a - width / 2 + corner) ** 2 + (b - height / 2 + corner) ** 2 < corner**2
            return a < width / 2 and b < height / 2
        case scene.Polygon(points):
            crossings = 0
            for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1], strict=True):
                if (ay > v) != (by > v) and u < ax + (v - ay) / (by - ay) * (bx - ax):
                    crossings += 1
            return crossings % 2 == 1
        case scene.Checker(x, y, square, columns, rows):
            column, row = math.floor((u - x) / square), math.floor((v - y) / square)
            return 0 <= column < columns and 0 <= row < rows and (column + row) % 2 == 0
        case scene.DotGrid(x, y, radius, pitch, columns, rows):
            return any(
                (u - x - i * pitch) ** 2 + (v - y - j * pitch) ** 2 < radius**2
                for i in range(columns)
                for j in range(rows)
            )
    raise AssertionError(shape)


def radiance_at(world: scene.Scene, ray: FloatArray) -> float:
    """Radiance of an untextured scene along one ray (X/Z, Y/Z) of the rig frame."""

    def hit(rig_from_plane: FloatArray) -> tuple[float, float, float]:
        normal, origin = rig_from_plane[:3, 2], rig_from_plane[:3, 3]
        direction = np.array([ray[0], ray[1], 1.0])
        point = direction * (normal @ origin) / (normal @ direction)
        u, v, _ = rig_from_plane[:3, :3].T @ (point - origin)
        gradient = world.light.gradient_per_mm
        return u, v, world.light.level * (1 + gradient[0] * point[0] + gradient[1] * point[1])

    *_, light = hit(world.table.rig_from_table)
    value = world.table.surface.albedo * light
    for placed in world.parts:
        u, v, light = hit(placed.rig_from_part)
        if not shape_covers(placed.part.outline, u, v):
            continue
        behind, value = value, placed.part.surface.albedo * light
        for mark in placed.part.marks:
            if shape_covers(mark.shape, u, v):
                value = mark.albedo * light
        for hole in placed.part.holes:
            if shape_covers(hole.shape, u, v):
                value = hole.transmission * behind
    return value


def sensor_expose(
    radiance: FloatArray, normal: FloatArray, sensor: scene.Sensor, exposure_us: float, gain_db: float
) -> Image:
    """Grey values of given radiance and standard normal noise."""
    image = np.empty(radiance.shape, np.uint8)
    for index in np.ndindex(radiance.shape):
        share_of_well = radiance[index] * sensor.white / 255 * exposure_us / sensor.nominal_exposure_us
        electrons = share_of_well * sensor.full_well_e
        electrons += normal[index] * math.sqrt(electrons + sensor.read_noise_e**2)
        grey = sensor.black + electrons / sensor.full_well_e * 255 * 10 ** (gain_db / 20)
        image[index] = max(0, min(255, math.floor(grey + 0.5)))
    return image


# --- chessboard corners -------------------------------------------------------------------------


def corner_model(
    image: np.ndarray, p: np.ndarray, window: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grey values, corner model and its Jacobian (by central differences) over a disc.

    p : x, y, two edge directions, log blur, grey, half contrast, slope of light x, y.
    window : x, y, radius, curvatures of both edges.
    """

    def model(q: np.ndarray, x: int, y: int) -> float:
        sides = []
        for angle, curvature in ((q[2], window[3]), (q[3], window[4])):
            along = (x - q[0]) * math.cos(angle) + (y - q[1]) * math.sin(angle)
            beside = (y - q[1]) * math.cos(angle) - (x - q[0]) * math.sin(angle)
            sides.append(math.erf((beside - 0.5 * curvature * along**2) / (math.sqrt(2) * math.exp(q[4]))))
        light = 1 + q[7] * (x - q[0]) + q[8] * (y - q[1])
        return (q[5] + q[6] * sides[0] * sides[1]) * light

    return _over_disc(image, p, window, model)


def dot_model(
    image: np.ndarray, p: np.ndarray, window: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grey values, dot model and its Jacobian over a disc.

    p : x, y, b11, b12, b22, log blur in radii, grey, half contrast, slope of light x, y.
    """

    def model(q: np.ndarray, x: int, y: int) -> float:
        offset = np.array([x - q[0], y - q[1]])
        radius = np.linalg.norm(np.array([[q[2], q[3]], [q[3], q[4]]]) @ offset)
        edge = math.erf((radius - 1) / (math.sqrt(2) * math.exp(q[5])))
        return float((q[6] + q[7] * edge) * (1 + q[8] * offset[0] + q[9] * offset[1]))

    return _over_disc(image, p, window, model)


def _over_disc(
    image: np.ndarray, p: np.ndarray, window: np.ndarray, model: Callable[[np.ndarray, int, int], float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, model and Jacobian (by central differences) at every pixel of the window's disc."""
    values, models, rows = [], [], []
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if (x - window[0]) ** 2 + (y - window[1]) ** 2 > window[2] ** 2:
                continue
            values.append(float(image[y, x]))
            models.append(model(p, x, y))
            steps = np.eye(len(p)) * 1e-5
            rows.append([(model(p + step, x, y) - model(p - step, x, y)) / 2e-5 for step in steps])
    return np.array(values), np.array(models), np.array(rows)


# --- edged.vision.ncc and leastsquares ----------------------------------------------------------


def sheared_window(image: Image, x: int, y: int, stretch: float, shear: float, half: int) -> FloatArray:
    """Grey values at x + stretch a + shear b in row y + b, linear between the columns of each row."""
    columns = np.arange(image.shape[1])
    steps = range(-half, half + 1)
    return np.array(
        [[np.interp(x + stretch * a + shear * b, columns, image[y + b]) for a in steps] for b in steps]
    )


def ncc_along_row(window: FloatArray, image: Image, x: int, y: int, count: int) -> FloatArray:
    """Pearson's correlation of a window with those around (x, y), (x + 1, y), ..."""
    half = window.shape[0] // 2
    scores = []
    for centre in range(x, x + count):
        other = image[y - half : y + half + 1, centre - half : centre + half + 1].astype(float)
        flat = window.std() == 0 or other.std() == 0
        scores.append(0.0 if flat else np.corrcoef(window.ravel(), other.ravel())[0, 1])
    return np.array(scores)


def find_peak(scores: list[float]) -> tuple[int, float, float]:
    """Index of the highest score, or -1 at an end; its score; the ratio of the next hill to it."""
    best = scores.index(max(scores))
    if best in (0, len(scores) - 1):
        return -1, scores[best], math.nan
    first, last = best, best
    while first > 0 and scores[first - 1] < scores[first]:
        first -= 1
    while last + 1 < len(scores) and scores[last + 1] < scores[last]:
        last += 1
    return best, scores[best], max([0.0, *scores[:first], *scores[last + 1 :]]) / scores[best]


def smoothing_matrix(size: int, taps: FloatArray) -> FloatArray:
    """(size², wide²) matrix that smooths a flattened patch of wide = size + len(taps) - 1 squared."""
    wide = size + len(taps) - 1
    matrix = np.zeros((size, size, wide, wide))
    for j, i in np.ndindex(size, size):
        matrix[j, i, j : j + len(taps), i : i + len(taps)] = np.outer(taps, taps)
    return matrix.reshape(size * size, wide * wide)


def spline_value(coefficients: FloatArray, position: float) -> float:
    """A cubic spline from its coefficients at whole positions: the sum of its bells."""
    total = 0.0
    for k, coefficient in enumerate(coefficients):
        distance = abs(position - k)
        if distance < 1:
            total += coefficient * (2 / 3 - distance**2 + distance**3 / 2)
        elif distance < 2:
            total += coefficient * (2 - distance) ** 3 / 6
    return total


def matching_jacobian(value: FloatArray, slope: FloatArray, gain: float) -> FloatArray:
    """(n², 5) derivatives of gain * value(x - shift - slopes · (u, v)) + offset."""
    half = value.shape[0] // 2
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    columns = [-gain * slope, -gain * slope * u, -gain * slope * v, value, np.ones_like(value)]
    return np.stack(columns, axis=-1).reshape(-1, 5)


# --- edged.vision.edges -------------------------------------------------------------------------


def cubic_value(image: Image, x: float, y: float) -> float:
    """Keys' cubic convolution (a = -1/2) at one place inside: the sum of the pixels under its bell."""

    def bell(distance: float) -> float:
        d = abs(distance)
        if d < 1:
            return 1.5 * d**3 - 2.5 * d**2 + 1
        return -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2 if d < 2 else 0.0

    total = 0.0
    for row in range(math.floor(y) - 1, math.floor(y) + 3):
        for column in range(math.floor(x) - 1, math.floor(x) + 3):
            total += bell(x - column) * bell(y - row) * float(image[row, column])
    return total


def edge_along_normal(
    image: Image,
    point: FloatArray,
    normal: FloatArray,
    reach_px: float,
    polarity: int,
    sigma_px: float,
    step_px: float,
) -> tuple[float, float, bool]:
    """Offset and slope of the strongest edge across one point (NaN where there is none), and whether the
    sensor clips within 2.5 px of it."""
    inner, radius = math.ceil(reach_px / step_px) + 1, math.ceil(3.5 * sigma_px / step_px)
    height, width = image.shape

    def grey(place: int) -> float:
        x, y = point + place * step_px * normal
        return cubic_value(image, x, y)

    for place in (-inner - radius, inner + radius):
        x, y = point + place * step_px * normal
        if not (1 <= x < width - 2 and 1 <= y < height - 2):
            return math.nan, math.nan, False
    taps = [i * math.exp(-0.5 * (i * step_px / sigma_px) ** 2) for i in range(-radius, radius + 1)]
    gain = sum(i * step_px * tap for i, tap in zip(range(-radius, radius + 1), taps, strict=True))
    slopes = [
        sum(tap * grey(s + i) for i, tap in zip(range(-radius, radius + 1), taps, strict=True)) / gain
        for s in range(-inner, inner + 1)
    ]
    best, found = 0.0, (math.nan, math.nan)
    for s in range(1, 2 * inner):
        sign = polarity or (-1 if slopes[s] < 0 else 1)
        before, here, after = (sign * slope for slope in slopes[s - 1 : s + 2])
        if here > 0 and here >= before and here > after:
            hill = min(before, after) > 0.25 * here  # a Gaussian is a parabola in its logarithm
            values = [math.log(v) if hill else v for v in (before, here, after)]
            c, b, a = np.linalg.solve([[1, -1, 1], [1, 0, 0], [1, 1, 1]], values)  # c + b x + a x²
            fraction, top = -b / (2 * a), c - b * b / (4 * a)
            peak = math.exp(top) if hill else top
            offset = (s - inner + fraction) * step_px
            weight = peak * math.exp(-0.5 * (offset / reach_px) ** 2)
            if abs(offset) <= reach_px and weight > best:
                best, found = weight, (offset, math.copysign(peak, slopes[s]))
    if math.isnan(found[0]):
        return *found, False
    beside = range(int(found[0] / step_px - 2.5 / step_px), math.ceil(found[0] / step_px + 2.5 / step_px) + 1)
    greys = [grey(place) for place in beside if abs(place) <= inner + radius]
    return *found, max(greys) >= 254.5 or min(greys) <= 0.5


# --- edged.vision.startplane --------------------------------------------------------------------


def row_edges(
    image: Image, point: FloatArray, sign: float, low: float, high: float, min_slope: float
) -> list[tuple[float, float]]:
    """(slope, disparity) of all edges of one sign on a point's row, strongest first; three rows together."""
    height, width = image.shape
    row = round(float(point[1]))
    if not 1 <= row <= height - 2:
        return []
    taps = np.array([-2, -1, 0, 1, 2])
    total = image[row - 1 : row + 2].astype(int).sum(axis=0)
    slope = (
        sign * np.array([taps @ total[x - 2 : x + 3] for x in range(2, width - 2)]) / 30
    )  # of column x + 2
    found = []
    for x in range(max(3, math.floor(point[0] - high)), min(width - 4, math.ceil(point[0] - low)) + 1):
        before, here, after = slope[x - 3], slope[x - 2], slope[x - 1]
        if here >= min_slope and here >= before and here > after:
            place = x + 0.5 * (before - after) / (before - 2 * here + after)
            found.append((float(here), float(point[0] - place)))
    return sorted(found, reverse=True)


def plane_agreement(
    points: FloatArray, rivals: FloatArray, plane: tuple[float, float, float], tolerance: float
) -> int:
    """How many points have a rival within the tolerance of d = a x + b y + c."""
    a, b, c = plane
    return sum(
        any(abs(rival - (a * x + b * y + c)) < tolerance for rival in row if not math.isnan(rival))
        for (x, y), row in zip(points, rivals, strict=True)
    )


# --- edged.vision.shape ------------------------------------------------------------------------


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
    """Where a pose vector puts a model point."""
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
    """How far along x or y the farthest of the points moves between two poses."""
    return max(
        float(np.abs(shape_point(after, point) - shape_point(before, point)).max()) for point in points
    )


def lies_beside(place: np.ndarray, outline: np.ndarray, across: float, along: float, alike: float) -> bool:
    """Whether a place (x, y, nx, ny) has a point of the outline (M, 4) beside it, normals alike."""
    for other in outline:
        dx, dy = place[:2] - other[:2]
        near = abs(dx * place[2] + dy * place[3]) < across and abs(dx * place[3] - dy * place[2]) < along
        if near and abs(place[2:] @ other[2:]) > alike:
            return True
    return False


def tukey_fit(design: np.ndarray, values: np.ndarray, iterations: int, floor: float) -> np.ndarray:
    """Robust least squares with Tukey's weights by numpy's solver."""
    weights = np.ones(len(values))
    solution = np.zeros(design.shape[1])
    for _ in range(iterations):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        residuals = values - design @ solution
        ratio = residuals / (4.685 * max(1.4826 * float(np.median(np.abs(residuals))), floor))
        weights = np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
    return solution


def coverage(outline: FloatArray, height: int, width: int, n: int = 12) -> FloatArray:
    """Share of n x n points of each pixel that lie inside a polygon (even-odd)."""
    share = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            for k in range(n * n):
                x = column - 0.5 + (k % n + 0.5) / n
                y = row - 0.5 + (k // n + 0.5) / n
                inside = False
                for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
                    if (y0 > y) != (y1 > y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
                        inside = not inside
                share[row, column] += inside / n**2
    return share


# --- edged.vision.robust ------------------------------------------------------------------------


def median_scale(residuals: FloatArray, base: FloatArray) -> float:
    """Sigma of normal errors from the median of the samples that count."""
    kept = np.abs(residuals[base > 0])
    return 1.4826 * float(np.median(kept)) if len(kept) else 0.0


def tukey_weights(ratio: FloatArray) -> FloatArray:
    """Tukey's biweight, c = 4.685."""
    return np.where(np.abs(ratio) < 4.685, (1 - (ratio / 4.685) ** 2) ** 2, 0.0)


def correlation_length(residuals: FloatArray, weights: FloatArray) -> float:
    """1 + 2 x the autocorrelation of the samples of a closed curve, up to the first lag without one."""
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


# --- edged.vision.jointsolver -------------------------------------------------------------------


def solve(
    samples: Samples, unknowns: int, priors: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(delta, covariance, weights, bias): every slow displacement is an unknown of its own with a prior."""
    curves, many, starts = len(samples.kinds), samples.waves.shape[1], samples.starts
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(starts)]
    shared = replace(samples, design=_in_bins(samples.design, parts), waves=_in_bins(samples.waves, parts))
    size = unknowns + curves * many
    prior = np.zeros(size)
    prior[unknowns - priors :] = 1.0
    bias = np.maximum(samples.expected, 0.03)
    dense = _with_displacements(shared, bias, unknowns)
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
            dense = _with_displacements(shared, bias, unknowns)
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


def _with_displacements(samples: Samples, bias: FloatArray, unknowns: int) -> FloatArray:
    """The design with the displacements of each curve as unknowns, in units of their sigma."""
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
    """The sigmas of the displacements from what came out for each, all of them being unknowns here."""
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


# --- edged.vision.widths ------------------------------------------------------------------------


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
    """Variance of the mean around the waves, the mean square of the waves, and the shares of the samples."""
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


# --- contours ----------------------------------------------------------------------------------------


def ramer(points: list[list[float]], tolerance: float) -> list[int]:
    """Indices that the recursive subdivision of U. Ramer (1972) keeps."""

    def between(a: int, b: int) -> list[int]:
        (ax, ay), (bx, by) = points[a], points[b]
        length = math.hypot(bx - ax, by - ay)
        farthest, where = tolerance, None
        for n in range(a + 1, b):
            px, py = points[n][0] - ax, points[n][1] - ay
            gap = abs(px * (by - ay) - py * (bx - ax)) / length if length > 1e-9 else math.hypot(px, py)
            if gap > farthest:
                farthest, where = gap, n
        return [] if where is None else [*between(a, where), where, *between(where, b)]

    return [0, *between(0, len(points) - 1), len(points) - 1]


def misfit(points: FloatArray) -> float:
    """Farthest distance from the better one of the best line and the circle of I. Kåsa (1976)."""
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred)[2][1]
    line = max(abs(float(point @ normal)) for point in centred)
    design = np.column_stack([centred, np.ones(len(centred))])
    (d, e, f), _, _, singular = np.linalg.lstsq(design, -(centred**2).sum(axis=1), rcond=None)
    if singular[-1] < 1e-9 * singular[0]:
        return line
    centre, radius = np.array([-d / 2, -e / 2]), math.sqrt(d * d / 4 + e * e / 4 - f)
    return min(line, max(abs(math.dist(point, centre) - radius) for point in centred))


def link(thin: npt.NDArray[np.uint8]) -> list[tuple[list[list[int]], bool]]:
    """Chains of set pixels with whether each is closed: from their ends first, then what remains."""
    height, width = thin.shape
    steps = [(-1, 0), (0, -1), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)]
    used: set[tuple[int, int]] = set()
    chains: list[tuple[list[list[int]], bool]] = []

    def around(y: int, x: int) -> list[tuple[int, int]]:
        places = [(y + dy, x + dx) for dy, dx in steps]
        return [(v, u) for v, u in places if 0 <= v < height and 0 <= u < width and thin[v, u]]

    def walk(place: tuple[int, int] | None) -> list[list[int]]:
        chain: list[list[int]] = []
        while place is not None:
            used.add(place)
            chain.append(list(place))
            place = next((other for other in around(*place) if other not in used), None)
        return chain

    for loops in (False, True):
        for y in range(height):
            for x in range(width):
                if not thin[y, x] or (y, x) in used or (not loops and len(around(y, x)) > 1):
                    continue
                chain = walk((y, x))
                near = max(abs(chain[-1][0] - y), abs(chain[-1][1] - x)) <= 1
                closed = loops and near and len(chain) > 7
                if loops and not closed:
                    other = next((place for place in around(y, x) if place not in used), None)
                    if other is not None:
                        chain = chain[::-1] + walk(other)
                chains.append((chain, closed))
    return chains


# --- edged.vision.circleprojection --------------------------------------------------------------------


def circle_samples(
    camera: CameraModel,
    pose: FloatArray,
    frame: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    phase: FloatArray,
) -> FloatArray:
    """(N, 10) of points on circles: pixel, outward normal, derivatives along it (see `project_samples`)."""
    rows = []
    for centre, radius, angle in zip(centres, radii, phase, strict=True):
        radial = np.cos(angle) * frame[0] + np.sin(angle) * frame[1]
        across = np.cos(angle) * frame[1] - np.sin(angle) * frame[0]
        point = pose[:3, :3] @ (centre + radius * radial) + pose[:3, 3]
        pixels, by_point, _ = project_with_jacobians(camera, point[None])
        by_rig = by_point[0] @ pose[:3, :3]
        tangent = by_rig @ across
        normal = np.array([tangent[1], -tangent[0]]) / np.linalg.norm(tangent)
        normal *= np.sign(normal @ by_rig @ radial)
        along = normal @ by_rig
        up = along @ frame[2] * radius
        tilts = [up * np.sin(angle), up * np.cos(angle)]
        rows.append(np.concatenate([pixels[0], normal, along, tilts, [along @ radial]]))
    return np.array(rows)


def bends(pixels: FloatArray, normals: FloatArray) -> FloatArray:
    """(N,) turn of the normal from each sample's predecessor to its successor, per way, around one curve."""
    angles = np.arctan2(normals[:, 1], normals[:, 0])
    turn = np.abs(np.angle(np.exp(1j * (np.roll(angles, -1) - np.roll(angles, 1)))))
    return turn / np.linalg.norm(np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0), axis=1)


def clock_extremes(
    gates: list[tuple[int, int, int]], drift: float, wander: float, step_ns: int
) -> tuple[float, float]:
    """The least and the greatest host time at device time 0 of all lines through all gates.

    gates : (device time, earliest host time, latest host time). Tries 2001 slopes within the drift.
    """
    least, greatest = math.inf, -math.inf
    for k in range(-1000, 1001):
        slope = 1 + drift * k / 1000
        floor = max(low - slope * x - wander * abs(x) - step_ns / 2 for x, low, _ in gates)
        ceiling = min(high - slope * x + wander * abs(x) + step_ns / 2 for x, _, high in gates)
        if floor <= ceiling:
            least, greatest = min(least, floor), max(greatest, ceiling)
    return least - step_ns / 2, greatest + step_ns / 2


# --- edged.vision.pixelformats ---------------------------------------------------------------


def pack_pixels(values: list[int], bits: int, layout: str) -> bytes:
    """The bytes in which a camera sends these values, from the words of the standard, bit by bit."""
    if layout == "bytes":
        return bytes(values)
    if layout == "words":
        return b"".join(bytes((value & 0xFF, value >> 8)) for value in values)
    if layout == "pairs":
        low_bits = bits - 8
        packed = bytearray()
        for place in range(0, len(values), 2):
            first, *rest = values[place : place + 2]
            low = first & (1 << low_bits) - 1
            packed += bytes((first >> low_bits, low))
            for second in rest:
                packed[-1] |= (second & (1 << low_bits) - 1) << 4
                packed.append(second >> low_bits)
        return bytes(packed)
    stream = "".join(f"{value:0{bits}b}"[::-1] for value in values)  # low bit first
    stream += "0" * (-len(stream) % 8)
    return bytes(int(stream[start : start + 8][::-1], 2) for start in range(0, len(stream), 8))


def grey_of_mosaic(mosaic: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """(R + 2 G + B) / 4 around every pixel: binomial mean, rounded half up, mirrored at the border."""
    height, width = mosaic.shape
    out = np.zeros(mosaic.shape, np.int64)
    for y in range(height):
        for x in range(width):
            total = 0
            for dy, weight_y in ((-1, 1), (0, 2), (1, 1)):
                for dx, weight_x in ((-1, 1), (0, 2), (1, 1)):
                    row, column = abs(y + dy), abs(x + dx)
                    row = 2 * (height - 1) - row if row >= height else row
                    column = 2 * (width - 1) - column if column >= width else column
                    total += weight_y * weight_x * int(mosaic[row, column])
            out[y, x] = (total + 8) // 16
    return out


def nearest_of_256(value: int, bits: int) -> int:
    """A value of so many bits as one of 8, rounded half up, at most 255."""
    return min(255, math.floor(value / 2 ** (bits - 8) + 0.5))


def repetition(points: FloatArray) -> float:
    """Mean over the points of the sum of exp(-2 d^2) over all of them, at their distances d."""
    return sum(math.exp(-2 * math.dist(p, q) ** 2) for p in points for q in points) / len(points)
