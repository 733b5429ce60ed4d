"""Whether all taught curves agree with a part that was measured by some of them."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.cells import frame_pair
from helpers.drawnparts import place, rig
from solids import Design, Wall, box, circle
from solidworld import drawn

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Reject, Target
from edged.pipeline import locate
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.part.job import Job
from edged.vision.solid.locate import all_edges_agree
from edged.vision.teaching.pair import teach

PLATE = Wall("base", box(0.0, 0.0, 20.0, 20.0, 4.0), -1, True, 0.0, 5.0)
HOLES = tuple(
    Wall(f"hole{k}", circle(x, y, 1.6), 0, False, 0.0, 5.0)
    for k, (x, y) in enumerate(((6.0, 6.0), (-6.0, 6.0), (6.0, -6.0), (-6.0, -6.0)))
)
SQUARE = Design("square", (PLATE,))
HOLED = Design("holed", (PLATE, *HOLES))


@functools.cache
def seen(design: Design, tilt_deg: float) -> tuple[Image, Image]:
    """A pair of a part; a tilt of 0 is the pose it is taught in."""
    rng = np.random.default_rng((84, round(tilt_deg)))
    return drawn(design, place(tilt_deg), rng, teaching=tilt_deg == 0.0)[0]


@functools.cache
def taught(design: Design) -> Job:
    """The job of a part that may lie tilted."""
    job = teach(*seen(design, 0.0), rig().rectification, None, design.name)
    return replace(job, tilt_rad=math.radians(30.0))


def target_at(job: Job, pair: tuple[Image, Image], true: FloatArray) -> Target:
    """What was measured in a pair, put to a true pose of the job's part frame."""
    target = locate(frame_pair(*pair), job, rig()).targets[0]
    return replace(target, rig_from_part=true @ np.linalg.inv(job.reference_from_part), reject=Reject.NONE)


def pose_of(job: Job, tilt_deg: float) -> FloatArray:
    """True pose of a job's part frame."""
    return np.asarray(place(tilt_deg) @ np.linalg.inv(place(0.0)) @ job.rig_from_part)


@pytest.mark.long
def test_a_turn_that_is_as_likely_is_no_agreement_unless_the_job_declares_it() -> None:
    """A square plate lies as well after a quarter turn: known as such, or in doubt."""
    job, pair = taught(SQUARE), seen(SQUARE, 12.0)
    images = StereoImages.of(rig().rectification, *pair)
    target = target_at(job, pair, pose_of(job, 12.0))
    declared = replace(job.shape, symmetries=np.array([[0.0, 0.0, math.pi / 2, 1.0]]))
    assert all_edges_agree(images, replace(job, shape=declared), [target])
    unknown = replace(job.shape, symmetries=np.zeros((0, 4)))
    assert not all_edges_agree(images, replace(job, shape=unknown), [target])


@pytest.mark.long
def test_a_part_whose_circles_one_picture_does_not_show_does_not_agree() -> None:
    """Circles that the right picture lacks are those of another place."""
    job, pair = taught(HOLED), seen(HOLED, 12.0)
    assert len(job.circles) >= 3
    pose = pose_of(job, 12.0)
    target = target_at(job, pair, pose)
    declared = replace(job.shape, symmetries=np.array([[0.0, 0.0, math.pi / 2, 1.0]]))
    job = replace(job, shape=declared, edges=(), corners=())  # besides them only traced outlines
    assert all_edges_agree(StereoImages.of(rig().rectification, *pair), job, [target])
    camera, right = rig().rig, pair[1].copy()
    covered = np.zeros(right.shape, np.uint8)
    for hole in job.circles:
        centre = apply(camera.right_from_left, apply(pose, hole.centre_mm)[None])
        x, y = np.rint(camera.right.project(centre)[0]).astype(int).tolist()
        reach = round(2.0 * hole.radius_mm * camera.right.fx / float(centre[0, 2]))
        cv2.circle(covered, (x, y), reach, 255, -1)
    right = np.asarray(cv2.inpaint(right, covered, 3.0, cv2.INPAINT_TELEA), np.uint8)
    assert not all_edges_agree(StereoImages.of(rig().rectification, pair[0], right), job, [target])
