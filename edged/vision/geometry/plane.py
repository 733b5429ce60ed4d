"""A plane of the rig frame, and where rays meet it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Points X of the rig frame with normal . X = offset; the normal points towards the cameras."""

    normal: FloatArray
    offset: float

    def meet(self, rays: FloatArray) -> FloatArray:
        """Points (..., 3) where rays (..., 3) from the rig's origin meet the plane."""
        return np.asarray(rays * (self.offset / (rays @ self.normal))[..., None])
