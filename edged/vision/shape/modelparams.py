"""How a shape model is made: thresholds of its edges, number of levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.errors import TeachError

MAX_LEVELS = 5
MIN_POINTS = 24
"""Edge points that a level needs."""


@dataclass(frozen=True, slots=True)
class ModelParams:
    """What of a region becomes the model. None means "auto": it follows from the region itself.

    contrast_low, contrast_high : hysteresis thresholds, slope of an edge in grey values per px. What exceeds
        the low one belongs to the model if it is connected to what exceeds the high one.
    min_component_px : connected edges shorter than this are texture.
    levels : 1 to 5, of the pyramid; fewer where the shape does not survive so far up.
    Steps of angle and scale follow from the model's radius on each level; the metric is the search's
    `polarity`. Wrong values raise `TeachError` that names them.
    """

    contrast_low: float | None = None
    contrast_high: float | None = None
    min_component_px: float | None = None
    levels: int | None = None

    def __post_init__(self) -> None:
        for name in ("contrast_low", "contrast_high"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and 0.1 <= value <= 255):
                raise TeachError(f"{name} {value}: expected 0.1 to 255 grey values per px")
        low, high = self.contrast_low, self.contrast_high
        if low is not None and high is not None and low > high:
            raise TeachError(f"contrast_low {low:g}: expected at most contrast_high, {high:g}")
        size = self.min_component_px
        if size is not None and not (np.isfinite(size) and 1 <= size <= 1e5):
            raise TeachError(f"min_component_px {size}: expected 1 to 100000 px")
        levels = self.levels
        if levels is not None and (isinstance(levels, bool) or levels not in range(1, MAX_LEVELS + 1)):
            raise TeachError(f"levels {levels}: expected 1 to {MAX_LEVELS}")
