"""The terms of a published sigma: each is right, and together they are what is published."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import cells
from helpers.snapshots import make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Outcome, Status, Target
from edged.payload import outcome_to_json
from edged.pipeline import locate, prepare
from edged.robot.budget import budget_of
from edged.robot.covariance import robot_covariance
from edged.vision.part.consistency import doubted, without_doubt
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

TERMS = ("edges", "calibration", "registration", "doubt")
MAGNITUDES = st.sampled_from([0.0, 1e-9, 1e-6, 1e-5, 3e-4, 1e-2])


@pytest.fixture(scope="module")
def job() -> Job:
    """A job of the flange."""
    flat = cells.flange()
    return teach(flat.left, flat.right, prepare(flat.rig).rectification, flat.region, "flange")


def located(job: Job, covariance: FloatArray | None) -> Target:
    """The flange measured with a rig of this covariance."""
    flat = cells.flange()
    rig = prepare(replace(flat.rig, covariance=covariance))
    outcome = locate(cells.frame_pair(flat.left, flat.right), job, rig)
    assert Status.OK is outcome.status
    return outcome.targets[0]


def spread(size: float, seed: int) -> FloatArray:
    """A (6, 6) covariance without zeros."""
    factor = np.random.default_rng(seed).normal(size=(6, 6))
    return size * factor @ factor.T


def published(target: Target, robot: FloatArray | None, registration: FloatArray | None) -> FloatArray:
    """The published variances of X, Y, Z and of the rotation."""
    if robot is None:
        return np.diag(target.covariance)
    return np.diag(robot_covariance(target, robot, registration))


@pytest.mark.slow
@settings(max_examples=300)
@given(MAGNITUDES, MAGNITUDES, MAGNITUDES, MAGNITUDES, st.integers(0, 10_000), st.booleans(), st.booleans())
def test_the_terms_add_up_to_the_last_bit(
    edges: float, rig: float, registration: float, share: float, seed: int, in_robot: bool, known: bool
) -> None:
    """The terms add up to the published variance exactly, for any sizes and frames, and none is negative."""
    by_edges = spread(edges, seed)
    target = replace(
        make_target(), covariance=by_edges + spread(rig, seed + 1), by_edges=by_edges, doubt_mm=0.0
    )
    target = doubted(target, share, 60.0)
    robot = make_transform((0.4, -1.0, 2.0), (600.0, -30.0, 800.0)) if in_robot else None
    of_robot = spread(registration, seed + 2) if known else None

    budget = budget_of(target, robot, of_robot)

    assert budget is not None
    total = np.array([math.fsum(axis) for axis in zip(*budget.terms, strict=True)])
    assert published(target, robot, of_robot).tobytes() == total.tobytes()
    assert min(term.min() for term in budget.terms) >= 0.0
    scale = total.max()
    rotation = np.eye(6)
    if robot is not None:
        rotation[:3, :3] = rotation[3:, 3:] = robot[:3, :3]
    np.testing.assert_allclose(
        budget.edges, np.diag(rotation @ by_edges @ rotation.T), atol=1e-12 * scale, rtol=1e-9
    )
    np.testing.assert_allclose(
        budget.doubt, np.diag(rotation @ target.by_doubt @ rotation.T), atol=1e-12 * scale, rtol=1e-9
    )
    assert not budget.doubt[3:].any()
    if robot is None or of_robot is None:
        assert budget.registration.max() <= 1e-12 * scale


@pytest.mark.slow
def test_a_rig_that_is_taken_as_exact_has_no_share(job: Job) -> None:
    """With an exact rig all of the sigma comes from the edges."""
    exact = located(job, None)
    budget = budget_of(exact, None, None)
    assert budget is not None
    assert np.diag(exact.covariance).tobytes() == budget.edges.tobytes()
    assert not (budget.calibration.any() or budget.registration.any() or budget.doubt.any())

    uncertain = {f"{side}.{name}" for side in ("left", "right") for name in ("fx", "cx", "cy")}
    names = cells.flange().rig.parameter_names
    known = located(job, np.diag([1e-4 * (name in uncertain) for name in names]))
    more = budget_of(known, None, None)
    assert more is not None
    assert (more.calibration > 0).all()
    np.testing.assert_allclose(more.edges[:5], budget.edges[:5], rtol=1e-6)
    np.testing.assert_allclose(
        more.calibration[:5], (np.diag(known.covariance) - np.diag(exact.covariance))[:5], rtol=1e-6
    )
    assert more.edges[5] == pytest.approx(budget.edges[5], rel=0.01)  # holes are weighted by both


def test_the_turn_errs_with_the_rig_by_what_its_term_says(job: Job) -> None:
    """A focal length that is wrong by a sigma turns the part by about the calibration's term."""
    flat = cells.flange()
    names = flat.rig.parameter_names
    known = located(job, np.diag([9.0 * (name == "right.fx") for name in names]))
    wrong = prepare(replace(flat.rig, right=replace(flat.rig.right, fx=flat.rig.right.fx + 3.0)))
    (moved,) = locate(cells.frame_pair(flat.left, flat.right), job, wrong).targets
    turned = moved.rig_from_part[:3, :3] @ known.rig_from_part[:3, :3].T
    budget = budget_of(known, None, None)
    assert budget is not None
    by_axis = 0.5 * np.abs([turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    np.testing.assert_allclose(np.sqrt(budget.calibration[4:]), by_axis, rtol=0.2)


def test_a_doubt_is_a_term_of_its_own_and_can_be_taken_back(job: Job) -> None:
    """A doubt is a term of its own, along the ray; the edges' term stays, and the doubt can be removed."""
    target = located(job, None)
    before, wide = budget_of(target, None, None), doubted(target, 1e-3, 60.0)
    after = budget_of(wide, None, None)
    assert before is not None
    assert after is not None
    assert after.doubt[2] == pytest.approx((1e-3 * target.position_mm[2]) ** 2, rel=0.05)
    np.testing.assert_allclose(after.edges, before.edges, rtol=1e-12)
    assert not without_doubt(wide, 60.0).by_doubt.any()


def test_it_is_in_what_locate_prints(job: Job) -> None:
    """`locate` prints the terms in mm², in the robot's frame if there is one, with null for unknown ones."""
    flat = cells.flange()
    target = located(job, None)
    robot, registration = flat.rig.robot_from_rig, 1e-6 * np.eye(6)
    outcome = Outcome(Status.OK, (target, replace(target, by_edges=None)))
    text = json.dumps(
        outcome_to_json(
            outcome, calibration="cal", timing_ms={}, robot_from_rig=robot, registration=registration
        )
    )
    first, second = json.loads(text)["targets"]
    terms = [np.array(first["budget"][name]) for name in TERMS]
    turns = [np.array(first["budget"]["rotation"][name]) for name in TERMS]
    total = np.array([math.fsum(axis) for one in (terms, turns) for axis in zip(*one, strict=True)])
    assert np.diag(np.array(first["pose_robot"]["covariance_6x6"])).tobytes() == total.tobytes()
    assert terms[2].min() > 0
    assert turns[2].min() > 0
    assert second["budget"] is None
