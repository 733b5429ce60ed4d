"""Plain-loop twins of the kernels of `adapters`: slow, but simple enough to trust."""

from __future__ import annotations

import math


def clock_extremes(
    gates: list[tuple[int, int, int]], drift: float, wander: float, step_ns: int
) -> tuple[float, float]:
    """Least and greatest host time at device time 0 among all lines that pass all gates.

    gates : (device time, earliest host time, latest host time). Tries 2001 slopes within the drift.
    """
    least, greatest = math.inf, -math.inf
    for k in range(-1000, 1001):
        slope = 1 + drift * k / 1000
        floor = max(low - slope * x - wander * abs(x) - step_ns / 2 for x, low, _ in gates)
        ceiling = min(high - slope * x + wander * abs(x) + step_ns / 2 for x, _, high in gates)
        if floor <= ceiling:
            least, greatest = min(least, floor), max(greatest, ceiling)
    return least - step_ns / 2, greatest + step_ns / 2
