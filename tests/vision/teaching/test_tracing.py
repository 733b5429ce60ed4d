"""Outlines that are no features: traced on the part, not on the table, and used to find it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import drawnparts
from helpers.cells import frame_pair
from helpers.tilted import lying
from solids import Design, Wall, box, circle, flattened
from solidworld import BreakLook, Look, World, pictures, world_rig

from edged.domain.measurement import Reject
from edged.pipeline import PreparedRig, inspect, judge, prepare
from edged.vision.geometry.rigid import turn_between
from edged.vision.part.job import Job, SlotFeature
from edged.vision.part.traced import TracedCurve
from edged.vision.solid.curvemodel import curve_model, curve_points, has_enough_curves
from edged.vision.solid.edgemodel import sampled
from edged.vision.teaching.pair import teach, view_of
from edged.vision.teaching.tracing import above_table, trace

BOSS_MM = 3.6
PLATE = Design(
    "plate",
    (
        Wall("base", box(0, 0, 30, 20, 5), -1, True, 0.0, 6.0),
        Wall("boss", circle(-6, 2, 4), 0, True, -BOSS_MM, 0.0, 0.3),
        Wall("slot", box(8, -4, 9, 4, 2), 0, False, 0.0, 6.0),
    ),
)
DISC = Design(
    "disc",
    (
        Wall("base", flattened(13, 6.5), -1, True, 0.0, 6.0),
        Wall("hole", circle(-6, 2, 1.5), 0, False, 0.0, 6.0),
    ),
)


def look(table: float, grain: float) -> Look:
    """A matt part with dark walls on a table of this brightness and grain."""
    plain = BreakLook(0.3, 0.0, 0.0, 1.0, 0.5)
    return Look(
        albedo=0.6, contrast=0.02, feature_mm=0.5, wall=0.2, wall_swing=0.0, wall_azimuth_rad=0.0, bore=0.5,
        breaks=(plain, plain), beneath=0.5, table=table, table_contrast=grain, table_feature_mm=0.8,
        gap_mm=4.0, gradient_per_mm=(0.0, 0.0), levels=(1.0, 1.0), blur_px=(0.6, 0.6), blur_px_per_mm=0.0,
        focus_mm=0.0,
    )  # fmt: skip


@cache
def rig() -> PreparedRig:
    """The cameras of random parts."""
    return prepare(world_rig())


@cache
def taught(design: Design, table: float = 0.03, grain: float = 0.05) -> Job:
    """The job of a part from one pair, square to the cameras."""
    world = World(design, lying(rig().rig, 0.0, 0.0, 10.0), look(table, grain), 3)
    return teach(*pictures(world, rig().rig), rig().rectification, None, design.name)


@pytest.mark.long
def test_an_outline_with_round_corners_is_traced_at_the_height_of_its_face() -> None:
    """The outline with round corners is traced at its height, 3.6 mm below the boss, to some hundredths."""
    job = taught(PLATE)
    assert [round(one.radius_mm, 1) for one in job.circles] == [3.7]
    heights = np.array([curve.points_mm[0, 2] for curve in job.traced])
    lengths = np.array([curve.length_mm for curve in job.traced])
    around = 2 * (20 + 10) + 2 * math.pi * 5
    assert lengths[np.abs(heights - BOSS_MM) < 0.05].sum() > 0.9 * around
    assert lengths[np.abs(heights - BOSS_MM) >= 0.05].sum() < 0.1 * around


@pytest.mark.long
def test_a_tables_grain_is_not_traced() -> None:
    """On a table as bright as the part, with marks as strong as its outline, nothing beyond the part is
    traced."""
    job = taught(PLATE, 0.5, 0.5)
    centre = job.circles[0].centre_mm
    for curve in job.traced:
        away = np.abs(curve.points_mm - centre)[:, :2]
        assert away.max() < math.hypot(30, 20), curve.points_mm[0]


def ring(radius_mm: float, height_mm: float, low_deg: float, high_deg: float) -> TracedCurve:
    """An arc about the axis of a part."""
    turns = np.radians(np.linspace(low_deg, high_deg, 12))
    points = radius_mm * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(12)])
    return TracedCurve(points + np.array([0.0, 0.0, height_mm]), 1)


def test_a_few_marks_far_below_a_part_are_the_tables_and_a_flange_is_not() -> None:
    """Three scratches far below the part are the table's, a flange all around is not."""
    hole = ring(2.0, 0.0, 0.0, 360.0).points_mm
    marks = [ring(30.0, 23.0, start, start + 4.0) for start in (20.0, 130.0, 250.0)]
    flange = [ring(14.0, 6.0, start, start + 50.0) for start in range(0, 360, 60)]
    assert above_table([*marks, *flange], [hole]) == flange


@pytest.mark.long
@pytest.mark.parametrize(("tilt", "side", "turn"), [(10.0, 40.0, 200.0), (25.0, 250.0, 75.0)])
def test_a_part_of_one_hole_is_turned_as_its_outline_says(tilt: float, side: float, turn: float) -> None:
    """A disc with a flat and one hole is found in the rotation of its outline, to 0.5°."""
    job = replace(taught(DISC), tilt_rad=math.radians(45.0))
    assert has_enough_curves(job)
    where = lying(rig().rig, tilt, side, turn)
    pair = frame_pair(*pictures(World(DISC, where, look(0.2, 0.1), 5), rig().rig))
    outcome = judge(inspect(pair, job, rig()))
    assert [target.reject for target in outcome.targets] == [Reject.NONE]
    as_taught = lying(rig().rig, 0.0, 0.0, 10.0)
    true = where @ np.linalg.inv(as_taught) @ job.rig_from_part
    assert turn_between(outcome.targets[0].rig_from_part, true) < math.radians(0.5)


def test_a_stadium_around_a_hole_is_no_slot() -> None:
    """The second edges of a stadium lie beyond it if the hole is in it, and within it if the hole is
    elsewhere."""
    job = taught(DISC)
    stadium = SlotFeature("s0", np.zeros(3), 0.3, 24.0, 14.0, -1)
    for x, grows in ((0.0, True), (40.0, False)):
        hole = replace(job.circles[-1], centre_mm=np.array([x, 0.0, 0.0]))
        points = sampled(
            curve_model(replace(job, circles=(hole,), slots=(stadium,), edges=(), traced=()), 0.3), 0.2
        )
        of_slot = points.curve // 3 == 1
        first, second = (np.abs(points.points[of_slot & (points.curve % 3 == k), :2]).max() for k in (1, 2))
        assert (second > first) == grows


@pytest.mark.long
def test_outlines_are_traced_also_where_one_camera_sees_the_part_much_darker() -> None:
    """If one picture is 3.6 times darker, as many outlines are traced."""
    left, right = drawnparts.pair(4)
    dark = np.rint(0.28 * right).astype(np.uint8)
    alike, other = (teach(left, each, drawnparts.rig().rectification, None, "part") for each in (right, dark))
    assert len(other.traced) == len(alike.traced) > 0


@pytest.mark.long
@pytest.mark.parametrize("ratio", [1e-3, 1e3])
def test_a_picture_that_is_black_or_white_beside_the_other_one_shows_no_outlines(ratio: float) -> None:
    """If one picture is black or white, no outline is traced."""
    left, right = drawnparts.pair(4)
    rectification = drawnparts.rig().rectification
    job = teach(left, right, rectification, None, "part")
    view = view_of(left, right, rectification, None)
    assert trace(replace(view, ratio=ratio), job.rig_from_part, curve_points(job)) == ()
