"""Outlines of a part that are no features but serve to find it. `teaching.tracing` finds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.part.body import MAX_SIZE_MM, checked

MAX_POINTS = 20_000
"""Most points that a job keeps, of all its outlines together."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedCurve:
    """A stretch of an outline, at one height, as taught; nothing is measured on it.

    points_mm (N, 3) : part frame, in order along the curve.
    polarity : +1 if brighter on the side 90° from its direction, turned from x to y; -1 if darker.
    """

    points_mm: FloatArray
    polarity: int

    @property
    def length_mm(self) -> float:
        """Length along its points."""
        return float(np.linalg.norm(np.diff(self.points_mm, axis=0), axis=1).sum())


def to_arrays(curves: Sequence[TracedCurve]) -> dict[str, npt.NDArray[Any]]:
    """Arrays for a file: all points (N, 3), and the number of points and polarity of each curve (K, 2)."""
    return {
        "points_mm": np.concatenate([curve.points_mm for curve in curves]).astype(np.float32),
        "curves": np.array([[len(curve.points_mm), curve.polarity] for curve in curves], np.int32),
    }


def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> tuple[TracedCurve, ...]:
    """Inverse of `to_arrays`. Raises `ValueError` that names the fault."""
    points = checked(arrays, "points_mm", 3, np.dtype(np.float32)).astype(np.float64)
    curves = checked(arrays, "curves", 2, np.dtype(np.int32)).astype(np.int64)
    counts, polarity = curves[:, 0], curves[:, 1]
    if len(points) > MAX_POINTS or not (np.abs(points) <= MAX_SIZE_MM).all():
        raise ValueError(f"points_mm: expected up to {MAX_POINTS} within {MAX_SIZE_MM:g} mm")
    if (counts < 2).any() or counts.sum() != len(points) or not np.isin(polarity, (-1, 1)).all():
        raise ValueError("curves: expected two points or more of each, as many as there are, and 1 or -1")
    ends = np.cumsum(counts)
    parts = [points[end - count : end] for end, count in zip(ends, counts, strict=True)]
    if any((np.linalg.norm(np.diff(part, axis=0), axis=1) == 0).any() for part in parts):
        raise ValueError("points_mm: expected no point twice behind itself")
    return tuple(TracedCurve(part, int(sign)) for part, sign in zip(parts, polarity, strict=True))
