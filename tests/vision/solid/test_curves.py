"""Parts that were taught from a pair alone, as edges of their taught curves."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.blockpart import REFERENCE_MM, block, pair_of_block, taught
from helpers.cells import frame_pair, small_rig
from helpers.flatparts import only
from helpers.tilted import lying

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject
from edged.domain.stopwatch import Stopwatch
from edged.pipeline import inspect
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import apply, turn_between
from edged.vision.solid.climb import FULL, climb, eye_of, response_of, step_of, straight
from edged.vision.solid.curvemodel import curve_model
from edged.vision.solid.edgemodel import EdgePoints, sampled
from edged.vision.solid.scan import BINS
from edged.vision.solid.visible import Cameras, see, view_of


def edges_beside(break_mm: float) -> EdgePoints:
    """Samples of the second edges of the block's curves, in the walls."""
    points = sampled(curve_model(taught().job, break_mm), 0.2)
    rows = points.curve % 3 == 2
    return EdgePoints._make(field[rows] for field in points)


def test_the_second_edge_of_a_break_lies_in_the_wall() -> None:
    """The second edge lies inside a hole, outside of the outline, and as far below the face as the break
    is wide."""
    job = taught().job
    beside = edges_beside(0.3)
    for circle in job.circles:
        away = np.hypot(*(beside.points - circle.centre_mm)[:, :2].T)
        near = np.abs(away - (circle.radius_mm - 0.3)) < 0.01
        near &= np.abs(beside.points[:, 2] - circle.centre_mm[2] - 0.3) < 0.01
        assert near.sum() > 2 * math.pi * (circle.radius_mm - 0.3) / 0.2 - 2, circle.name
    main = [edge for edge in job.edges if abs(edge.start_mm[2]) < 0.1]
    amid = np.mean([0.5 * (edge.start_mm + edge.end_mm) for edge in main], axis=0)
    for edge in main:
        middle = 0.5 * (edge.start_mm + edge.end_mm)
        nearest = beside.points[np.linalg.norm(beside.points - middle, axis=1).argmin()]
        assert np.linalg.norm((nearest - amid)[:2]) > np.linalg.norm((middle - amid)[:2])


def test_a_lower_edge_that_was_taught_besides_is_no_second_curve() -> None:
    """A rim that was taught 0.4 mm within a hole and below it counts as the other end of its break."""
    job = taught().job
    hole = job.circles[0]
    below = replace(
        hole,
        name="below",
        centre_mm=hole.centre_mm + np.array([0.0, 0.0, 0.4]),
        radius_mm=hole.radius_mm - 0.4,
    )
    both = replace(job, circles=(*job.circles, below))
    broken, sharp = (len(np.unique(curve_model(both, width).chain)) for width in (0.4, 0.0))
    assert (broken, sharp) == (len(np.unique(curve_model(job).chain)), broken + 1)


@pytest.mark.parametrize("distortion", [(0.0,), (-0.8,), (0.6,), (-0.3, 0.1, 1e-3, -5e-4, 0.0)])
def test_a_picture_without_distortion_holds_all_of_the_one_with_it(distortion: tuple[float, ...]) -> None:
    """The undistorted picture shows every pixel of the distorted one, at its place."""
    model = "division" if len(distortion) == 1 else "brown"
    camera = CameraModel(model, 320, 240, 400.0, 405.0, 150.0, 130.0, distortion)
    plain, source, inside = straight(camera)
    rng = np.random.default_rng(3)
    pixels = rng.uniform((2, 2), (317, 237), (200, 2))
    u, v = (camera.normalise(pixels) * (plain.fx, plain.fy) + (plain.cx, plain.cy)).T
    assert np.all((u >= 0) & (v >= 0) & (u <= plain.width - 1) & (v <= plain.height - 1))
    there = u.astype(np.float32), v.astype(np.float32)
    shown = np.column_stack([cv2.remap(each, *there, cv2.INTER_LINEAR).ravel() for each in source])
    assert np.abs(shown - pixels).max() < 0.1
    assert inside[np.rint(v).astype(int), np.rint(u).astype(int)].all()


@pytest.mark.parametrize("seed", range(3))
def test_a_pose_climbs_to_where_both_cameras_respond(seed: int) -> None:
    """From some degrees and millimetres off the pose reaches a higher response and a smaller error."""
    rig, model = small_rig(), curve_model(taught().job)
    where = lying(rig, 20.0, 30.0, 40.0)
    cameras = Cameras.of(rig, 2)
    plain = [straight(camera).camera for camera in cameras.models]
    left, right = (eye_of(plain[k], cameras.from_rig[k]) for k in (0, 1))
    samples, maps = sampled(model, 0.3), []
    for k in (0, 1):
        seen = see(model, samples, view_of(plain[k], cameras.from_rig[k] @ where, model.centre), 256)
        drawn = np.zeros((BINS, plain[k].height, plain[k].width), np.uint8)
        x, y = np.rint(seen.pixels).astype(int).T
        angle = np.arctan2(seen.normals[:, 1], seen.normals[:, 0])
        bins = np.rint(angle * BINS / math.pi).astype(int) % BINS
        for dx in (-2, -1, 0, 1, 2):  # graded, as edges of a picture are
            for dy in (-2, -1, 0, 1, 2):
                value = FULL - 3 * max(abs(dx), abs(dy))
                drawn[bins, y + dy, x + dx] = np.maximum(drawn[bins, y + dy, x + dx], value)
        maps.append(drawn)
    pose, moved = where.copy(), np.empty((4, 4))
    rng = np.random.default_rng(seed)
    for axis, most in enumerate([0.06] * 3 + [0.8] * 3):
        step_of(pose, model.centre, axis, float(rng.uniform(-most, most)), moved)
        pose = moved.copy()

    def response(at: FloatArray) -> float:
        return sum(
            response_of(samples.points, samples.along, at, eye, seen, 1)
            for eye, seen in zip((left, right), maps, strict=True)
        )

    poses, scores = pose[None].copy(), np.empty(1)
    climb(
        samples.points[None], samples.along[None], np.zeros(1, np.int64), poses, left, right, *maps,
        model.centre, np.array([0.1] * 3 + [1.0] * 3), 1, scores,
    )  # fmt: skip
    assert scores[0] == pytest.approx(response(poses[0]))
    assert scores[0] > response(pose)
    off, before = (
        np.linalg.norm(apply(at, model.centre) - apply(where, model.centre)) for at in (poses[0], pose)
    )
    assert off < max(0.6, 0.7 * before)
    assert turn_between(poses[0], where) < math.radians(6.0)


@pytest.mark.long
def test_a_part_that_its_shape_does_not_find_is_found_by_its_edges() -> None:
    """The block tilted by 30 degrees, not found by its outline, is found by its edges to a tenth of a mm."""
    here = taught()
    job = replace(here.job, search=replace(here.job.search, min_score=0.999))
    where = lying(here.rig.rig, 30.0, 100.0, 200.0)
    target = only(replace(here, job=job).see(block(where)))
    assert target.reject is Reject.NONE
    error = target.position_mm - apply(where, np.array([*REFERENCE_MM, 0.0]))
    assert np.linalg.norm(error) < 0.1
    assert (np.abs(error) < 4 * np.sqrt(np.diag(target.covariance)[:3])).all()


@pytest.mark.long
def test_a_job_of_a_few_small_circles_is_looked_for_all_the_same() -> None:
    """For three small pins far apart there is no good target and no error."""
    here = taught()
    pin = replace(here.job.circles[0], radius_mm=0.4)
    places = ((0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (0.0, 60.0, -2.0))
    circles = tuple(replace(pin, name=f"p{k}", centre_mm=np.array(place)) for k, place in enumerate(places))
    job = replace(here.job, circles=circles, edges=(), slots=(), corners=(), reference="p0", measurements=(),
                  witness=None)  # fmt: skip
    outcome = replace(here, job=job).see(block(lying(here.rig.rig, 30.0, 100.0, 200.0)))
    assert all(target.reject is not Reject.NONE for target in outcome.targets)


@pytest.mark.long
def test_stages_are_those_of_any_measurement() -> None:
    """Also with a second search the pictures are rectified once, and the stages are the usual ones."""
    here = taught()
    job = replace(here.job, search=replace(here.job.search, min_score=0.999))
    pair = frame_pair(*pair_of_block(here.rig, block(lying(here.rig.rig, 30.0, 100.0, 200.0))))
    watch, named = Stopwatch(), list[str]()

    def lap(stage: str) -> None:
        named.append(stage)
        watch(stage)

    inspect(pair, job, here.rig, lap)
    assert named.count("rectify") == 1
    assert set(watch.stages_ms()) == {"rectify", "find", "measure"}
