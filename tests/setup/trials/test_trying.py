"""The result of a job for one pair, the honesty of its sigma, and its map over the whole volume."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from helpers import cells

from edged.domain.arrays import FloatArray, Image
from edged.domain.picking import Bounds, Box
from edged.pipeline import PreparedRig, inspect, prepare
from edged.robot.orientations import Convention
from edged.setup.trials.sigmamap import ACROSS, DEEP, DOWN, sigma_map
from edged.setup.trials.stilltest import LEAST, StillResult, StillSample, interval, judged
from edged.setup.trials.tried import MOST_WHISKERS, TriedPair, stand_of, still_part, try_pair
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

SIGMA_MM = np.array([0.004, 0.003, 0.009])


@functools.cache
def taught() -> tuple[PreparedRig, Job]:
    """The rig, and a job of the flange."""
    flat = cells.flange()
    rig = prepare(flat.rig)
    return rig, teach(flat.left, flat.right, rig.rectification, flat.region, "flange")


def tried(left: Image, right: Image, bounds: Bounds | None = None) -> TriedPair:
    """The result for a pair of the flange."""
    rig, job = taught()
    return try_pair(rig, job, cells.frame_pair(left, right), bounds or Bounds(), Convention.FIXED_XYZ)


def stands(places: FloatArray, stated_mm: FloatArray = SIGMA_MM) -> list[StillSample | None]:
    """Stands of a part with the given sigma of its edges."""
    return [StillSample(one, np.diag(stated_mm**2)) for one in places]


def drawn(seed: int, count: int = 30) -> FloatArray:
    """Positions of a still part."""
    return np.array([8.0, 0.0, 205.0]) + SIGMA_MM * np.random.default_rng(seed).normal(size=(count, 3))


def test_an_honest_sigma_is_called_so() -> None:
    """About 95 % of draws with a true sigma are called honest, and chi² has the mean 1, also with few
    pictures."""
    found = [judged(stands(drawn(seed))) for seed in range(200)]
    assert 180 <= sum(one.verdict == "honest" for one in found) <= 198
    assert np.mean([one.chi2 for one in found if one.chi2 is not None]) == pytest.approx(1.0, abs=0.03)
    few = [judged(stands(drawn(seed, LEAST))) for seed in range(200)]
    assert 180 <= sum(one.verdict == "honest" for one in few) <= 198
    low, high = interval(3 * (LEAST - 1))
    assert (low, high) == (pytest.approx(4.404 / 12, abs=0.01), pytest.approx(23.337 / 12, abs=0.01))


@pytest.mark.parametrize(("factor", "verdict"), [(0.5, "larger"), (2.0, "smaller")])
def test_a_sigma_that_is_wrong_by_a_factor_of_two_is_not(factor: float, verdict: str) -> None:
    """A stated sigma of half the scatter is called too small ("larger" scatter), one of twice "smaller"."""
    found = judged(stands(drawn(3), factor * SIGMA_MM))
    assert (verdict, verdict == "smaller") == (found.verdict, found.covers)
    assert found.scatter_mm is not None
    np.testing.assert_allclose(found.scatter_mm, SIGMA_MM, rtol=0.35)


def test_a_part_that_moves_or_goes_is_no_verdict() -> None:
    """A part that is pushed, sinks, is elsewhere or gone in one picture gives no verdict."""
    pushed = drawn(4)
    pushed[13:] += 10 * SIGMA_MM
    sinking = drawn(5) + np.linspace(0, 1, 30)[:, None] * 12 * SIGMA_MM
    seen = stands(drawn(6))
    seen[20] = StillSample(drawn(6)[20] + 15 * SIGMA_MM, np.diag(SIGMA_MM**2))
    for one in (stands(pushed), stands(sinking), seen):
        assert ("moving", None, None) == (judged(one).verdict, judged(one).chi2, judged(one).covers)
    gone = [*stands(drawn(7))[:29], None]
    assert ("vanished", None) == (judged(gone).verdict, judged(gone).scatter_mm)


def of_pictures(poses: list[FloatArray], each: int) -> StillResult:
    """The verdict over several pictures of the flange at each pose, each with its own noise."""
    rig, job = taught()
    rng, seen = np.random.default_rng(2), []
    for where in poses:
        greys = cells.clean_greys(rig.rig, cells.scene((cells.flange().part, where)))
        for _ in range(each):
            pair = cells.frame_pair(*(cells.noisy(grey, 1.5, rng) for grey in greys))
            (measured,) = inspect(pair, job, rig).measured
            seen.append(stand_of(measured))
    return still_part(rig, job, seen)


@pytest.mark.long
def test_the_noise_of_its_edges_is_the_scatter_of_a_part() -> None:
    """The stated noise agrees with the scatter within a third in each axis; the sigma of the edges is
    larger."""
    found = of_pictures([cells.pose((3.0, -4.0, 207.0), 70.0, 6.0)], 24)
    assert "honest" == found.verdict
    assert found.scatter_mm is not None
    assert found.edges_mm is not None
    assert found.noise_mm is not None
    np.testing.assert_allclose(found.scatter_mm, found.noise_mm, rtol=0.33)
    assert (found.edges_mm > 2 * found.noise_mm).all()


@pytest.mark.slow
def test_a_part_that_shakes_scatters_more_than_its_edges() -> None:
    """A part that shakes by a micrometre scatters more than its edges, within its sigma."""
    rng, poses = np.random.default_rng(4), []
    for shake in 1e-3 * rng.normal(size=(10, 3)):
        poses.append(cells.pose((3.0, -4.0, 207.0), 70.0, 6.0))
        poses[-1][:3, 3] += shake
    found = of_pictures(poses, 1)
    assert found.scatter_mm is not None
    assert found.edges_mm is not None
    assert ("larger", True) == (found.verdict, found.covers)
    assert (found.scatter_mm < found.edges_mm).all()


@pytest.mark.slow
def test_a_good_pair_is_shown_as_it_was_measured() -> None:
    """A good pair gives pose, sigma, every feature's outline in both pictures, and the edges beside it."""
    flat = cells.flange()
    found = tried(flat.left, flat.right)
    (part,) = found.parts
    assert ("OK", (), "OK", []) == (found.status, found.reasons, part.status, part.reasons)
    _, job = taught()
    assert len(job.circles) + len(job.edges) >= len(part.outlines.left) == len(part.outlines.right) >= 7
    assert np.abs(found.places_mm - flat.rig_from_part[:3, 3]).max() < 0.01
    reference = flat.rig.left.project(flat.rig_from_part[None, :3, 3])[0]
    assert np.abs(np.array(part.left) - reference).max() < 0.1
    radius_px = 14.0 * flat.rig.left.fx / flat.rig_from_part[2, 3]
    rim = np.array(max(part.outlines.left, key=lambda line: np.ptp(np.array(line)[:, 0])))
    assert np.linalg.norm(rim - reference, axis=1) == pytest.approx(radius_px, rel=0.02)
    whiskers = np.array(part.residuals.left)
    assert 100 < len(whiskers) <= MOST_WHISKERS + len(part.outlines.left)
    assert part.rms_px is not None
    assert np.sqrt(np.mean(whiskers[:, 2:] ** 2)) < 0.2
    assert part.budget_um is not None
    told = part.budget_um
    squares = [one.z**2 for one in (told.edges, told.calibration, told.registration, told.doubt)]
    assert sum(squares) == pytest.approx(part.sigma_um.z**2, rel=0.01)
    assert set(found.scatters) <= {one.name for one in (*job.circles, *job.edges)}


def test_what_was_not_found_or_not_allowed_has_its_reason() -> None:
    """An empty table and a part out of bounds have their reasons; a covered hole is shown where it should
    be."""
    flat = cells.flange()
    empty = np.full_like(flat.left, 40)
    assert ("NO_TARGET", ("NOT_FOUND",), ()) == (
        (nothing := tried(empty, empty)).status,
        nothing.reasons,
        nothing.parts,
    )
    away = Bounds((Box("away", (500.0, 500.0, 500.0), (600.0, 600.0, 600.0)),))
    refused = tried(flat.left, flat.right, away)
    assert ("LOW_QUALITY", ("OUT_OF_LIMITS",)) == (refused.status, refused.reasons)
    assert 0 == len(refused.places_mm)
    _, job = taught()
    hole = next(one for one in job.circles if abs(one.radius_mm - 1.6) < 0.1)
    covered = [flat.left.copy(), flat.right.copy()]
    place = flat.rig_from_part[:3, :3] @ hole.centre_mm + flat.rig_from_part[:3, 3]
    for image, camera, from_rig in (
        (covered[0], flat.rig.left, np.eye(4)),
        (covered[1], flat.rig.right, flat.rig.right_from_left),
    ):
        x, y = np.rint(camera.project((from_rig[:3, :3] @ place + from_rig[:3, 3])[None])[0]).astype(int)
        image[y - 14 : y + 15, x - 14 : x + 15] = 120
    (part,) = tried(covered[0], covered[1]).parts
    (missing,) = part.missing.left
    seen = flat.rig.left.project(place[None])[0]
    assert np.linalg.norm(np.array(missing).mean(axis=0) - seen) < 1.0


@pytest.mark.slow
def test_the_map_is_what_a_part_there_then_says() -> None:
    """The map's cells are in order of the points, and a pose in a cell has about the sigma of the map
    there."""
    rig, job = taught()
    flat = cells.flange()
    found = tried(flat.left, flat.right)
    chart = sigma_map(rig, job, found.scatters)
    assert ACROSS * DOWN * DEEP == len(chart.places_mm) == len(chart.sigma_mm)
    assert list(range(len(chart.places_mm))) == [chart.cell_of(place) for place in chart.places_mm]
    assert chart.cell_of(np.array([0.0, 0.0, 2000.0])) is None
    assert 10 < chart.seen.sum() < len(chart.places_mm)
    here = chart.cell_of(flat.rig_from_part[:3, 3])
    assert here is not None
    (part,) = found.parts
    stated = [part.sigma_um.x, part.sigma_um.y, part.sigma_um.z]
    np.testing.assert_allclose(1e3 * chart.sigma_mm[here], stated, rtol=0.15)
    layers = chart.sigma_mm[:, 2].reshape(DEEP, -1)
    near, far = np.nanmin(layers[0]), np.nanmin(layers[-1])
    assert near < far
