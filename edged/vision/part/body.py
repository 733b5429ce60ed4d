"""The surface of a part whose CAD model is known, kept by its job; for occlusion see `curvevisibility`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import I64, FloatArray

MAX_TRIANGLES = 100_000
"""Most triangles that a job keeps; a part with more is taught without its surface. Of 75 public designs, with
fillets, letters and threads, the largest has 82,000. Finding takes 1.5 times as long with 45,000 as with
20,000."""
MAX_SIZE_MM = 1e4  # largest coordinate in a job file
MAX_BREAK_MM = 10.0  # largest edge break in a job file
BREAKS = ("breaks_mm", "sigma_break_mm")
MERGED = "merged_mm"


@dataclass(frozen=True, slots=True, eq=False)
class PartBody:
    """A part's surface in its part frame, mm.

    points_mm (N, 3).  triangles (M, 3) : counter-clockwise seen from outside.
    lines (L, 4) : the sharp edges: indices of both end points, and of the triangles on both sides.
    breaks_mm (L,) : width of the edge break that the real part has there and the surface lacks, 0 for none;
    None: not known, so that each pair must show it.
    sigma_break_mm : sigma of these widths.
    merged_mm : breaks narrower than this show no form: a chamfer and a rounding look alike.
    """

    points_mm: FloatArray
    triangles: I64
    lines: I64
    breaks_mm: FloatArray | None = None
    sigma_break_mm: float = 0.0  # the widths are exact
    merged_mm: float = 0.0  # all breaks show their form

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays for a file; single precision resolves a nanometre on a part of a centimetre."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "points_mm": self.points_mm.astype(np.float32),
            "triangles": self.triangles.astype(np.uint32),
            "lines": self.lines.astype(np.uint32),
        }
        if self.breaks_mm is not None:
            arrays["breaks_mm"] = self.breaks_mm.astype(np.float32)[:, None]
            arrays["sigma_break_mm"] = np.full((1, 1), self.sigma_break_mm, np.float32)
            if self.merged_mm > 0:
                arrays[MERGED] = np.full((1, 1), self.merged_mm, np.float32)
        return arrays

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> PartBody:
        """Inverse of `to_arrays`. Raises `ValueError` that names the fault."""
        points = checked(arrays, "points_mm", 3, np.dtype(np.float32)).astype(np.float64)
        triangles = checked(arrays, "triangles", 3, np.dtype(np.uint32)).astype(np.int64)
        lines = checked(arrays, "lines", 4, np.dtype(np.uint32)).astype(np.int64)
        if not np.isfinite(points).all() or (len(points) and np.abs(points).max() > MAX_SIZE_MM):
            raise ValueError("points_mm: impossible values")
        if not 4 <= len(triangles) <= MAX_TRIANGLES or len(points) > 3 * MAX_TRIANGLES:
            raise ValueError(f"triangles: {len(triangles)}, expected 4 to {MAX_TRIANGLES}")
        if triangles.max() >= len(points):
            raise ValueError("triangles: of points that are not there")
        if len(lines) > 3 * MAX_TRIANGLES:
            raise ValueError(f"lines: {len(lines)}, expected at most {3 * MAX_TRIANGLES}")
        if len(lines) and (lines[:, :2].max() >= len(points) or lines[:, 2:].max() >= len(triangles)):
            raise ValueError("lines: of points or triangles that are not there")
        if "breaks_mm" not in arrays:
            return PartBody(points, triangles, lines)
        breaks, sigma = (checked(arrays, name, 1, np.dtype(np.float32)) for name in BREAKS)
        merged = np.zeros((1, 1))
        if MERGED in arrays:
            merged = checked(arrays, MERGED, 1, np.dtype(np.float32))
        if len(breaks) != len(lines) or len(sigma) != 1 or len(merged) != 1:
            raise ValueError(f"breaks_mm: {len(breaks)} of {len(lines)} lines, expected one each")
        widths = np.concatenate([breaks, sigma, merged])
        if not ((widths >= 0) & (widths < MAX_BREAK_MM)).all():
            raise ValueError(f"breaks_mm: expected widths of 0 to {MAX_BREAK_MM:g} mm")
        own = breaks[:, 0].astype(np.float64)
        return PartBody(points, triangles, lines, own, float(sigma[0, 0]), float(merged[0, 0]))

    @property
    def sides(self) -> tuple[I64, I64]:
        """Sides (K, 2) shared by two triangles, as point indices, and the indices of both (K, 2)."""
        return neighbours(self.triangles)

    @property
    def normals(self) -> FloatArray:
        """(M, 3) unit normals of the triangles, outwards; 0 where a triangle has no area."""
        corners = self.points_mm[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(normals / np.where(length > 0, length, 1.0))


def checked(arrays: Mapping[str, npt.NDArray[Any]], name: str, wide: int, kind: np.dtype[Any]) -> Any:
    """The array (N, wide) of a name. Raises `ValueError` if it is missing or of another kind or shape."""
    if name not in arrays:
        raise ValueError(f"{name}: missing")
    value = arrays[name]
    if value.dtype != kind or value.ndim != 2 or value.shape[1] != wide:
        raise ValueError(f"{name}: {value.dtype} {value.shape}, expected {kind} (N, {wide})")
    return value


def neighbours(triangles: I64) -> tuple[I64, I64]:
    """Sides (K, 2) shared by two of triangles (M, 3), as point indices, and the indices of both (K, 2)."""
    sides, owner, start, count = all_sides(triangles)
    start = start[count == 2]
    return sides[start], np.stack([owner[start], owner[start + 1]], axis=1)


def all_sides(triangles: I64) -> tuple[I64, I64, I64, I64]:
    """Sides (K, 2) of all triangles, sorted, with their triangles (K,); start and count of equal ones."""
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    sides, owner = sides[sides[:, 0] != sides[:, 1]], owner[sides[:, 0] != sides[:, 1]]
    order = np.lexsort((owner, sides[:, 1], sides[:, 0]))
    sides, owner = sides[order], owner[order]
    other = np.ones(len(sides), bool)
    other[1:] = (sides[1:] != sides[:-1]).any(axis=1)
    start = np.flatnonzero(other)
    return sides, owner, start, np.diff(np.append(start, len(sides)))
