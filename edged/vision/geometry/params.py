"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RectificationParams:
    """The size of rectified images and how their maps are computed.

    Where a line names no source, `tools/bench ablate --only RectificationParams` shows what the number earns.
    """

    border_points: int = 65  # per image side: the border of a lens is smooth, exact to 0.1 px
    band_rows: int = 16  # of a map at a time, which stays in the cache: 2.4 times as fast as in one piece
    size_multiple: int = 16  # four pyramid levels halve the image without a remainder
    max_growth: float = 4.0  # pixels over the raw image's: wide-angle corners beyond it only cost time
    min_shrink: float = 0.5
    """Least factor on the focal length that keeps within that growth; below it the views hardly overlap."""


RECTIFICATION = RectificationParams()
