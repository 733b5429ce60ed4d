"""An offset of rendered parts does not contain the errors of registration and calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import flange, frame_pair, pictures, pose, scene
from helpers.snapshots import make_snapshot, make_transform

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.pipeline import locate, prepare
from edged.robot.covariance import robot_covariance
from edged.robot.golden import golden_of, held
from edged.sim.render.scene import Part
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import make_rectification
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, rotation_vector, transform
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

ROBOT_FROM_RIG = make_transform((2.8, 0.3, -0.4), (400.0, -700.0, 900.0))
WRONG = transform(rotation_matrix(np.array([2e-3, -1e-3, 1.5e-3])), np.array([0.4, -0.3, 0.5]))
"""A registration that is wrong by half a millimetre and by 0.15 degrees about the robot's base."""
SIGMA = np.diag(np.square([0.5, 0.5, 0.5, 2e-3, 2e-3, 2e-3]))


def seen(rig: StereoRig, part: Part, place: FloatArray, job: Job) -> Target:
    """The part at a place in pictures of the true rig, measured by another one."""
    left, right = pictures(flange().rig, scene((part, place)))
    (target,) = locate(frame_pair(left, right), job, prepare(rig)).targets
    return replace(target, reject=Reject.NONE)


@pytest.mark.long
def test_an_offset_of_rendered_parts_is_within_its_sigma_though_rig_and_registration_are_wrong() -> None:
    """With a drifted rig and a wrong registration the offset is within its sigma, and far nearer to the
    truth than the pose."""
    part = flange()
    job = teach(part.left, part.right, make_rectification(part.rig), part.region, "flange")
    relation = part.rig.right_from_left.copy()
    relation[:3, :3] = rotation_matrix(np.array([0.0, 3e-4, 0.0])) @ relation[:3, :3]  # 60 µm in depth
    size = len(part.rig.parameter_names)
    spread = np.zeros(size)
    spread[-5] = 3e-4  # of the rotation about y
    drifted = replace(
        part.rig,
        right_from_left=relation,
        covariance=np.diag(np.square(spread)),
        robot_from_rig=WRONG @ ROBOT_FROM_RIG,
        registration_covariance=SIGMA,
    )
    places = pose((8.0, 0.0, 205.0), 3.0), pose((10.0, -2.0, 205.0), 5.0)
    was, now = (seen(drifted, part.part, place, job) for place in places)
    robot = drifted.robot_from_rig
    assert robot is not None
    snapshot = replace(make_snapshot(targets=(was,), robot_from_rig=robot), registration_covariance=SIGMA)
    kept = held(golden_of(snapshot, was, job, drifted), drifted)
    outcome = kept.applied(Outcome(Status.OK, (now,)), robot, SIGMA)
    offset = outcome.targets[0].offset
    assert offset is not None
    true = ROBOT_FROM_RIG @ places[1] @ invert(places[0]) @ invert(ROBOT_FROM_RIG)
    golden_mm = (ROBOT_FROM_RIG @ places[0])[:3, 3]
    missed_mm = apply(offset.robot, golden_mm[None])[0] - apply(true, golden_mm[None])[0]
    missed_rad = rotation_vector(offset.robot[:3, :3] @ true[:3, :3].T)
    sigma = np.sqrt(np.diag(offset.covariance))
    assert (np.abs(np.concatenate([missed_mm, missed_rad])) < 4 * sigma + 1e-12).all(), (missed_mm, sigma)
    pose_error_mm = (robot @ now.rig_from_part)[:3, 3] - (ROBOT_FROM_RIG @ places[1])[:3, 3]
    pose_sigma = np.sqrt(np.diag(robot_covariance(now, robot, SIGMA)))
    assert np.linalg.norm(missed_mm) < 0.1 * np.linalg.norm(pose_error_mm), (missed_mm, pose_error_mm)
    assert np.linalg.norm(sigma[:3]) < 0.1 * np.linalg.norm(pose_sigma[:3])
