"""Broken rims: the light decides which end of a break each camera sees, and the sigma covers it."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.brokenparts import DARK, FACE, pair_of
from helpers.cells import frame_pair, pose, region_around, small_rig
from helpers.flatparts import cell, only

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject, Target
from edged.pipeline import PreparedRig, inspect, locate, prepare
from edged.vision.curves.params import BREAKS
from edged.vision.geometry.rigid import invert
from edged.vision.part.consistency import apply_limits, vaguest_mm
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

AS_DARK = np.full((2, 2), DARK)
"""Breaks in the light that they are taught in: as dark as walls, so that the face ends where they do."""
WHERE = pose(turn_deg=40.0, tilt_deg=5.0)
BREAK_MM = 0.22


@functools.cache
def rig() -> PreparedRig:
    """The small rig, the same for all tests of a process."""
    return prepare(small_rig())


@functools.cache
def broken() -> Job:
    """A disc with three holes, all rims broken, taught where both cameras see the upper ends."""
    images = pair_of(rig().rig, pose(), BREAK_MM, AS_DARK)
    region = region_around(rig().rig, pose()[:3, 3], 15.0)
    return teach(*images, rig().rectification, region, "broken")


def worst_sigmas(job: Job, target: Target, where: FloatArray) -> float:
    """The largest error of a coordinate, or of the normal in its own direction, in stated sigmas."""
    true = where @ invert(pose()) @ job.rig_from_part
    error = target.position_mm - true[:3, 3]
    tilt = np.cross(where[:3, 2], target.rig_from_part[:3, 2])
    towards = tilt / np.linalg.norm(tilt)
    turned = np.linalg.norm(tilt) / math.sqrt(towards @ target.covariance[3:, 3:] @ towards)
    return float(max(np.abs(error / target.sigma_mm).max(), turned))


@pytest.mark.long
@pytest.mark.parametrize(
    ("lights", "side_rad"),
    [
        ([[0.35, 0.1], [0.1, 0.35]], 2.2),
        ([[0.62, 0.1], [0.35, 0.1]], 2.2),
        ([[0.1, 0.1], [0.1, 0.35]], 0.0),
        ([[0.35, 0.1], [0.35, 0.1]], 2.2),
    ],
)
def test_each_camera_sees_its_own_ends(lights: list[list[float]], side_rad: float) -> None:
    """With breaks that are bright on one side, and differently in both cameras, a result is within four of
    its sigmas, and its sigma is large."""
    images = pair_of(rig().rig, WHERE, BREAK_MM, np.array(lights), side_rad)
    target = only(locate(frame_pair(*images), broken(), rig()))
    assert target.reject is Reject.NONE
    assert worst_sigmas(broken(), target, WHERE) < 4.0
    assert target.sigma_mm[2] > 0.05


def test_a_sharp_edge_is_not_taken_for_a_broken_one() -> None:
    """For a textured part with sharp rims, level or tilted, no curve gets a break."""
    here = cell("disc")
    for where in (pose(), WHERE):
        (measured,) = inspect(frame_pair(*here.see(where)), here.job, here.rig).measured
        assert {0.0} == {one.scatter.break_mm for one in measured.fits}


@pytest.mark.long
def test_a_highlight_beside_the_rims_is_a_break() -> None:
    """For rims with a highlight all around the width of the break is that of the highlight, to a third."""
    glinting = np.full((2, 2), 2.0 * FACE)
    images = pair_of(rig().rig, pose(), 0.4, glinting)
    region = region_around(rig().rig, pose()[:3, 3], 15.0)
    job = teach(*images, rig().rectification, region, "glinting")
    (measured,) = inspect(frame_pair(*images), job, rig()).measured
    (width_mm,) = {one.scatter.break_mm for one in measured.fits}
    assert width_mm == pytest.approx(0.4, rel=0.35)
    assert measured.target.sigma_mm[2] > 0.05


@pytest.mark.long
def test_a_radius_at_the_other_end_is_a_break() -> None:
    """If small breaks are taught at the upper ends and seen at the lower ones, within the tolerance, the
    sigma covers the distance between both ends."""
    narrow_mm = 0.07
    dark, bright = (pair_of(rig().rig, pose(), narrow_mm, np.full((2, 2), one)) for one in (DARK, FACE))
    region = region_around(rig().rig, pose()[:3, 3], 15.0)
    job = teach(*dark, rig().rectification, region, "narrow")
    (measured,) = inspect(frame_pair(*bright), job, rig()).measured
    assert {BREAKS.usual_mm} == {one.scatter.break_mm for one in measured.fits}
    assert worst_sigmas(job, measured.target, pose()) < 4.0


@pytest.mark.long
def test_holes_whose_breaks_each_camera_sees_otherwise_are_taught_in_one_face() -> None:
    """Holes whose breaks the cameras see differently are taught in the plane of the face."""
    lights = np.array([[0.35, DARK], [DARK, 0.35]])
    images = pair_of(rig().rig, pose(), 0.15, lights)
    region = region_around(rig().rig, pose()[:3, 3], 15.0)
    job = teach(*images, rig().rectification, region, "broken")
    assert len(job.circles) > 1
    assert {0.0} == {round(float(one.centre_mm[2]), 3) for one in job.circles}


def test_a_normal_that_is_not_held_is_refused() -> None:
    """A tilt sigma of half a degree moves the far end of a part of 26 mm by 0.11 mm, and is refused for
    that."""
    here = cell("disc")
    (measured,) = inspect(frame_pair(*here.see(pose())), here.job, here.rig).measured
    job = replace(here.job, limits=replace(here.job.limits, max_sigma_mm=0.1))
    good = apply_limits(job, here.rig.rectification, measured.target, measured.evidence)
    assert good.reject is Reject.NONE
    assert vaguest_mm(job, good) < 0.01
    covariance = good.covariance + np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 0.0]) * math.radians(0.5) ** 2
    vague = replace(good, covariance=covariance)
    assert vaguest_mm(job, vague) == pytest.approx(13.0 * math.radians(0.5), rel=0.05)
    assert Reject.SIGMA_LIMIT == apply_limits(job, here.rig.rectification, vague, measured.evidence).reject
