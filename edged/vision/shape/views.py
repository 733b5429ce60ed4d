"""A shape as it looks tilted: maps of its plane that a scan tries beside the taught look."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import wrapped


@dataclass(frozen=True, eq=False)
class ShapeViews:
    """Views of one shape, the taught one first.

    linear (V, 2, 2), tilt (V, 2) : how a model point looks, linear p / (1 + tilt . p), px of the finest
    level; linear has no turn of its own.  turns (V, 2) : middle and half width, rad, of the rotations in
    which a view can be met.
    """

    linear: FloatArray
    tilt: FloatArray
    turns: FloatArray

    @cached_property
    def max_stretch(self) -> float:
        """Largest ratio of the scales of a view."""
        sizes = np.linalg.svd(self.linear, compute_uv=False)
        return float((sizes[:, 0] / sizes[:, 1]).max())

    @cached_property
    def groups(self) -> npt.NDArray[np.int64]:
        """(V,) the quarter of the compass to which a view leans: leaning to and fro looks much alike."""
        return np.asarray(np.floor(-self.turns[:, 0] / (0.5 * np.pi) + 0.5).astype(np.int64) % 4)

    def on_level(self, view: int, level: int) -> FloatArray:
        """(6,) linear part and tilt of a view, px of a level."""
        return np.concatenate([self.linear[view].ravel(), self.tilt[view] * 2.0**level])

    def meets(self, view: int, angles_rad: FloatArray) -> npt.NDArray[np.bool_]:
        """Which rotations (N,) a view can be met in."""
        middle, half = self.turns[view]
        return np.asarray(np.abs(wrapped(angles_rad - middle)) <= half + 1e-9)
