"""Plain-loop twins of the kernels: slow, short, and obviously right.

A kernel is tested against its twin, the twin against the eye of the reader.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from edged.domain import FloatArray, Image
from edged.sim import scene

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
