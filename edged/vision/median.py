"""The median by counting, for kernels.

Selecting and sorting compare samples with each other, and the processor guesses every second outcome
wrong. Counting them in bins leaves it nothing to guess: twice as fast for some hundred samples.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edged.vision.jit import kernel

F64 = npt.NDArray[np.float64]

_BINS = 256
_FEW = 16


@kernel("f8(f8[::1], i8)")
def _ranked(values: F64, rank: int) -> float:
    """The value that `rank` others precede in order."""
    rest, count = values.copy(), len(values)
    bins, tally = np.empty(count, np.int64), np.empty(_BINS, np.int64)
    while count > _FEW:
        low, high = rest[0], rest[0]
        for n in range(count):
            low, high = min(low, rest[n]), max(high, rest[n])
        scale = (_BINS - 1) / (high - low) if high > low else 0.0
        tally[:] = 0
        for n in range(count):
            bins[n] = min(max(int((rest[n] - low) * scale), 0), _BINS - 1)
            tally[bins[n]] += 1
        chosen = 0
        while rank >= tally[chosen]:
            rank -= tally[chosen]
            chosen += 1
        if tally[chosen] == count:  # all are equal
            return float(low)
        count = 0
        for n in range(len(bins)):
            rest[count] = rest[n]
            count += bins[n] == chosen
        bins = bins[:count]
    ordered = np.sort(rest[:count])
    return float(ordered[rank])


@kernel("f8(f8[::1])")
def median(values: F64) -> float:
    """As numpy's: of an even number of values the mean of both in the middle. At least one value, finite."""
    count = len(values)
    upper = _ranked(values, count // 2)
    if count % 2 == 1:
        return float(upper)
    lower, fewer = -np.inf, 0
    for n in range(count):
        less = values[n] < upper
        fewer += less
        lower = max(lower, values[n] if less else -np.inf)
    return float(0.5 * (upper + (lower if fewer == count // 2 else upper)))
