"""The expected sigma of a measurement equals the later stated one and the later error."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from helpers import cells
from helpers.flatparts import cell

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Reject, Target
from edged.robot.budget import budget_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import StereoImages, make_rectification
from edged.vision.part.expected import Scatters, expected_target, scatters_of
from edged.vision.part.job import Job
from edged.vision.part.measure import measure_part
from edged.vision.part.measured import MeasuredPart
from edged.vision.shape.search import find_shapes


@functools.cache
def known_rig() -> StereoRig:
    """The small rig with the covariance of a calibration: focal lengths and principal points to about 0.1
    px."""
    rig = cells.small_rig()
    sigma = {"fx": 0.2, "fy": 0.2, "cx": 0.1, "cy": 0.1}
    variances = [sigma.get(name.split(".")[1], 0.0) ** 2 for name in rig.parameter_names]
    return replace(rig, covariance=np.diag(variances))


def measured(job: Job, pair: tuple[Image, Image], rig: StereoRig | None = None) -> MeasuredPart:
    """The measured part in a pair of the small rig."""
    rectification = make_rectification(rig or known_rig())
    images = StereoImages.of(rectification, *pair)
    match = find_shapes(images.rectified_left, job.shape, job.search, rectification.valid_left)[0]
    result = measure_part(images, job, match)
    assert isinstance(result, MeasuredPart)
    return result


def expected(job: Job, pose: FloatArray, scatters: Scatters, rig: StereoRig | None = None) -> Target | None:
    """The expected target at a pose."""
    return expected_target(make_rectification(rig or known_rig()), job, pose, scatters)


def sigmas(covariance: FloatArray) -> FloatArray:
    """The six standard deviations (6,)."""
    return np.sqrt(np.diag(covariance))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "turn_deg", "tilt_deg"),
    [("plate", 20.0, 0.0), ("plate", 160.0, 8.0), ("disc", 160.0, 8.0), ("round", 20.0, 0.0)],
)
def test_where_a_part_was_measured_its_sigma_is_expected(name: str, turn_deg: float, tilt_deg: float) -> None:
    """With equally clear edges all six expected sigmas and both terms equal the measured ones within 7 %."""
    flat = cell(name)
    job = flat.job
    found = measured(job, flat.see(cells.pose(turn_deg=turn_deg, tilt_deg=tilt_deg), seed=3))
    target = found.target
    foreseen = expected(job, target.rig_from_part, scatters_of(found.fits))
    assert foreseen is not None
    assert target.by_edges is not None
    assert foreseen.by_edges is not None
    np.testing.assert_allclose(sigmas(foreseen.covariance), sigmas(target.covariance), rtol=0.07)
    np.testing.assert_allclose(sigmas(foreseen.by_edges), sigmas(target.by_edges), rtol=0.07)
    budget = budget_of(foreseen, None, None)
    assert budget is not None
    assert (budget.calibration[:3] > 0).all()
    assert not budget.doubt.any()


@pytest.mark.long
def test_elsewhere_errors_are_as_large_as_was_expected() -> None:
    """For a turned, tilted and moved part the squared errors over the expected variances have a mean near 1.

    12 places with three axes each leave a quarter to chance, and a real part's texture some more.
    """
    flat, rng = cell("disc"), np.random.default_rng(5)
    exact = cells.small_rig()
    scatters = scatters_of(measured(flat.job, flat.see(cells.pose()), exact).fits)
    squares = []
    for seed in range(12):
        x, y, z = rng.uniform((-4, -9, 198), (18, 9, 212))
        turn, tilt = rng.uniform((0.0, 0.0), (360.0, 8.0))
        where = cells.pose((float(x), float(y), float(z)), float(turn), float(tilt))
        foreseen = expected(flat.job, flat.true_pose(where), scatters, exact)
        assert foreseen is not None
        found = measured(flat.job, flat.see(where, seed), exact).target
        squares.append(((found.position_mm - flat.true_pose(where)[:3, 3]) / foreseen.sigma_mm) ** 2)
    assert 0.3 < np.mean(squares) < 2.0


def test_farther_away_the_depth_is_worse() -> None:
    """With equally clear edges the depth's sigma grows as the distance to the power of 2.5."""
    flat = cell("disc")
    scatters = scatters_of(measured(flat.job, flat.see(cells.pose())).fits)
    near, far = (
        expected(flat.job, flat.true_pose(cells.pose((8.0, 0.0, z_mm))), scatters, cells.small_rig())
        for z_mm in (195.0, 215.0)
    )
    assert near is not None
    assert far is not None
    assert far.sigma_mm[2] / near.sigma_mm[2] == pytest.approx((215 / 195) ** 2.5, rel=0.1)


def test_nothing_is_expected_of_what_the_pictures_do_not_hold() -> None:
    """Far aside or behind the cameras nothing is expected, and a sigma beyond the job's limit is refused."""
    flat = cell("disc")
    assert expected(flat.job, flat.true_pose(cells.pose((80.0, 0.0, 205.0))), {}) is None
    assert expected(flat.job, flat.true_pose(cells.pose((8.0, 0.0, -205.0))), {}) is None
    strict = replace(flat.job, limits=replace(flat.job.limits, max_sigma_mm=1e-4))
    here = flat.true_pose(cells.pose())
    vague, usual = expected(strict, here, {}), expected(flat.job, here, {})
    assert vague is not None
    assert usual is not None
    assert (Reject.SIGMA_LIMIT, Reject.NONE) == (vague.reject, usual.reject)
