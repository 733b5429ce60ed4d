"""How a shape model is made: which edges count, number of levels."""

from __future__ import annotations

from dataclasses import dataclass, field

from edged.errors import TeachError
from edged.vision.edges.hysteresis import EdgeThresholds

MAX_LEVELS = 5


@dataclass(frozen=True, slots=True)
class ModelParams:
    """What of a region becomes the model.

    edges : which edges belong to it.
    levels : 1 to 5, of the pyramid; fewer where the shape does not survive so far up. None means "auto".
    Steps of angle and scale follow from the model's radius on each level; the metric is the search's
    `polarity`. Wrong values raise `TeachError` that names them.
    """

    edges: EdgeThresholds = field(default_factory=EdgeThresholds)
    levels: int | None = None

    def __post_init__(self) -> None:
        levels = self.levels
        if levels is not None and (isinstance(levels, bool) or levels not in range(1, MAX_LEVELS + 1)):
            raise TeachError(f"levels {levels}: expected 1 to {MAX_LEVELS}")
