"""Thick parts and parts with several heights: taught from one pair, measured as one rigid body."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.blockpart import (
    BOSS,
    DARK,
    PLATE,
    REFERENCE_MM,
    STEP_MM,
    TaughtBlock,
    block,
    pair_of_block,
    table,
    taught,
    up,
)
from helpers.cells import frame_pair, pictures, pose, region_around, scene, small_rig
from helpers.flatparts import METAL, only
from helpers.tilted import lying, stacked

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject, Target
from edged.pipeline import inspect, locate, prepare
from edged.report.teaching import Taught, teaching_report
from edged.sim.render.scene import Disc, Hole, Part, Scene, Surface
from edged.vision.curves.foresight import ExpectedLight, scatter_in
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.planefit import CurveFit, PlaneFit
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part import measure as part_measure
from edged.vision.part.expected import expected_target, scatters_of
from edged.vision.part.frames import with_features
from edged.vision.part.job import CornerFeature, MeasurementSpec
from edged.vision.part.measured import MeasuredPart
from edged.vision.part.rigidlock import lock
from edged.vision.part.solid import curves_of, measure_solid
from edged.vision.shape.ambiguity import about, turned
from edged.vision.shape.inspection import inspect_model
from edged.vision.shape.search import find_shapes
from edged.vision.teaching.pair import teach

SEEN = scatter_in(ExpectedLight(100.0, 2.0, 0.8), 0.03)


def error_mm(target: Target, where: FloatArray) -> FloatArray:
    """The error of the reference's place, the hole "a"."""
    return target.position_mm - apply(where, np.array([*REFERENCE_MM, 0.0]))


@pytest.mark.slow
def test_teaching_finds_both_faces() -> None:
    """Each circle is taught at its own height, and z = 0 is the face with most edges."""
    here = taught()
    found = {
        (round(float(circle.radius_mm), 1), round(float(apply(here.part_from_job, circle.centre_mm)[2]), 1))
        for circle in here.job.circles
    }
    assert here.job.solid
    assert found == {(2.2, 0.0), (1.6, 0.0), (1.8, 0.0), (2.0, -STEP_MM)}
    assert abs(float(here.part_from_job[2, 3])) < 0.02
    assert len(here.job.edges) >= 4


@pytest.mark.long
@pytest.mark.parametrize(("tilt_deg", "side_deg", "turn_deg"), [
    (0.0, 0.0, 120.0), (20.0, 80.0, 250.0), (35.0, 170.0, 40.0), (45.0, 260.0, 160.0), (45.0, 20.0, 300.0),
])  # fmt: skip
def test_a_block_is_measured_to_every_side(tilt_deg: float, side_deg: float, turn_deg: float) -> None:
    """To every side, with pixels of twice the size, the block is right to 20 µm and four sigmas, its
    normal to 0.1°."""
    here = taught()
    where = lying(here.rig.rig, tilt_deg, side_deg, turn_deg)
    target = only(here.see(block(where)))
    error = error_mm(target, where)
    between = (where @ here.part_from_job)[:3, :3].T @ target.rig_from_part[:3, :3]
    assert target.reject is Reject.NONE
    assert np.abs(error).max() < 0.02
    assert (np.abs(error) < 4 * np.sqrt(np.diag(target.covariance)[:3])).all()
    assert math.degrees(math.acos(min(1.0, float(target.rig_from_part[:3, 2] @ where[:3, 2])))) < 0.1
    assert abs(math.degrees(math.atan2(between[1, 0], between[0, 0]))) < 0.1


@functools.cache
def hub() -> TaughtBlock:
    """A round plate whose rotation only three holes and an eccentric boss show."""
    rig = prepare(small_rig())
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    job = teach(*pair_of_block(rig, hub_at(where)), rig.rectification, None, "hub")
    return TaughtBlock(rig, job, invert(where) @ job.rig_from_part)


def hub_at(where: FloatArray, break_mm: float = 0.0) -> Scene:
    """The hub there; break_mm : how much wider the rims and smaller the holes are."""
    holes = (
        Hole("a", Disc(8, 2, 1.5 - break_mm)),
        Hole("b", Disc(-6, 6, 1.2 - break_mm)),
        Hole("t", Disc(-2, -2, 2.3)),
    )
    plate = Part("plate", Disc(0, 0, 13 + break_mm), METAL, holes)
    bore = Hole("bore", Disc(-2, -2, 2.0 - break_mm))
    boss = Part("boss", Disc(-2, -2, 4.0), replace(METAL, seed=5), (bore,))
    return Scene(table(), (*stacked(plate, where, 6.0, DARK), *stacked(boss, where @ up(2.0), 2.0, DARK)))


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [30.0, 95.0, 160.0, 225.0, 290.0, 355.0])
def test_a_round_part_is_not_turned(turn_deg: float) -> None:
    """The holes of a tilted round part decide its rotation: a good result is right to 1°."""
    here = hub()
    where = lying(here.rig.rig, 40.0, 2.0 * turn_deg, turn_deg)
    target = only(here.see(hub_at(where)))
    between = (where @ here.part_from_job)[:3, :3].T @ target.rig_from_part[:3, :3]
    assert target.reject is Reject.NONE
    assert abs(math.degrees(math.atan2(between[1, 0], between[0, 0]))) < 1.0


def test_a_turn_that_search_and_curves_see_differently_is_refused() -> None:
    """If search and curves give different rotations, one of four holes being odd, the part is refused."""
    holes = tuple(
        Hole(
            f"h{k}",
            Disc(8 * math.cos(k * math.pi / 2), 8 * math.sin(k * math.pi / 2), 1.5 if k else 1.1),
        )
        for k in range(4)
    )
    rig, where = prepare(small_rig()), pose()
    left, right = pictures(rig.rig, scene((Part("odd", Disc(0, 0, 13), METAL, holes), where)))
    region = region_around(rig.rig, where[:3, 3], 15.0)
    job = teach(left, right, rig.rectification, region, "odd")
    images = StereoImages.of(rig.rectification, left, right)
    (match,) = find_shapes(images.rectified_left, job.shape, job.search, rig.rectification.valid_left)
    seen = np.array([match.x_px, match.y_px, *match.linear.ravel(), *match.tilt])
    quarter = turned(seen, about(job.shape.centre_px, 0.5 * math.pi))
    wrong = replace(
        match, x_px=quarter[0], y_px=quarter[1], linear=quarter[2:6].reshape(2, 2), tilt=quarter[6:]
    )
    for seen_as, expected in ((match, Reject.NONE), (wrong, Reject.AMBIGUOUS_ROTATION)):
        result = measure_solid(images, job, seen_as)
        assert isinstance(result, MeasuredPart)
        assert result.target.reject == expected


@pytest.mark.slow
def test_half_of_the_edges_displaced_do_not_draw_the_pose_between_both() -> None:
    """If half of the edges are displaced as by a break in one picture, most edges agree with the found
    pose."""
    here = hub()
    where = lying(here.rig.rig, 15.0, 115.0, 75.0)
    left, right = pictures(here.rig.rig, hub_at(where), 7)
    _, broken = pictures(here.rig.rig, hub_at(where, break_mm=0.36), 7)
    true = where @ here.part_from_job
    middle = here.rig.rig.right.project(true[None, :3, 3])[0]
    y, x = np.mgrid[: right.shape[0], : right.shape[1]]
    beyond = (x - middle[0]) * math.cos(math.radians(120)) + (y - middle[1]) * math.sin(math.radians(120))
    images = StereoImages.of(here.rig.rectification, left, np.where(beyond > 20, broken, right))
    found = lock(images, curves_of(here.job), true)
    assert found is not None
    assert found.share > 0.5


@pytest.mark.long
@pytest.mark.parametrize(("albedo", "found"), [(0.05, 1), (0.3, 1), (0.45, 1), (0.62, 0), (0.8, 1)])
def test_walls_of_any_brightness_shift_nothing(albedo: float, found: int) -> None:
    """With darker or brighter walls the result is as right as ever; with walls as bright as the face there
    is none."""
    here = taught()
    where = lying(here.rig.rig, 30.0, 100.0, 70.0)
    wall = Surface(albedo=albedo, contrast=0.1, feature_mm=0.5, seed=3)
    good = [one for one in here.see(block(where, wall)).targets if one.reject is Reject.NONE]
    assert len(good) == found
    for target in good:
        assert (np.abs(error_mm(target, where)) < 4 * np.sqrt(np.diag(target.covariance)[:3])).all()


@pytest.mark.long
def test_sizes_are_measured_not_taken_from_teaching() -> None:
    """A bore 0.12 mm larger than taught is measured with its true size."""
    here = taught()
    where = lying(here.rig.rig, 15.0, 40.0, 30.0)
    larger = replace(BOSS, holes=(Hole("bore", Disc(-6, -3, 2.12)),))
    target = only(here.see(block(where, boss=larger)))
    bore = min(here.job.circles, key=lambda circle: abs(circle.radius_mm - 2.0))
    seen = {circle.name: circle for circle in target.circles}[bore.name]
    assert seen.radius_mm == pytest.approx(2.12, abs=0.02)


@pytest.mark.long
def test_a_flat_job_is_not_solid() -> None:
    """A plate without a boss gives a job that is not solid."""
    rig = prepare(small_rig())
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    layers = stacked(PLATE, where, 6.0, DARK)
    job = teach(*pair_of_block(rig, Scene(table(), tuple(layers))), rig.rectification, None, "plate")
    assert not job.solid


@pytest.mark.long
def test_another_part_is_not_taken_for_the_block() -> None:
    """A plate without the block's boss gives no good result."""
    here = taught()
    where = lying(here.rig.rig, 10.0, 40.0, 30.0)
    turned = replace(PLATE, holes=(Hole("a", Disc(10, -6, 1.2)), Hole("d", Disc(-9, -4, 2.5))))
    world = Scene(table(), tuple(stacked(turned, where, 6.0, DARK)))
    assert [one for one in here.see(world).targets if one.reject is Reject.NONE] == []


@pytest.mark.long
@pytest.mark.parametrize("taller_mm", [0.0, 0.08])
def test_a_height_is_measured_not_taken_from_teaching(taller_mm: float) -> None:
    """A boss that is taller than taught is measured with its true height, within four sigmas."""
    here = taught()
    floor = next(circle.name for circle in here.job.circles if circle.radius_mm < 1.7)
    bore = min(here.job.circles, key=lambda circle: abs(circle.radius_mm - 2.0))
    spec = MeasurementSpec("boss", "height", (floor, bore.name), STEP_MM, 0.5)
    job = replace(here.job, measurements=(spec,), tilt_rad=math.radians(45.0), witness=None)
    where = lying(here.rig.rig, 20.0, 40.0, 30.0)
    layers = [
        *stacked(PLATE, where, 6.0, DARK),
        *stacked(BOSS, where @ up(STEP_MM + taller_mm), STEP_MM, DARK),
    ]
    left, right = pictures(here.rig.rig, Scene(table(), tuple(layers)), 5)
    (height,) = only(locate(frame_pair(left, right), job, here.rig)).measurements
    assert abs(height.value - STEP_MM - taller_mm) < 4 * height.sigma
    assert height.sigma < 0.03
    assert height.ok


@pytest.mark.long
def test_its_sigma_is_what_was_expected_of_it() -> None:
    """All six expected sigmas of the part are the stated ones, within 7 %, with equally clear edges."""
    here = taught()
    where = lying(here.rig.rig, 20.0, 80.0, 250.0)
    job = replace(here.job, tilt_rad=math.radians(45.0))
    pair = frame_pair(*pictures(here.rig.rig, block(where), 7))
    (found,) = inspect(pair, job, here.rig).measured
    scatters = scatters_of(found.fits)
    expected = expected_target(here.rig.rectification, job, found.target.rig_from_part, scatters)
    assert expected is not None
    sigmas = (np.sqrt(np.diag(one.covariance)) for one in (expected, found.target))
    np.testing.assert_allclose(*sigmas, rtol=0.07)


@pytest.mark.slow
def test_the_report_states_heights() -> None:
    """Each circle of the boss is listed with its height over the face."""
    here = taught()
    picture = np.zeros((480, 640), np.uint8)
    page = teaching_report(
        here.job, Taught(picture, None, ()), inspect_model(here.job.shape, here.job.search)
    )
    bore = min(here.job.circles, key=lambda circle: abs(circle.radius_mm - 2.0))
    assert "place, height mm" in page
    assert f", {-float(bore.centre_mm[2]):+.3f}" in page.replace("&#43;", "+")


@pytest.mark.long
def test_a_corner_of_a_raised_face_is_reported_at_its_height() -> None:
    """A corner of a raised face is reported at the intersection of its edges in space."""
    here = taught()
    where = lying(here.rig.rig, 20.0, 40.0, 30.0)
    edges = (
        Curve("a", "edge", np.array([-4.0, -7.0, 0.0]), 1, length_mm=14.0, height_mm=-STEP_MM),
        Curve("b", "edge", np.array([-11.0, -1.5, math.pi / 2]), 1, length_mm=11.0, height_mm=-STEP_MM),
    )
    nothing = np.zeros((2, 0))
    fits = tuple(CurveFit(edge, np.ones(2), 0.1, 0.0, nothing[..., None], nothing, SEEN) for edge in edges)
    fit = PlaneFit(Face(where[:3, 3], where[:3, :3].T), fits, np.eye(9), np.eye(9), 0.0, 0.1)
    job = replace(here.job, edges=(), corners=(CornerFeature("k", ("a", "b")),))
    (corner,) = with_features(only(here.see(block(where))), job, fit).corners
    np.testing.assert_allclose(corner.position_mm, apply(where, np.array([-11.0, -7.0, -STEP_MM])))


@pytest.mark.long
def test_where_rows_of_single_curves_do_not_meet_the_whole_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the rows of single curves do not agree, the part as a whole is still good."""
    rig = prepare(small_rig())
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    pair = pair_of_block(rig, Scene(table(), tuple(stacked(PLATE, where, 6.0, DARK))))
    job = teach(*pair, rig.rectification, None, "plate")
    images = StereoImages.of(rig.rectification, *pair)
    (match,) = find_shapes(images.rectified_left, job.shape, job.search)
    flat = part_measure.measure_part(images, job, match)
    assert isinstance(flat, MeasuredPart)
    refused = replace(flat, target=replace(flat.target, reject=Reject.LEFT_RIGHT_MISMATCH))
    monkeypatch.setattr(part_measure, "_measured_flat", lambda *_: refused)
    whole = part_measure.measure_part(images, job, match)
    assert isinstance(whole, MeasuredPart)
    assert whole.target.reject is Reject.NONE
    np.testing.assert_allclose(whole.target.position_mm, flat.target.position_mm, atol=0.01)
