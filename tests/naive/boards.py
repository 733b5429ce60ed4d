"""Plain-loop twins of the kernels of `vision/boards`: slow, but simple enough to trust."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np


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
