"""Detection of ellipses among the edges of an image: possible circles of a face, for teaching."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, FloatArray, Image
from edged.vision.edges.hysteresis import EdgeThresholds, strong_edges
from edged.vision.edges.params import OUTLINES
from edged.vision.geometry.rigid import rotation_2d


@dataclass(frozen=True, slots=True)
class ImageEllipse:
    """Ellipse: centre (x, y), semi-axes, px; angle of the first axis, rad; polarity +1: brighter outside."""

    x: float
    y: float
    a: float
    b: float
    angle: float
    polarity: int

    def outline(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Points (N, 2) on the ellipse and outward unit normals (N, 2)."""
        t = np.arange(count) * (2 * np.pi / count)
        turn = rotation_2d(self.angle)
        points = np.column_stack([self.a * np.cos(t), self.b * np.sin(t)]) @ turn.T + (self.x, self.y)
        normals = np.column_stack([self.b * np.cos(t), self.a * np.sin(t)]) @ turn.T
        return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def distance(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance (N,) to first order, and angle (N,) around the centre."""
        local = (points - (self.x, self.y)) @ rotation_2d(self.angle)
        scaled = local / (self.a, self.b)
        value = np.linalg.norm(scaled, axis=1)
        gradient = np.linalg.norm(scaled / (self.a, self.b), axis=1) / np.maximum(value, 1e-9)
        return (value - 1) / np.maximum(gradient, 1e-9), np.arctan2(scaled[:, 1], scaled[:, 0])


def find_ellipses(image: Image, mask: Image, thresholds: EdgeThresholds | None = None) -> list[ImageEllipse]:
    """Find ellipses among the strong edges inside a mask, largest first; lists both edges of a chamfer.

    thresholds : of the edges; those not given are derived from the region.
    """
    edges = strong_edges(image, mask, thresholds)
    if edges is None:
        return []
    count, labels = cv2.connectedComponents(edges.thin, connectivity=8)
    found: list[ImageEllipse] = []
    for label in range(1, count):
        ys, xs = np.nonzero(labels == label)
        points = np.column_stack([xs, ys]).astype(np.float64)
        gradients = np.column_stack([edges.gx[ys, xs], edges.gy[ys, xs]]).astype(np.float64)
        for _ in range(3):  # one connected edge may hold a bore and the outline of a slot beside it
            ellipse, inliers = _ransac(points, gradients)
            if ellipse is None:
                break
            found.append(ellipse)
            points, gradients = points[~inliers], gradients[~inliers]
    return _distinct(sorted(found, key=lambda e: -e.a * e.b))


def _ransac(points: FloatArray, gradients: FloatArray) -> tuple[ImageEllipse | None, B8]:
    """RANSAC: the ellipse with the most of its circumference covered, and its inliers."""
    best: ImageEllipse | None = None
    best_inliers = np.zeros(len(points), bool)
    best_coverage = OUTLINES.min_coverage
    if len(points) < 20:
        return None, best_inliers
    random = np.random.default_rng(0)
    for trial in range(OUTLINES.trials):
        sample = points if trial == 0 else points[random.choice(len(points), 6, replace=False)]
        candidate = _fit(sample)
        if candidate is None:
            continue
        inliers = np.abs(candidate.distance(points)[0]) < OUTLINES.inlier_px
        if inliers.sum() < 16:
            continue
        refined = _fit(points[inliers]) or candidate
        distance, around = refined.distance(points)
        inliers = np.abs(distance) < OUTLINES.inlier_px
        coverage = _coverage(around[inliers], refined)
        if coverage > best_coverage + 0.01:
            best, best_inliers, best_coverage = refined, inliers, coverage
            if coverage > 0.97:
                break
    if best is None:
        return None, best_inliers
    outward = points[best_inliers] - (best.x, best.y)
    brighter = float(np.sum(np.sign(np.sum(outward * gradients[best_inliers], axis=1))))
    if abs(brighter) < 0.6 * best_inliers.sum():  # a line of texture, not an object's border
        return None, best_inliers
    return ImageEllipse(best.x, best.y, best.a, best.b, best.angle, 1 if brighter > 0 else -1), best_inliers


def _fit(points: FloatArray) -> ImageEllipse | None:
    """Direct least-squares ellipse (Fitzgibbon, Pilu, Fisher 1999)."""
    try:
        (x, y), (width, height), degrees = cv2.fitEllipseDirect(points.astype(np.float32).reshape(-1, 1, 2))
    except cv2.error:
        return None
    a, b = width / 2, height / 2
    if (
        not np.isfinite([x, y, a, b, degrees]).all()
        or min(a, b) < OUTLINES.min_radius_px
        or min(a, b) < OUTLINES.min_axis_ratio * max(a, b)
    ):
        return None
    if max(a, b) > 5000:
        return None
    return ImageEllipse(x, y, a, b, float(np.radians(degrees)), 0)


def _coverage(around: FloatArray, ellipse: ImageEllipse) -> float:
    """Share of the circumference covered by inliers, in bins of about 2 px."""
    bins = int(np.clip(np.pi * (ellipse.a + ellipse.b) / 2, 16, 720))
    return len(np.unique(((around + np.pi) / (2 * np.pi) * bins).astype(int) % bins)) / bins


def _distinct(ellipses: list[ImageEllipse]) -> list[ImageEllipse]:
    kept: list[ImageEllipse] = []
    for ellipse in ellipses:
        same = any(
            np.hypot(ellipse.x - other.x, ellipse.y - other.y) < 2
            and abs(ellipse.a + ellipse.b - other.a - other.b) < 4
            for other in kept
        )
        if not same:
            kept.append(ellipse)
    return kept
