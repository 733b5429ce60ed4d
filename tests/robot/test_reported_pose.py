"""The published pose of the CAD model's frame, or of a point in it: place, and sigma by simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.snapshots import make_target, make_transform

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Outcome, Reject, ReportedPose, Status, Target
from edged.domain.picking import Bounds, Box, Grasp, Picking
from edged.robot.budget import budget_of
from edged.robot.covariance import robot_covariance
from edged.robot.picking import RobotFrame, picked, with_allowed_grasps
from edged.vision.geometry.rigid import rotation_matrix
from edged.vision.geometry.uncertainty import shifted_pose_covariance

POSE = make_transform((0.3, -0.2, 0.9), (12.0, -7.0, 210.0))
FAR = POSE @ make_transform((0.0, np.pi, 0.4), (60.0, 25.0, -30.0))
ROBOT = make_transform((2.9, 0.1, -0.4), (420.0, -130.0, 600.0))
DRAWS = 10_000


def spread(seed: int) -> FloatArray:
    """(6, 6) covariance of a pose, about 10 µm and 0.2 mrad, with correlations."""
    factor = np.diag([0.01] * 3 + [2e-4] * 3) @ np.random.default_rng(seed).normal(size=(6, 6))
    return factor @ factor.T


def moved(poses: FloatArray, motions: FloatArray) -> FloatArray:
    """Poses (N, 4, 4), turned about their own origins and shifted, by motions (N, 6)."""
    result = poses.copy()
    result[:, :3, 3] += motions[:, :3]
    turns = np.array([rotation_matrix(one) for one in motions[:, 3:]])
    result[:, :3, :3] = turns @ poses[:, :3, :3]
    return result


def seen_spread(poses: FloatArray, middle: FloatArray) -> FloatArray:
    """(6, 6) covariance of poses (N, 4, 4) about a middle one, as `Target` defines it."""
    turned = poses[:, :3, :3] @ middle[:3, :3].T
    vectors = 0.5 * np.stack(
        [
            turned[:, 2, 1] - turned[:, 1, 2],
            turned[:, 0, 2] - turned[:, 2, 0],
            turned[:, 1, 0] - turned[:, 0, 1],
        ],
        axis=1,
    )
    return np.cov(np.hstack([poses[:, :3, 3] - middle[:3, 3], vectors]).T)


def reporting(covariance: FloatArray) -> Target:
    """A target measured at its reference point with another published pose."""
    lever = shifted_pose_covariance(covariance, FAR[:3, 3] - POSE[:3, 3])
    return dataclasses.replace(
        make_target(),
        rig_from_part=POSE,
        covariance=covariance,
        by_edges=covariance,
        reported=ReportedPose(FAR, lever, lever),
        reject=Reject.NONE,
    )


def agree(wanted: FloatArray, seen: FloatArray) -> bool:
    """Whether both agree within the chance of this many draws, in units of the sigmas."""
    sigma = np.sqrt(np.diag(wanted))
    return bool(np.abs((seen - wanted) / np.outer(sigma, sigma)).max() < 5 * np.sqrt(2 / DRAWS))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_sigma_of_another_point_is_that_of_many_drawn_poses(seed: int) -> None:
    """70 mm beside the reference point, with other axes, sigma equals the scatter of many drawn poses."""
    covariance = spread(seed)
    motions = np.random.default_rng(seed).multivariate_normal(np.zeros(6), covariance, DRAWS)
    poses = moved(np.repeat(POSE[None], DRAWS, axis=0), motions) @ (np.linalg.inv(POSE) @ FAR)
    assert agree(reporting(covariance).as_reported.covariance, seen_spread(poses, FAR))


@pytest.mark.slow
def test_the_registration_of_the_robot_is_in_it() -> None:
    """In the robot's frame sigma includes the registration's, about the robot's origin."""
    covariance, registration = spread(4), 0.3 * spread(5)
    rng = np.random.default_rng(6)
    motions = rng.multivariate_normal(np.zeros(6), covariance, DRAWS)
    poses = ROBOT @ moved(np.repeat(POSE[None], DRAWS, axis=0), motions) @ (np.linalg.inv(POSE) @ FAR)
    frames = rng.multivariate_normal(np.zeros(6), registration, DRAWS)
    turns = np.array([rotation_matrix(one) for one in frames[:, 3:]])
    shifted = poses.copy()
    shifted[:, :3, :3] = turns @ poses[:, :3, :3]
    shifted[:, :3, 3] = np.einsum("nij,nj->ni", turns, poses[:, :3, 3]) + frames[:, :3]
    target = reporting(covariance).as_reported
    assert agree(robot_covariance(target, ROBOT, registration), seen_spread(shifted, ROBOT @ FAR))
    budget = budget_of(target, ROBOT, registration)
    assert budget is not None
    assert np.sum(budget.terms, axis=0) == pytest.approx(
        np.diag(robot_covariance(target, ROBOT, registration))
    )


def test_bounds_are_those_of_the_published_place_and_grasps_those_of_the_part() -> None:
    """Bounds apply to the published place, grasps to the part."""
    target = reporting(spread(7))
    near = Box("near", (0.0, -20.0, 200.0), (30.0, 20.0, 220.0))
    refused = picked(Outcome(Status.OK, (target,)), Picking(bounds=(Bounds((near,)),)), RobotFrame())
    assert Status.LOW_QUALITY is refused.status
    assert Reject.OUT_OF_LIMITS in refused.targets[0].reject
    grasp = Grasp("top", make_transform((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), POSE, 10.0, 10.0, 1)
    told = picked(Outcome(Status.OK, (target,)), Picking(grasps=(grasp,)), RobotFrame()).targets[0]
    assert np.array_equal(FAR, told.rig_from_part)
    assert told.grasp is not None
    assert np.allclose((POSE @ [1.0, 2.0, 3.0, 1.0])[:3], told.grasp.rig_from_tcp[:3, 3])


def test_pictures_have_the_part_as_it_was_measured() -> None:
    """Pictures show the part at its reference point; only the published pose differs."""
    target = reporting(spread(8))
    assert np.array_equal(POSE, with_allowed_grasps(target, Picking(), RobotFrame()).rig_from_part)
    plain = dataclasses.replace(target, reported=None)
    assert plain is plain.as_reported
