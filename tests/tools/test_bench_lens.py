"""Ways to choose a lens model, in comparison with the truth."""

from __future__ import annotations

import bench_lens
import numpy as np
import pytest


@pytest.mark.long
def test_a_stated_model_that_is_wrong_is_the_worst_way() -> None:
    """For a usual tangential part division errs far beyond its sigma, and the choice takes Brown-Conrady."""
    ways = bench_lens.compared_rigs("brown, 4e-4", 6, seed=1)
    assert set(bench_lens.ROWS) == set(ways)
    assert ways["division stated"].chi2 > 10
    brown = ways["brown stated"]
    for row in ("auto", "Akaike alone", "Bayes", "held out"):
        np.testing.assert_allclose(ways[row].error_um, brown.error_um, rtol=0.02, err_msg=row)
    assert ways["auto"].chi2 < 4
