"""Lines, circles and ellipses through image points, by orthogonal distance and robust weights (paper, eq. 5).

Eq. 5 is printed as a mixture of two weight functions: a Tukey biweight is zero beyond the threshold, a
Huber weight is threshold / |distance| there. Both are offered by name, and so is the printed mixture, which
jumps from 0 to 1 at the threshold: "least_squares", "huber", "tukey", "paper".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edged.domain import FloatArray

Weighting = Literal["least_squares", "huber", "tukey", "paper"]
EFFICIENT = {"least_squares": math.inf, "huber": 1.345, "tukey": 4.685, "paper": 4.685}
"""Thresholds in sigmas for 95 % efficiency with normal errors (P. J. Huber; J. W. Tukey)."""
SHRINKS = {"least_squares": 1.0, "huber": 1.08, "tukey": 1.12, "paper": 1.12}
"""What the weighted variance of normal errors has to be multiplied with."""
MEDIAN_STEPS = 8
MIN_SCATTER_PX = 1e-6  # of points that lie on the curve to rounding
FOOT_STEPS = 8  # Newton's method for the nearest point of an ellipse; quadratic near the curve
SETTLED_PX = 1e-10


@dataclass(frozen=True, slots=True)
class FitParams:
    """How to fit.

    threshold_px : tau of eq. 5; None: from the scatter of the points (`EFFICIENT` x 1.4826 x median).
    iterations : at most; of HALCON's fit_circle_contour_xld, which the paper uses, it is 3.
    """

    weighting: Weighting = "tukey"
    threshold_px: float | None = None
    iterations: int = 30

    def __post_init__(self) -> None:
        if self.weighting not in EFFICIENT:
            raise ValueError(f"weighting: expected one of {', '.join(EFFICIENT)}, got {self.weighting!r}")
        if self.threshold_px is not None and not self.threshold_px > 0:
            raise ValueError(f"threshold_px: expected a positive distance, got {self.threshold_px}")
        if self.iterations < 1:
            raise ValueError(f"iterations: expected at least 1, got {self.iterations}")


DEFAULTS = FitParams()


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What every fit tells: signed distances and weights (N,), and the covariance of its parameters."""

    distances: FloatArray
    weights: FloatArray
    covariance: FloatArray

    @property
    def rms_px(self) -> float:
        """Weighted rms distance."""
        return float(np.sqrt(np.sum(self.weights * self.distances**2) / np.sum(self.weights)))


@dataclass(frozen=True, slots=True, eq=False)
class LineFit(Fit):
    """Points x with normal . x = offset; covariance (2, 2) of (angle, offset at the mean of the points)."""

    normal: FloatArray
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class CircleFit2D(Fit):
    """centre (2,), radius; covariance (3, 3) of (x, y, radius)."""

    centre: FloatArray
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class EllipseFit(Fit):
    """centre (2,), semi-axes a >= b, angle of a in rad; covariance (5, 5) of (x, y, a, b, angle)."""

    centre: FloatArray
    a: float
    b: float
    angle: float


def robust_weights(distances: FloatArray, weighting: Weighting, threshold: float) -> FloatArray:
    """Weights (N,) of distances (N,) by name; threshold is tau of eq. 5."""
    size = np.abs(distances)
    if weighting == "least_squares":
        return np.ones_like(size)
    far = threshold / np.maximum(size, threshold)
    if weighting == "huber":
        return far
    near = (1 - np.minimum(size / threshold, 1.0) ** 2) ** 2
    return np.where(size <= threshold, near, far if weighting == "paper" else 0.0)


def fit_line(points: FloatArray, params: FitParams = DEFAULTS) -> LineFit | None:
    """Fit a line to points (N, 2) by orthogonal distance; None for fewer than 2 different points."""
    points = _finite(points)
    if len(points) < 2 or not np.ptp(points, axis=0).max() > 0:
        return None
    weights = np.ones(len(points))
    normal, offset, mean = np.zeros(2), 0.0, points[0]
    for _ in range(params.iterations):
        mean = np.average(points, axis=0, weights=weights)
        centred = points - mean
        _, _, axes = np.linalg.svd(centred * np.sqrt(weights)[:, None], full_matrices=False)
        previous, normal = normal, axes[-1] * (1.0 if axes[-1, np.argmax(np.abs(axes[-1]))] > 0 else -1.0)
        offset = float(normal @ mean)
        fresh = _weights(points @ normal - offset, params)
        if fresh.sum() <= 0 or np.count_nonzero(fresh) < 2:
            return None
        weights = fresh
        if np.abs(normal - previous).max() < SETTLED_PX:
            break
    distances = points @ normal - offset
    along = (points - mean) @ np.array([-normal[1], normal[0]])
    design = np.column_stack([along, -np.ones(len(points))])
    return LineFit(
        distances, weights, _covariance(design, distances, weights, params.weighting), normal, offset
    )


def fit_circle(points: FloatArray, params: FitParams = DEFAULTS) -> CircleFit2D | None:
    """Fit a circle to points (N, 2) by orthogonal distance; None where they do not determine one."""
    points = _finite(points)
    start = _algebraic_circle(points)
    if start is None:
        return None

    def model(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        arm = points - parameters[:2]
        length = np.maximum(np.linalg.norm(arm, axis=1), 1e-12)
        return length - parameters[2], np.column_stack([-arm / length[:, None], -np.ones(len(points))])

    solution = _gauss_newton(start, model, params)
    if solution is None or not solution[0][2] > 0:
        return None
    parameters, fit = solution
    return CircleFit2D(*fit, parameters[:2], float(parameters[2]))


def fit_ellipse(points: FloatArray, params: FitParams = DEFAULTS) -> EllipseFit | None:
    """Fit an ellipse to points (N, 2) by orthogonal distance; None where they do not determine one.

    Start: direct fit of R. Halir and J. Flusser, "Numerically Stable Direct Least Squares Fitting of
    Ellipses", 1998; it favours small ellipses, which the orthogonal distance then mends.
    """
    points = _finite(points)
    start = _halir(points)
    if start is None:
        return None

    def model(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        return _ellipse_distance(points, parameters)

    solution = _gauss_newton(start, model, params)
    if solution is None or not (solution[0][2:4] > 0).all():
        return None
    (x, y, a, b, angle), fit = solution
    if b > a:
        swap = [0, 1, 3, 2, 4]
        a, b, angle = b, a, angle + np.pi / 2
        fit = (fit[0], fit[1], fit[2][np.ix_(swap, swap)])
    angle = np.pi / 2 - (np.pi / 2 - angle) % np.pi
    return EllipseFit(*fit, np.array([x, y]), float(a), float(b), float(angle))


def _finite(points: FloatArray) -> FloatArray:
    array = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return np.asarray(array[np.isfinite(array).all(axis=1)])


def _weights(distances: FloatArray, params: FitParams) -> FloatArray:
    threshold = params.threshold_px
    if threshold is None:
        scatter = max(1.4826 * float(np.median(np.abs(distances))), MIN_SCATTER_PX)
        threshold = EFFICIENT[params.weighting] * scatter
    return robust_weights(distances, params.weighting, threshold)


def _covariance(
    design: FloatArray, distances: FloatArray, weights: FloatArray, weighting: Weighting
) -> FloatArray:
    """Of the parameters, from the scatter of the points themselves; NaN where no freedom is left."""
    freedom = float(weights.sum()) - design.shape[1]
    if freedom <= 0:
        return np.full((design.shape[1], design.shape[1]), np.nan)
    variance = SHRINKS[weighting] * float(np.sum(weights * distances**2)) / freedom
    return np.asarray(variance * np.linalg.pinv((design * weights[:, None]).T @ design))


Evidence = tuple[FloatArray, FloatArray, FloatArray]


def _gauss_newton(
    start: FloatArray, model: Callable[[FloatArray], tuple[FloatArray, FloatArray]], params: FitParams
) -> tuple[FloatArray, Evidence] | None:
    """Reweighted Gauss-Newton on signed distances (N,) with their derivatives (N, P)."""
    parameters = start
    for number in range(params.iterations):
        distances, design = model(parameters)
        # a third of wrong points moves the median little, least squares much: Tukey starts from there
        early = number < MEDIAN_STEPS and params.iterations > MEDIAN_STEPS and params.weighting == "tukey"
        root = np.sqrt(_median_weights(distances) if early else _weights(distances, params))
        if np.count_nonzero(root) < len(start):
            return None
        step, _, rank, _ = np.linalg.lstsq(design * root[:, None], -distances * root, rcond=1e-10)
        parameters = parameters + step
        if rank < len(start) or not np.isfinite(parameters).all():
            return None
        if np.abs(step).max() < SETTLED_PX and not early:
            break
    distances, design = model(parameters)
    weights = _weights(distances, params)
    return parameters, (distances, weights, _covariance(design, distances, weights, params.weighting))


def _median_weights(distances: FloatArray) -> FloatArray:
    size = np.abs(distances)
    return np.asarray(1 / np.maximum(size, max(0.1 * float(np.median(size)), MIN_SCATTER_PX)))


def _algebraic_circle(points: FloatArray) -> FloatArray | None:
    """(x, y, radius) of the least-squares solution of x² + y² + d x + e y + f = 0 (I. Kåsa, 1976)."""
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


def _halir(points: FloatArray) -> FloatArray | None:
    if len(points) < 5:
        return None
    mean = points.mean(axis=0)
    size = float(np.abs(points - mean).max())
    if not size > 0:
        return None
    x, y = ((points - mean) / size).T
    quadratic, linear = np.column_stack([x * x, x * y, y * y]), np.column_stack([x, y, np.ones(len(x))])
    s1, s2, s3 = quadratic.T @ quadratic, quadratic.T @ linear, linear.T @ linear
    if np.linalg.cond(s3) > 1e12:
        return None
    eliminate = -np.linalg.solve(s3, s2.T)
    reduced = s1 + s2 @ eliminate
    values, vectors = np.linalg.eig(np.array([reduced[2] / 2, -reduced[1], reduced[0] / 2]))
    vectors = np.real(vectors[:, np.abs(np.imag(values)) < 1e-9])
    ellipses = [v for v in vectors.T if 4 * v[0] * v[2] - v[1] ** 2 > 0]
    if not ellipses:
        return None
    a, b, c = (float(value) for value in ellipses[0])
    d, e, f = (float(value) for value in eliminate @ ellipses[0])
    centre = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    level = -(f + 0.5 * (d * centre[0] + e * centre[1]))
    curvature, axes = np.linalg.eigh(np.array([[a, b / 2], [b / 2, c]]) / level)
    if level == 0 or not (curvature > 0).all():
        return None
    semi = size / np.sqrt(curvature)
    return np.array([*(centre * size + mean), *semi, math.atan2(axes[1, 0], axes[0, 0])])


def _ellipse_distance(points: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (N,), positive outside, and their derivatives (N, 5) by (x, y, a, b, angle).

    The foot of the perpendicular moves along the ellipse when a parameter changes; only the part of the
    motion along the normal changes the distance.
    """
    x, y, a, b, angle = parameters
    a, b = max(abs(a), 1e-9), max(abs(b), 1e-9)
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    local = (points - (x, y)) @ turn
    t = np.arctan2(local[:, 1] / b, local[:, 0] / a)
    for _ in range(FOOT_STEPS):
        c, s = np.cos(t), np.sin(t)
        gap = local - np.column_stack([a * c, b * s])
        tangent = np.column_stack([-a * s, b * c])
        slope = np.sum(tangent**2, axis=1) + gap[:, 0] * a * c + gap[:, 1] * b * s
        # inside the evolute the second derivative changes sign: Gauss-Newton's positive one leads on
        slope = np.where(slope > 0, slope, np.sum(tangent**2, axis=1))
        t = t + np.sum(gap * tangent, axis=1) / np.maximum(slope, 1e-12)
    c, s = np.cos(t), np.sin(t)
    normal = np.column_stack([b * c, a * s])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distances = np.sum((local - np.column_stack([a * c, b * s])) * normal, axis=1)
    swing = np.column_stack([-b * s, a * c])  # of the foot, per rad of the angle, in the turned axes
    outward = normal @ turn.T
    design = -np.column_stack([outward, normal[:, 0] * c, normal[:, 1] * s, np.sum(normal * swing, axis=1)])
    return distances, design
