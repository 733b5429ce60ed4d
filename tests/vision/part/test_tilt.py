"""Parts tilted to any side are found by both cameras and measured as well as flat ones."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import flange, frame_pair, pictures, pose, region_around, scene
from helpers.flatparts import Cell, cell, only
from helpers.tilted import lying, thick, thin
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject, Target
from edged.pipeline import inspect, judge, locate, prepare
from edged.sim.cell import demo_part, demo_rig
from edged.sim.render.scene import Scene, Surface
from edged.vision.geometry.rigid import invert, rotation_matrix
from edged.vision.part.job import Job
from edged.vision.part.tilt import reach_of, views_of
from edged.vision.teaching.pair import teach

TAUGHT_MM = 0.001
"""Of the place of the taught circle or corner in the part: what the teaching pair's noise moves it by."""
SIDES_AND_TURNS = ((20.0, 250.0), (110.0, 12.0), (200.0, 130.0), (290.0, 300.0))


def tilted(job: Job, tilt_deg: float) -> Job:
    """The job, searched up to this tilt."""
    return replace(job, tilt_rad=math.radians(tilt_deg))


def seen(here: Cell, job: Job, world: Scene, seed: int) -> Target:
    """The single part of a scene."""
    left, right = pictures(here.rig.rig, world, seed)
    return only(locate(frame_pair(left, right), job, here.rig))


def normal_deg(target: Target, where: FloatArray) -> float:
    """Angle between the measured and the true normal of the face."""
    return math.degrees(math.acos(min(1.0, float(target.rig_from_part[:3, 2] @ where[:3, 2]))))


def turned_deg(target: Target, true_pose: FloatArray) -> float:
    """Angle between the measured and the true x axis."""
    return math.degrees(math.acos(min(1.0, float(target.rig_from_part[:3, 0] @ true_pose[:3, 0]))))


@functools.cache
def fine() -> Cell:
    """The flange on the demo's own rig, with all its pixels."""
    rig, part = demo_rig(), demo_part()
    prepared = prepare(rig)
    left, right = pictures(rig, scene((part, pose())))
    job = teach(left, right, prepared.rectification, region_around(rig, pose()[:3, 3], 14.0), "flange")
    return Cell(prepared, job, part, invert(pose()) @ job.rig_from_part)


@functools.cache
def coarse() -> Cell:
    """The flange on the small rig."""
    taught = flange()
    prepared = prepare(taught.rig)
    job = teach(taught.left, taught.right, prepared.rectification, taught.region, "flange")
    return Cell(prepared, job, taught.part, invert(taught.rig_from_part) @ job.rig_from_part)


@pytest.mark.long
@pytest.mark.parametrize(("side_deg", "turn_deg"), SIDES_AND_TURNS)
@pytest.mark.parametrize(("asked_deg", "tilt_deg"), [(30.0, 30.0), (45.0, 45.0)])
def test_a_tilted_flange_is_as_right_as_a_flat_one(
    asked_deg: float, tilt_deg: float, side_deg: float, turn_deg: float
) -> None:
    """To any side the position is right to 3 µm and four sigmas, the normal to 0.02° and the rotation to
    0.05°."""
    here = fine()
    where = lying(here.rig.rig, tilt_deg, side_deg, turn_deg)
    target = seen(here, tilted(here.job, asked_deg), thin(here.part, where), 3)
    error = np.abs(target.position_mm - where[:3, 3])
    assert target.reject is Reject.NONE
    assert error.max() < 0.003
    assert (error < 4 * np.sqrt(np.diag(target.covariance)[:3])).all()
    assert normal_deg(target, where) < 0.02
    assert turned_deg(target, here.true_pose(where)) < 0.05


@pytest.mark.long
@pytest.mark.parametrize("name", ["plate", "disc"])
@pytest.mark.parametrize(("asked_deg", "tilt_deg"), [(30.0, 12.0), (30.0, 30.0), (45.0, 38.0), (45.0, 45.0)])
def test_tilted_parts_are_found_to_every_side(name: str, asked_deg: float, tilt_deg: float) -> None:
    """With and without circles a tilted part gives one good target within four sigmas, in the right rotation.

    With straight edges alone at 45°, within five.
    """
    here = cell(name)
    job = tilted(here.job, asked_deg)
    sigmas = 5 if (name, tilt_deg) == ("plate", 45.0) else 4
    for number, (side_deg, turn_deg) in zip((0, 2, 4, 6), SIDES_AND_TURNS, strict=True):
        where = lying(here.rig.rig, tilt_deg, side_deg, turn_deg)
        target = seen(here, job, thin(here.part, where), number)
        truth = here.true_pose(where)
        sigma = np.sqrt(np.diag(target.covariance)[:3])
        assert target.reject is Reject.NONE
        assert (np.abs(target.position_mm - truth[:3, 3]) < sigmas * sigma + 2 * TAUGHT_MM).all()
        assert turned_deg(target, truth) < 0.4


@pytest.mark.long
@pytest.mark.parametrize("tilt_deg", [15.0, 30.0, 45.0])
def test_a_thick_part_with_dark_walls_is_measured_by_its_face(tilt_deg: float) -> None:
    """A flange of 5 mm with visible dark walls is right to 10 µm and its normal to 0.05°."""
    here = coarse()
    job = tilted(here.job, max(tilt_deg, 30.0))
    wall = Surface(albedo=0.05)
    for number, (side_deg, turn_deg) in enumerate(SIDES_AND_TURNS[:3]):
        where = lying(here.rig.rig, tilt_deg, side_deg, turn_deg)
        target = seen(here, job, thick(here.part, where, 5.0, wall), number)
        assert target.reject is Reject.NONE
        assert np.abs(target.position_mm - where[:3, 3]).max() < 0.010
        assert normal_deg(target, where) < 0.05
        assert turned_deg(target, here.true_pose(where)) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(("side_deg", "turn_deg"), [(229.0, 97.0), (293.0, 0.0), (358.0, 353.0)])
def test_a_steep_face_of_edges_starts_from_its_picture(side_deg: float, turn_deg: float) -> None:
    """A plate of straight edges, whose rows do not show its plane, is measured from its match alone."""
    here = cell("plate")
    where = lying(here.rig.rig, 30.0, side_deg, turn_deg)
    target = seen(here, tilted(here.job, 30.0), thin(here.part, where), 0)
    assert target.reject is Reject.NONE
    assert np.abs(target.position_mm - here.true_pose(where)[:3, 3]).max() < 0.03


# --- views ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_flat_job_has_no_views() -> None:
    """A job without tilt has no views; with a tilt the first view is the taught one."""
    here = coarse()
    rectification = here.rig.rectification
    assert views_of(here.job, rectification) is None
    counts = []
    for tilt_deg in (10.0, 30.0, 45.0):
        views = views_of(tilted(here.job, tilt_deg), rectification)
        assert views is not None
        assert np.array_equal(views.linear[0], np.eye(2))
        assert not views.tilt[0].any()
        counts.append(len(views.turns))
    assert counts == sorted(counts)
    assert counts[-1] <= 40


@pytest.mark.long
@settings(max_examples=60)
@given(
    tilt_deg=st.floats(0.0, 45.0),
    side_deg=st.floats(0.0, 360.0),
    turn_deg=st.floats(0.0, 360.0),
)
def test_every_face_within_the_tilt_is_like_a_view(tilt_deg: float, side_deg: float, turn_deg: float) -> None:
    """Every face within the tilt has a view within an eighth of the part's size."""
    here = coarse()
    views = views_of(tilted(here.job, 45.0), here.rig.rectification)
    assert views is not None
    shape, rectification = here.job.shape, here.rig.rectification
    where = lying(here.rig.rig, tilt_deg, side_deg, turn_deg)
    ring = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    rim = np.column_stack([12 * np.cos(ring), 12 * np.sin(ring), np.zeros(48)])

    def look(rig_from_part: FloatArray) -> FloatArray:
        points = rim @ rig_from_part[:3, :3].T + rig_from_part[:3, 3]
        return rectification.rectify_points("left", rectification.rig.left.project(points))

    model = look(here.job.rig_from_part) - shape.origin_px
    face = look(where) @ (1, 1j)
    face = face - face.mean()
    misfits = []
    for k, (linear, tilt) in enumerate(zip(views.linear, views.tilt, strict=True)):
        view = (model @ linear.T / (1 + model @ tilt)[:, None]) @ (1, 1j)
        view = view - view.mean()
        similarity = (view.conj() @ face) / (view.conj() @ view)
        if views.meets(k, np.array([np.angle(similarity)]))[0]:
            misfits.append(np.sqrt(np.mean(np.abs(face - similarity * view) ** 2)))
    assert min(misfits) < 0.125 * np.sqrt(np.mean(np.abs(face) ** 2))


@pytest.mark.long
@pytest.mark.parametrize("spoilt", ["edge-on", "turned away", "out of view"])
def test_a_job_of_another_rig_is_looked_for_as_taught(spoilt: str) -> None:
    """A face that this rig does not see from above has no views, and the search goes on without them."""
    here = coarse()
    job, turn = tilted(here.job, 45.0), np.eye(4)
    if spoilt == "out of view":
        job = replace(job, shape=replace(job.shape, origin_px=np.array([9e5, 9e5])))
    else:
        angle = math.pi * (0.5 if spoilt == "edge-on" else 1.0)
        turn[:3, :3] = rotation_matrix(np.array([angle, 0.0, 0.0]))
        job = replace(job, rig_from_part=job.rig_from_part @ turn)
    assert views_of(job, here.rig.rectification) is None
    taught = flange()
    seen_all = inspect(frame_pair(taught.left, taught.right), job, here.rig)
    assert len(seen_all.measured) + len(seen_all.dismissed) == 1


def test_what_a_tilted_part_takes_up() -> None:
    """A disc of radius 13 mm spans 18.4 mm of depth at 45°; near the border it leaves the image."""
    here = cell("disc")
    rectification = here.rig.rectification
    amid = reach_of(here.job, rectification, math.radians(45.0))
    assert amid.depth_mm == pytest.approx(2 * 13 * math.sin(math.pi / 4), rel=0.03)
    assert amid.outside == ()
    off = here.job.rig_from_part.copy()
    off[0, 3] -= 42.0
    moved = rectification.rectify_points("left", rectification.rig.left.project(off[None, :3, 3]))[0]
    aside = replace(here.job, rig_from_part=off, shape=replace(here.job.shape, origin_px=moved))
    assert "left" in reach_of(aside, rectification, math.radians(45.0)).outside


@pytest.mark.long
def test_nothing_is_invented_where_no_part_lies() -> None:
    """An empty table and another part give no good target, with all views, too."""
    here = cell("disc")
    job = tilted(here.job, 45.0)
    empty = Scene(thin(here.part, pose()).table)
    other = thin(cell("plate").part, lying(here.rig.rig, 25.0, 70.0, 40.0))
    for world in (empty, other):
        pair = frame_pair(*pictures(here.rig.rig, world, 1))
        outcome = judge(inspect(pair, job, here.rig))
        assert all(target.reject is not Reject.NONE for target in outcome.targets)


def test_what_came_nearest_is_looked_for_in_all_views() -> None:
    """The nearest place of a face at 40° with too low a score is found among all views."""
    here = coarse()
    job = tilted(here.job, 45.0)
    # of one circle: with more curves it would be found by these
    strict = replace(
        job, search=replace(job.search, min_score=1.0), circles=(job.reference_circle,), edges=(), slots=(),
        corners=(), measurements=(), witness=None,
    )  # fmt: skip
    pair = frame_pair(*pictures(here.rig.rig, thin(here.part, lying(here.rig.rig, 40.0, 70.0, 40.0)), 1))
    good = only(locate(pair, job, here.rig))
    missed = locate(pair, strict, here.rig).nearest
    assert missed is not None
    nearest = missed.ask()
    assert nearest is not None
    assert (nearest.match.x_px, nearest.match.y_px) == pytest.approx(
        (good.match.x_px, good.match.y_px), abs=1.0
    )
