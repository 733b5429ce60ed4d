"""Scan of a picture for views of a part: its kernels beside plain sums."""

from __future__ import annotations

import numpy as np
import pytest

from edged.vision.solid.climb import FULL
from edged.vision.solid.scan import BINS, TOGETHER, coarse_peaks


@pytest.mark.parametrize("points", [TOGETHER, 32])
def test_a_view_is_best_where_most_responses_are(points: int) -> None:
    """The two best places of each view, at every second pixel, have the sums that numpy finds there."""
    rng = np.random.default_rng(points)
    width, height, pad, views = 40, 30, 12, 6
    padded = rng.integers(0, FULL + 1, (BINS, 2 * (height + 2 * pad), 2 * (width + 2 * pad))).astype(np.uint8)
    phases = np.stack([padded[:, y::2, x::2] for y in (0, 1) for x in (0, 1)])
    phases = np.ascontiguousarray(phases.reshape(2, 2, BINS, -1))
    offsets, bins = rng.uniform(-18, 18, (views, points, 2)), rng.integers(0, BINS, (views, points))
    chosen, sizes, peaks = np.arange(views), rng.uniform(0.8, 1.2, views), np.empty((views, 2, 3))
    coarse_peaks(phases, width, height, offsets, bins, chosen, sizes, pad, points, peaks)
    for k in range(views):
        total = np.zeros((height, width), np.int64)
        for (dx, dy), number in zip(np.rint(offsets[k] * sizes[k]).astype(int), bins[k], strict=True):
            rows, columns = 2 * pad + dy + 2 * np.arange(height), 2 * pad + dx + 2 * np.arange(width)
            total += padded[number][np.ix_(rows, columns)]
        for most, x, y in peaks[k]:
            assert most == total[int(y) // 2, int(x) // 2] == total.max()
            near = np.ix_(
                np.arange(max(0, int(y) // 2 - 2), min(height, int(y) // 2 + 3)),
                np.arange(max(0, int(x) // 2 - 2), min(width, int(x) // 2 + 3)),
            )
            total[near] = 0
