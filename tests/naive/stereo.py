"""Plain-loop twins of the kernels of `vision/stereo`: slow, but simple enough to trust."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Image


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
    """Index of the highest score, or -1 at an end; its score; ratio of the next peak to it."""
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
    """A cubic spline from its coefficients at integer positions: the sum of its basis functions."""
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


def cubic_value(image: Image, x: float, y: float) -> float:
    """Keys' cubic convolution (a = -1/2) at one place inside: the weighted sum of nearby pixels."""

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
