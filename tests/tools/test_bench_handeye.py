"""Hand-eye on public pictures of real robots: tools/bench handeye."""

import bench_handeye
import numpy as np
import pytest


@pytest.mark.long
def test_real_poses_of_a_robot_agree_within_a_millimetre() -> None:
    """For public pictures of a board on an industrial robot one pose is an outlier, and the others fit
    within a millimetre."""
    dataset = bench_handeye.SETS[0]
    stated, fitted = bench_handeye.rows_of(dataset, bench_handeye.kept_views(dataset))

    assert stated.outliers == ("15",)
    assert stated.rms_mm < 1.0
    assert fitted.rms_mm < 0.8
    assert fitted.size == pytest.approx(1.0036, abs=0.001)
    assert np.allclose(stated.sigma_mm, stated.jackknife_mm, rtol=0.15)
