"""Results of a measurement, and the evidence for them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edged.domain.measurement import Target
from edged.vision.curves.planefit import CurveFit


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPart:
    """A target, the evidence for it, and the fitted curves with their edges (for pictures)."""

    target: Target
    evidence: Evidence
    fits: tuple[CurveFit, ...]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence for a target; NaN where it is undetermined.

    support : visible share of the edges in the camera that sees less of them.  rms_px : of those edges.
    row_shift_px, row_sigma_px : of the right image against the left.
    scale, sigma_scale : relative excess of all sizes over the taught ones, and its sigma from the edges and
    the distance.
    form_mm : largest deviation of a straight edge or slot from its taught place.
    break_mm : width of the edge breaks of a part without a CAD model: either end may be measured.
    """

    support: float
    rms_px: float
    row_shift_px: float = math.nan
    row_sigma_px: float = math.nan
    scale: float = math.nan
    sigma_scale: float = math.nan
    form_mm: float = math.nan
    break_mm: float = 0.0  # 0: sharp, or known
