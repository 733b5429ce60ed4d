"""Plain-loop twins of the kernels of `vision/part`: slow, but simple enough to trust."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Image


def row_edges(
    image: Image, point: FloatArray, sign: float, low: float, high: float, min_slope: float
) -> list[tuple[float, float]]:
    """(slope, disparity) of all edges of one sign on a point's row, strongest first; sums three rows."""
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
    """Number of points with a rival within the tolerance of d = a x + b y + c."""
    a, b, c = plane
    return sum(
        any(abs(rival - (a * x + b * y + c)) < tolerance for rival in row if not math.isnan(rival))
        for (x, y), row in zip(points, rivals, strict=True)
    )
