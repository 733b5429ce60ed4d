"""Parts measured by corrected cameras: the pose is true, and sigma includes the correction's."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.cells import region_around

from edged.domain.arrays import SIDES
from edged.domain.frames import FramePair
from edged.domain.measurement import Measurement, Reject, Status
from edged.pipeline import PreparedRig, corrected, inspect, judge, locate, prepare
from edged.robot.budget import budget_of
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.render.scene import RenderedView
from edged.vision.geometry.correction import RigCorrection
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.part.calibratedframe import in_calibrated_frame, moved
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

DRIFT = np.array([3e-4, -2e-4, 1e-4, 0.03, -0.02, 0.04, 8e-5, -1e-4, 3e-4, 2e-4, -0.05, 0.02, 0.01, -6e-5])
PART = transform(rotation_matrix(np.array([0.02, -0.03, 0.4])), np.array([10.0, -3.0, 205.0]))


@cache
def cell() -> tuple[VirtualCell, Job, PreparedRig]:
    """The demo's cell with its part taught."""
    virtual = VirtualCell(demo_rig(), demo_part(), seed=1)
    left, right, truth = virtual.teach_pair()
    prepared = prepare(virtual.rig)
    region = region_around(virtual.rig, truth.rig_from_part[:3, 3], 15.0)
    return virtual, teach(left, right, prepared.rectification, region, "flange"), prepared


@cache
def seen(drifted: bool) -> FramePair:
    """A pair of the part, by cameras as calibrated or as drifted."""
    virtual, rig = cell()[0], demo_rig()
    correction = RigCorrection(DRIFT if drifted else np.zeros(14), np.zeros((14, 14)))
    images = [
        RenderedView(correction.camera(rig, side), correction.camera_from_world(rig, side)).render(
            virtual.scene(PART), np.random.default_rng((index, 2))
        )
        for index, side in enumerate(SIDES)
    ]
    return FramePair.of_images(*images)


@pytest.mark.long
def test_a_part_is_found_where_it_is_though_the_cameras_are_not() -> None:
    """With the correction the part is right to 4 µm; without it, it is off by tens of µm or refused."""
    _, job, prepared = cell()
    known = RigCorrection(DRIFT, 1e-16 * np.eye(14))
    outcome = locate(seen(True), job, corrected(prepared, known))
    assert Status.OK is outcome.status
    target = outcome.targets[0]
    assert target.position_mm == pytest.approx(PART[:3, 3], abs=4e-3)
    plain = locate(seen(True), job, prepared)
    if plain.targets:
        assert np.abs(plain.targets[0].position_mm - PART[:3, 3]).max() > 0.02
    circles = {circle.name: circle for circle in target.circles}
    reference = circles[job.reference]
    assert reference.centre_mm == pytest.approx(target.position_mm, abs=1e-2)


@pytest.mark.slow
def test_no_displacement_changes_no_digit_but_sigma() -> None:
    """A correction of zero with a covariance of zero changes neither the pose nor, beyond rounding, sigma."""
    _, job, prepared = cell()
    nothing = corrected(prepared, RigCorrection(np.zeros(14), np.zeros((14, 14))))
    plain, same = locate(seen(False), job, prepared), locate(seen(False), job, nothing)
    assert len(plain.targets) == len(same.targets) == 1
    before, after = plain.targets[0], same.targets[0]
    assert np.array_equal(before.rig_from_part, after.rig_from_part)
    assert after.covariance == pytest.approx(before.covariance, rel=1e-12)
    assert before.by_marks is None
    assert after.by_marks is not None
    assert not after.by_marks.any()


@pytest.mark.long
def test_what_the_correction_does_not_know_is_in_every_sigma() -> None:
    """Over draws of displacements pose, circles and sizes scatter as their covariances state."""
    _, job, prepared = cell()
    sigmas = np.tile([2e-5, 2e-5, 1e-5, 4e-3, 4e-3, 6e-3, 2e-5], 2)
    known = RigCorrection(DRIFT, np.diag(sigmas**2))
    target = locate(seen(True), job, corrected(prepared, known)).targets[0]
    rng = np.random.default_rng(3)
    poses, radii = [], []
    for _ in range(40):
        drawn = replace(
            known, displacement=DRIFT + sigmas * rng.standard_normal(14), covariance=np.zeros((14, 14))
        )
        measured = inspect(seen(True), job, corrected(prepared, drawn)).measured[0].target
        found = in_calibrated_frame(job, measured, prepared.rig, drawn)
        poses.append(found.position_mm)
        radii.append(found.circles[0].radius_mm)
    assert target.by_marks is not None
    scatter, stated = np.std(poses, axis=0), np.sqrt(np.diag(target.by_marks)[:3])
    assert scatter == pytest.approx(stated, rel=0.35)
    plain = locate(seen(False), job, prepared).targets[0]
    added = target.circles[0].covariance[3, 3] - plain.circles[0].covariance[3, 3]
    assert 0.3 * np.var(radii) < added < 3 * np.var(radii) + 1e-8
    budget = budget_of(target, None, None)
    assert budget is not None
    assert budget.marks is not None
    assert budget.marks[:3] == pytest.approx(stated**2, rel=1e-6)
    assert sum(budget.terms)[:3] == pytest.approx(target.sigma_mm**2, rel=1e-9)


@pytest.mark.slow
def test_a_correction_that_knows_too_little_is_no_result() -> None:
    """A correction with too large a covariance gives LOW_QUALITY for the sigma limit."""
    _, job, prepared = cell()
    vague = RigCorrection(DRIFT, np.diag(np.tile([1e-3] * 3 + [0.5] * 3 + [1e-4], 2) ** 2))
    outcome = locate(seen(True), job, corrected(prepared, vague))
    assert Status.LOW_QUALITY is outcome.status
    assert Reject.SIGMA_LIMIT in outcome.targets[0].reject


@pytest.mark.slow
def test_a_moved_target_is_the_same_part() -> None:
    """A target that is moved there and back is the same."""
    _, job, prepared = cell()
    target = judge(inspect(seen(False), job, prepared)).targets[0]
    target = replace(target, measurements=(Measurement("d", "diameter", "mm", 28.0, 1e-3),))
    there = transform(rotation_matrix(np.array([0.3, -0.2, 0.5])), np.array([4.0, 5.0, -6.0]))
    back = moved(moved(target, there), np.linalg.inv(there))
    assert back.rig_from_part == pytest.approx(target.rig_from_part, abs=1e-9)
    assert back.covariance == pytest.approx(target.covariance, rel=1e-9, abs=1e-15)
    for one, other in zip(back.circles, target.circles, strict=True):
        assert one.centre_mm == pytest.approx(other.centre_mm, abs=1e-9)
        assert one.covariance == pytest.approx(other.covariance, rel=1e-9, abs=1e-15)
