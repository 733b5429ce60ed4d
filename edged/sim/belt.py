"""A conveyor belt in a virtual cell: parts and encoder count move on exactly with time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class VirtualBelt:
    """A belt that runs at constant speed.

    direction (3,) : of its travel, rig frame. mm_per_count : of its encoder, which is 0 at begun_ns (UTC) and
    wraps to 0 after `counts`. rig_from_part (4, 4) : pose that the parts pass, spacing_mm apart.
    exposure_s : of the cameras; a picture shows the parts at the middle of its exposure.
    """

    direction: FloatArray
    speed_mm_s: float
    mm_per_count: float
    begun_ns: int
    rig_from_part: FloatArray
    spacing_mm: float
    exposure_s: float
    counts: int = 2**32

    def travelled_mm(self, at_ns: int) -> float:
        """Distance travelled since begun_ns."""
        return self.speed_mm_s * 1e-9 * (at_ns - self.begun_ns)

    def count(self, at_ns: int) -> int:
        """The encoder's count as read by a PLC."""
        return int(self.travelled_mm(at_ns) / self.mm_per_count) % self.counts

    def part(self, exposed_ns: int) -> int:
        """Number of the part nearest to `rig_from_part` in the middle of an exposure."""
        return round(self._middle_mm(exposed_ns) / self.spacing_mm)

    def pose(self, exposed_ns: int) -> FloatArray:
        """rig_from_part (4, 4) of that part in the middle of the exposure that began at `exposed_ns`."""
        along_mm = self._middle_mm(exposed_ns) - self.part(exposed_ns) * self.spacing_mm
        pose = self.rig_from_part.copy()
        pose[:3, 3] += along_mm * self.direction / np.linalg.norm(self.direction)
        return pose

    def _middle_mm(self, exposed_ns: int) -> float:
        return self.travelled_mm(exposed_ns) + 500.0 * self.exposure_s * self.speed_mm_s / 1000.0
