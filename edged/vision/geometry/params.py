"""Tuned parameters of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RectificationParams:
    """The size of rectified images and how their maps are computed.

    Where a line names no source, `tools/bench ablate --only RectificationParams` shows what the number earns.
    """

    border_points: int = 65  # per image side: an undistorted border is smooth, exact to 0.1 px
    band_rows: int = 16  # rows of a map computed at a time, to stay in the cache: 2.4 times as fast
    size_multiple: int = 16  # four pyramid levels halve the image without a remainder
    max_growth: float = 4.0  # most pixels, over the raw image's: further wide-angle corners only cost time
    min_shrink: float = 0.5
    """Least factor on the focal length used to keep that limit; below it the views hardly overlap."""


RECTIFICATION = RectificationParams()
