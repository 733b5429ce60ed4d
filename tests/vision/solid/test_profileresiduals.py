"""The remainder of a profile after fitting steps equals that of least squares."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edged.vision.solid.params import PROFILE
from edged.vision.solid.profileresiduals import DIGIT, find_left


def test_what_steps_leave_is_that_of_least_squares() -> None:
    """With and without slopes, for one or two edges, the remainder is that of least squares, and NaN for
    an edge outside."""
    rng = np.random.default_rng(4)
    size, blur, reach = 33, 0.8, 7.0
    places = PROFILE.step_px * (np.arange(size) - size // 2)
    profiles = 90.0 + 60.0 * (places > -1.0) - 30.0 * (places > 2.5) + rng.normal(0.0, 2.0, (3, size))
    profiles += 2.0 * np.maximum(places - 2.5, 0.0)
    edges = np.array([[-1.0, 2.5], [-1.2, math.nan], [8.0, math.nan]])
    for slopes in (False, True):
        left = np.full(3, math.nan)
        find_left(profiles, np.arange(3), edges, blur, 2, reach, slopes, left)
        assert math.isnan(left[2])
        for m in (0, 1):
            ends = edges[m][np.isfinite(edges[m])]
            steps = [[0.5 * (1 + math.erf((x - e) / blur / math.sqrt(2))) for x in places] for e in ends]
            beyond = [np.minimum(places - ends.min(), 0.0), np.maximum(places - ends.max(), 0.0)]
            design = np.column_stack([np.ones(size), *steps, *(beyond if slopes else [])])
            rest = profiles[m] - design @ np.linalg.lstsq(design, profiles[m], rcond=None)[0]
            assert left[m] == pytest.approx(math.log(rest @ rest + DIGIT), abs=0.03)
