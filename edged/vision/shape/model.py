"""The taught shape: edge points with directions on every pyramid level (paper, 4.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.edges.params import OUTLINES
from edged.vision.shape.params import LEARNING, MAX_LEVELS


@dataclass(frozen=True, slots=True, eq=False)
class ShapeLevel:
    """points (N, 2) relative to the origin, px of this level; normals (N, 2) unit, along the gradient."""

    points: FloatArray
    normals: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ShapeModel:
    """A shape to look for.

    levels : finest first.  origin_px (2,) : where the origin was in the teaching image.
    radius_px : farthest point from the origin.  contrast : median slope of the model's edges, grey
    values per px.
    symmetries (K, 4) : dx, dy, angle, similarity: motions after which the shape looks (nearly) the same.
    centre_px (2,) : about which they turn, relative to the origin.  round : any rotation looks the same.
    repetition : how many points share the noise of one pixel; the covariance of a match is that much larger.
    """

    levels: tuple[ShapeLevel, ...]
    origin_px: FloatArray
    radius_px: float
    contrast: float
    symmetries: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))  # none
    centre_px: FloatArray = field(default_factory=lambda: np.zeros(2))  # the origin
    round: bool = False
    repetition: float = 1.0  # none

    @property
    def same_score(self) -> float:
        """Similarity from which two rotations cannot be distinguished."""
        return LEARNING.same_score

    @property
    def equal_motions(self) -> FloatArray:
        """Those (M, 4) of the symmetries after which the shape cannot be distinguished."""
        return self.symmetries[self.symmetries[:, 3] >= self.same_score]

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Plain arrays for a file."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "origin_px": self.origin_px,
            "numbers": np.array([self.radius_px, self.contrast, len(self.levels)], np.float64),
            "symmetries": self.symmetries,
            "centre_px": self.centre_px,
            "round": np.array([float(self.round)]),
            "repetition": np.array([self.repetition]),
        }
        for index, level in enumerate(self.levels):
            arrays[f"points{index}"], arrays[f"normals{index}"] = level.points, level.normals
        return arrays

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> ShapeModel:
        """Inverse of `to_arrays`; raises `ValueError` that names what is wrong."""
        numbers = _checked(arrays, "numbers", (3,))
        origin = _checked(arrays, "origin_px", (2,))
        radius, contrast, count = (float(number) for number in numbers)
        if not (0 < radius < 1e5 and 0 < contrast < 1e4 and count in range(1, MAX_LEVELS + 1)):
            raise ValueError(f"numbers: impossible values {numbers.tolist()}")
        levels = []
        for index in range(int(count)):
            points = _checked(arrays, f"points{index}", (-1, 2))
            if len(points) > max(LEARNING.max_points):
                raise ValueError(
                    f"points{index}: {len(points)} points, expected at most {max(LEARNING.max_points)}"
                )
            normals = _checked(arrays, f"normals{index}", (len(points), 2))
            if len(points) < OUTLINES.min_points or np.abs(points).max() > 1e5:
                raise ValueError(f"points{index}: too few or too far points")
            if np.abs(np.linalg.norm(normals, axis=1) - 1).max() > 1e-6:
                raise ValueError(f"normals{index}: not unit vectors")
            levels.append(ShapeLevel(points, normals))
        symmetries = _checked(arrays, "symmetries", (-1, 4))
        if len(symmetries) > 360 or (np.abs(symmetries) > 1e5).any():
            raise ValueError("symmetries: impossible values")
        centre, is_round = _checked(arrays, "centre_px", (2,)), _checked(arrays, "round", (1,))
        if np.abs(centre).max() > 1e5 or np.abs(origin).max() > 1e6:
            raise ValueError("centre_px, origin_px: impossible values")
        (repetition,) = _checked(arrays, "repetition", (1,))
        if not 1 <= repetition <= 100:
            raise ValueError(f"repetition: impossible value {repetition}")
        return ShapeModel(
            tuple(levels), origin, radius, contrast, symmetries, centre, bool(is_round[0]), float(repetition)
        )


@lru_cache(maxsize=16)
def reach_px(model: ShapeModel) -> float:
    """Distance of a model's farthest point from the centre about which it turns, wherever its origin is."""
    return float(np.linalg.norm(model.levels[0].points - model.centre_px, axis=1).max())


def _checked(arrays: Mapping[str, npt.NDArray[Any]], name: str, shape: tuple[int, ...]) -> FloatArray:
    if name not in arrays:
        raise ValueError(f"{name}: missing")
    value = arrays[name]
    fits = value.ndim == len(shape) and all(
        want in (-1, have) for want, have in zip(shape, value.shape, strict=True)
    )
    if not fits or value.dtype != np.float64 or not np.isfinite(value).all():
        raise ValueError(
            f"{name}: expected finite float64 of the shape {shape}, got {value.dtype} {value.shape}"
        )
    return np.ascontiguousarray(value)
