"""Map of the sigma to expect in a job's working volume.

Places of the reference point, rig frame, are on a grid across the left picture at the nearest, the middle and
the farthest depth that the job allows; the part has the same orientation as at teaching.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.pipeline import PreparedRig
from edged.setup.pairs import Progress, silent
from edged.vision.part.expected import Scatters, expected_target
from edged.vision.part.job import Job

ACROSS, DOWN, DEEP = 9, 7, 3
"""Number of places in each direction."""


@dataclass(frozen=True, slots=True, eq=False)
class SigmaMap:
    """Expected sigma on a grid. places_mm (N, 3), rig frame; x runs fastest, then y, then z.

    axes : values of the grid in each direction. sigma_mm (N, 3) : of X, Y, Z, from edges and calibration; NaN
    where the part is not in both pictures. left_px (N, 2) : raw.  limit_mm : the job's limit for each sigma.
    """

    axes: tuple[FloatArray, FloatArray, FloatArray]
    places_mm: FloatArray
    sigma_mm: FloatArray
    left_px: FloatArray
    limit_mm: float

    @property
    def seen(self) -> FloatArray:
        """Places where a part can be measured at all, (N,) bool."""
        return np.asarray(np.isfinite(self.sigma_mm).all(axis=1))

    def cell_of(self, place_mm: FloatArray) -> int | None:
        """Index of the grid place nearest to a place (3,); None outside the volume."""
        number, stride = 0, 1
        for axis, value in zip(self.axes, place_mm, strict=True):
            step = float(axis[1] - axis[0])
            index = round(float(value - axis[0]) / step)
            if not 0 <= index < len(axis):
                return None
            number, stride = number + stride * index, stride * len(axis)
        return number


def sigma_map(rig: PreparedRig, job: Job, scatters: Scatters, progress: Progress = silent) -> SigmaMap:
    """Compute the sigma to expect of a job. scatters : as in `expected_target`."""
    axes = _axes(rig, job)
    x, y, z = axes
    places = np.array([(a, b, c) for c in z for b in y for a in x])
    sigma = np.full_like(places, np.nan)
    for number, place in enumerate(places):
        pose = job.rig_from_part.copy()
        pose[:3, 3] = place
        target = expected_target(rig.rectification, job, pose, scatters)
        if target is not None:
            sigma[number] = target.as_reported.sigma_mm
        progress("sigma", number + 1, len(places))
    return SigmaMap(axes, places, sigma, rig.rig.left.project(places), job.limits.max_sigma_mm)


def _axes(rig: PreparedRig, job: Job) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Axes of the grid; it covers the left picture at the middle depth."""
    left = rig.rig.left
    near, far = job.limits.depth_mm
    z = np.linspace(near, far, DEEP)
    corners = np.array([(x, y) for x in (0, left.width - 1) for y in (0, left.height - 1)], np.float64)
    rays = left.normalise(corners) * float(z[DEEP // 2])
    (low_x, low_y), (high_x, high_y) = rays.min(axis=0), rays.max(axis=0)
    return np.linspace(low_x, high_x, ACROSS), np.linspace(low_y, high_y, DOWN), z
