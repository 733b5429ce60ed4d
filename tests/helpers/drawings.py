"""Parts drawn with exact area coverage, for tests of the shape search."""

from __future__ import annotations

import math

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.geometry.rigid import rotation_2d


def disc(x: float, y: float, radius: float) -> FloatArray:
    """Polygon of a circle, finer than a hundredth of a pixel."""
    t = np.arange(240) * (2 * math.pi / 240)
    return np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])


BRACKET = (
    (
        np.array(
            [(-60, -40), (45, -40), (62, -22), (62, 40), (10, 40), (0, 25), (-30, 25), (-60, 10)], float
        ),
        200.0,
    ),
    (disc(-40, -15, 11), 60.0),
    (disc(38, 15, 15), 60.0),
)


def flange(odd: bool) -> tuple[tuple[FloatArray, float], ...]:
    """Six bolt holes around a bore; when odd, one hole is missing."""
    holes = [disc(44 * math.cos(i * math.pi / 3), 44 * math.sin(i * math.pi / 3), 9.0) for i in range(6)]
    return ((disc(0, 0, 62), 200.0), (disc(0, 0, 22), 60.0), *((hole, 60.0) for hole in holes[int(odd) :]))


def draw(
    outlines: tuple[tuple[FloatArray, float], ...],
    pose: tuple[float, float, float, float, float],
    size: tuple[int, int] = (400, 320),
    noise: float = 1.0,
    background: Image | None = None,
) -> Image:
    """An image (H, W) of a part at (x, y, angle, scale x, scale y), blurred and noisy."""
    width, height = size
    x, y, angle, scale_x, scale_y = pose
    canvas = np.full((height, width), 70.0) if background is None else background.astype(np.float64)
    turn = rotation_2d(angle)
    for points, grey in outlines:
        placed = (points * (scale_x, scale_y)) @ turn.T + (x, y)
        canvas += _coverage(placed, width, height) * (grey - canvas)
    canvas = cv2.GaussianBlur(canvas, (0, 0), 0.7)
    canvas += np.random.default_rng(0).normal(0, noise, canvas.shape)
    return np.clip(np.rint(canvas), 0, 255).astype(np.uint8)


def _coverage(polygon: FloatArray, width: int, height: int, n: int = 16) -> FloatArray:
    """Share of each pixel inside the polygon: exact along x, n scan lines per row along y."""
    lines = (np.arange(height * n) + 0.5) / n - 0.5
    ahead = np.roll(polygon, -1, axis=0)
    cover = np.zeros((height * n, width))
    columns = np.arange(width)
    for (ax, ay), (bx, by) in zip(polygon, ahead, strict=True):
        if ay == by:
            continue
        rows = np.flatnonzero((lines >= min(ay, by)) & (lines < max(ay, by)))
        at = ax + (lines[rows] - ay) / (by - ay) * (bx - ax)
        # to the right of a crossing counts +1 or -1, so that only the span between two crossings remains
        cover[rows] += math.copysign(1, by - ay) * np.clip(columns + 0.5 - at[:, None], 0, 1)
    return np.abs(cover.reshape(height, n, width).mean(axis=1))
