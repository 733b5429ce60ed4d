"""Lines and circles fitted to image points by orthogonal distance with Tukey's weights (paper, eq. 5).

Eq. 5 as printed mixes two weight functions: beyond the threshold Tukey's biweight is zero, Huber's is
threshold / |distance|. Tukey's is used here, as it fully rejects a wrong point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.edges.params import OUTLINES
from edged.vision.kernels.robust import mad_sigma, tukey_weights

MIN_SCATTER_PX = 1e-6  # scatter of points that lie on the curve up to rounding
SETTLED_PX = 1e-10  # steps below it are rounding errors


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Common result of both fits: signed distances and weights (N,) of the points."""

    distances: FloatArray
    weights: FloatArray

    @property
    def rms_px(self) -> float:
        """Weighted rms distance."""
        return float(np.sqrt(np.sum(self.weights * self.distances**2) / np.sum(self.weights)))


@dataclass(frozen=True, slots=True, eq=False)
class LineFit(Fit):
    """Line of points x with normal . x = offset; normal (2,) of length 1."""

    normal: FloatArray
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class CircleFit(Fit):
    """Circle with centre (2,) and radius; distances are positive outside."""

    centre: FloatArray
    radius: float


def fit_line(points: FloatArray) -> LineFit | None:
    """Fit a line to points (N, 2) by orthogonal distance; None for fewer than 2 distinct points."""
    points = _finite(points)
    if len(points) < 2 or not np.ptp(points, axis=0).max() > 0:
        return None
    weights = np.ones(len(points))
    normal, offset = np.zeros(2), 0.0
    for _ in range(OUTLINES.rounds):
        mean = np.average(points, axis=0, weights=weights)
        centred = points - mean
        _, _, axes = np.linalg.svd(centred * np.sqrt(weights)[:, None], full_matrices=False)
        previous, normal = normal, axes[-1] * (1.0 if axes[-1, np.argmax(np.abs(axes[-1]))] > 0 else -1.0)
        offset = float(normal @ mean)
        fresh = _weights(points @ normal - offset)
        if fresh.sum() <= 0 or np.count_nonzero(fresh) < 2:
            return None
        weights = fresh
        if np.abs(normal - previous).max() < SETTLED_PX:
            break
    return LineFit(points @ normal - offset, weights, normal, offset)


def fit_circle(points: FloatArray) -> CircleFit | None:
    """Fit a circle to points (N, 2) by orthogonal distance; None if they do not determine one.

    Reweighted Gauss-Newton, starting from the algebraic circle.
    """
    points = _finite(points)
    circle = _algebraic_circle(points)
    if circle is None:
        return None
    for number in range(OUTLINES.rounds):
        distances, design = _from_circle(points, circle)
        early = number < OUTLINES.median_rounds
        root = np.sqrt(_median_weights(distances) if early else _weights(distances))
        if np.count_nonzero(root) < len(circle):
            return None
        step, _, rank, _ = np.linalg.lstsq(design * root[:, None], -distances * root, rcond=1e-10)
        circle = circle + step
        if rank < len(circle) or not np.isfinite(circle).all():
            return None
        if np.abs(step).max() < SETTLED_PX and not early:
            break
    if not circle[2] > 0:
        return None
    distances, _ = _from_circle(points, circle)
    return CircleFit(distances, _weights(distances), circle[:2], float(circle[2]))


def _finite(points: FloatArray) -> FloatArray:
    array = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return np.asarray(array[np.isfinite(array).all(axis=1)])


def _weights(distances: FloatArray) -> FloatArray:
    return tukey_weights(distances, max(mad_sigma(distances), MIN_SCATTER_PX))


def _median_weights(distances: FloatArray) -> FloatArray:
    size = np.abs(distances)
    return np.asarray(1 / np.maximum(size, max(0.1 * float(np.median(size)), MIN_SCATTER_PX)))


def _from_circle(points: FloatArray, circle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (N,) from a circle (x, y, radius), and their derivatives (N, 3) with respect to it."""
    arm = points - circle[:2]
    length = np.maximum(np.linalg.norm(arm, axis=1), 1e-12)
    return length - circle[2], np.column_stack([-arm / length[:, None], -np.ones(len(points))])


def _algebraic_circle(points: FloatArray) -> FloatArray | None:
    """Circle (x, y, radius) by least squares of x² + y² + d x + e y + f = 0 (I. Kåsa, 1976)."""
    if len(points) < 3:
        return None
    mean = points.mean(axis=0)
    size = float(np.abs(points - mean).max())
    if not size > 0:
        return None
    scaled = (points - mean) / size
    design = np.column_stack([scaled, np.ones(len(scaled))])
    (d, e, f), _, rank, _ = np.linalg.lstsq(design, -np.sum(scaled**2, axis=1), rcond=1e-9)
    square = 0.25 * (d * d + e * e) - f
    if rank < 3 or not square > 0:
        return None
    return np.array([mean[0] - 0.5 * d * size, mean[1] - 0.5 * e * size, math.sqrt(square) * size])
