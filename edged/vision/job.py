"""What is to be found and measured: the taught job as values."""

from __future__ import annotations

from dataclasses import dataclass, field

from edged.domain import FloatArray
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams


@dataclass(frozen=True, slots=True, eq=False)
class CircleFeature:
    """A circle of the part.

    centre_mm (3,) : in the part frame.  radius_mm.
    polarity : +1 brighter outside than inside (a hole), -1 darker outside (a disc), as taught.
    """

    name: str
    centre_mm: FloatArray
    radius_mm: float
    polarity: int


@dataclass(frozen=True, slots=True)
class Limits:
    """What makes a result good.

    depth_mm : (nearest, farthest) of the reference point, rig z.
    min_support : share of the reference circle's edge that each camera must see.
    max_rms_px : of the reference circle's edges.  max_sigma_mm : of each coordinate.
    max_epipolar_px : rms row difference of corresponding points.
    radius_tolerance_mm : deviation of the reference radius from the taught one; None: not checked.
    """

    depth_mm: tuple[float, float]
    min_support: float = 0.3
    max_rms_px: float = 0.5
    max_sigma_mm: float = 0.2
    max_epipolar_px: float = 1.0
    radius_tolerance_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A taught part.

    number : how the PLC calls it.  circles : largest first; `reference` names the one whose centre is
    the reported position.  rig_from_part (4, 4) : pose at teaching.
    """

    name: str
    number: int
    shape: ShapeModel
    circles: tuple[CircleFeature, ...]
    reference: str
    rig_from_part: FloatArray
    limits: Limits
    search: SearchParams = field(default_factory=SearchParams)

    @property
    def reference_circle(self) -> CircleFeature:
        """The circle that defines the position."""
        return next(circle for circle in self.circles if circle.name == self.reference)
