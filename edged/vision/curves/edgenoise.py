"""Scatter of a curve's edges between pictures of a part at rest.

It contains only noise: texture beside an edge, a wall or the light displace the edge by the same amount in
every picture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.curves.params import FIT

Sighting = tuple[FloatArray, FloatArray]
"""One curve in one pair: points (2, N, 2) of its edges in both pictures, raw px, and weights (2, N)."""


def edge_noise(sightings: Sequence[Sighting]) -> tuple[float, float] | None:
    """Variance across the edge, px², of one px of arc, in the left and the right picture; None for too few.

    Neighbouring samples see the same pixels: their correlation reduces the effective number of samples.
    """
    counts = np.bincount([points.shape[1] for points, _ in sightings])
    many = int(counts.argmax())
    same = [sighting for sighting in sightings if sighting[0].shape[1] == many]
    if len(same) < FIT.noise_pictures:
        return None
    left, right = (
        _of_side(np.array([points[side] for points, _ in same]), np.array([w[side] for _, w in same]))
        for side in range(2)
    )
    return None if left is None or right is None else (left, right)


def _of_side(points: FloatArray, weights: FloatArray) -> float | None:
    """Noise of one side, from points (T, N, 2) and weights (T, N) of T pictures; None for too few samples."""
    points = points.astype(np.float64)
    middle = points.mean(axis=0)
    normals = _normals(middle)
    # next to a sample without an edge the line has no direction
    known = np.isfinite(points).all(axis=(0, 2)) & np.isfinite(normals).all(axis=1)
    good = np.asarray(known & (weights > FIT.used_weight).all(axis=0))
    if good.sum() < FIT.noise_samples:
        return None
    steps = np.diff(middle, axis=0)
    arc_px = float(np.median(np.linalg.norm(steps[np.isfinite(steps).all(axis=1)], axis=1)))
    across = np.where(good, np.einsum("tni,ni->tn", points - middle, normals), 0.0)
    freedom = len(points) - 1
    variance = float(np.sum(across[:, good] ** 2)) / (freedom * int(good.sum()))
    if variance <= 0.0:
        return 0.0
    alike = 0.0
    for apart in range(1, FIT.noise_reach + 1):
        both = good[:-apart] & good[apart:]
        products = (across[:, :-apart] * across[:, apart:])[:, both]
        correlation = float(products.sum()) / (freedom * max(int(both.sum()), 1)) / variance
        if correlation < FIT.uncorrelated:
            break
        alike += correlation
    return variance * (1 + 2 * alike) * arc_px


def _normals(line: FloatArray) -> npt.NDArray[np.float64]:
    """Unit normals (N, 2) of a line of points (N, 2); NaN where neighbouring points are NaN."""
    along = np.gradient(line, axis=0)
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.column_stack([along[:, 1], -along[:, 0]]) / length)
