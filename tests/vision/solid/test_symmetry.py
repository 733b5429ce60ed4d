"""Thick parts that are the same after a turn: taught with a file they are found, unless a detail is odd."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.drawnparts import place, rig
from solids import Design, Wall, circle, meshed
from solidtruth import write_drawing
from solidworld import Look, World, pictures, world_rig

from edged.commands.teach import read_model
from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject, Target
from edged.errors import TeachError
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import about_z, transform
from edged.vision.part.body import PartBody
from edged.vision.solid.locate import locate_solid
from edged.vision.solid.symmetry import EqualTurns, equal_turns
from edged.vision.teaching import cadpair
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.pair import WantedJob, view_of


def flange(holes: int, *more: Wall) -> Design:
    """A disc with a boss and equal holes around it."""
    disc = Wall("d", circle(0.0, 0.0, 14.0), -1, True, 0.0, 6.0)
    boss = Wall("b", circle(0.0, 0.0, 5.0), 0, True, -3.0, 0.0)
    around = [
        Wall(f"h{k}", circle(10.0 * math.cos(turn), 10.0 * math.sin(turn), 1.5), 0, False, 0.0, 6.0)
        for k, turn in enumerate(math.tau * np.arange(holes) / max(holes, 1))
    ]
    return Design("P9", (disc, boss, *around, *more))


def surface(design: Design) -> PartBody:
    """The surface of a design."""
    body = body_of(meshed(design, nominal=True).model, np.eye(4))
    assert body is not None
    return body


@pytest.mark.parametrize(
    ("design", "order"),
    [
        (flange(0), 0),
        (flange(6), 6),
        (flange(5), 5),
        (flange(1), 1),
        (flange(6, Wall("pin", circle(7.5, 0.5, 0.3), 0, False, 0.0, 0.2)), 1),
        (flange(0, Wall("mark", circle(10.0, 0.0, 0.3), 0, False, 0.0, 0.1)), 1),
    ],
    ids=["ring", "six", "five", "one", "six and a centre mark", "ring with a centre mark"],
)
def test_a_part_is_the_same_after_a_turn_if_all_of_its_edges_are(design: Design, order: int) -> None:
    """The smallest detail tells turns apart, whatever share of the edges it has."""
    found = equal_turns(surface(design))
    assert order == found.order
    if order != 1:
        assert np.hypot(*found.axis) < 0.02


@pytest.mark.parametrize("sharp", [False, True])
def test_edges_between_the_triangles_of_a_wall_tell_no_turn(sharp: bool) -> None:
    """Where one side is cut more finely than the others, it is the same part; a scratch is none of it."""
    body = surface(flange(6))
    sides, beside = body.sides
    bend = np.sum(body.normals[beside[:, 0]] * body.normals[beside[:, 1]], axis=1)
    middles = body.points_mm[sides].mean(axis=1)
    far = np.hypot(middles[:, 0], middles[:, 1]) > 13.9
    of_wall = far & (middles[:, 0] > 12.0) & (bend > math.cos(math.radians(30.0))) & (bend < 1.0 - 1e-9)
    assert np.count_nonzero(of_wall) > 3
    lines = np.column_stack([sides, beside])[of_wall]
    if sharp:  # as if the faces beside it stood upright on each other
        edge = next(line for line in body.lines if abs(np.dot(*body.normals[line[2:]])) < 0.1)
        lines[:, 2:] = edge[2:]
    body = replace(body, lines=np.concatenate([body.lines, np.repeat(lines, 40, axis=0)]))
    found = equal_turns(body)
    assert found.order == (1 if sharp else 6)
    assert np.hypot(*found.axis) < 0.02


def test_of_poses_that_are_one_that_nearest_to_the_taught_is_given() -> None:
    """The axis stays where it is; a turn beyond half a step comes back from the other side."""
    taught = transform(np.eye(3), np.array([0.0, 0.0, 200.0]))
    six = EqualTurns((3.0, 4.0), 6)
    for turn_deg, left_deg in ((0.0, 0.0), (20.0, 20.0), (40.0, -20.0), (130.0, 10.0), (-95.0, 25.0)):
        pose = taught @ transform(about_z(math.radians(turn_deg)), np.zeros(3))
        nearest = six.nearest(pose, taught)
        left = math.atan2(nearest[1, 0], nearest[0, 0])
        assert math.isclose(left_deg, math.degrees(left), abs_tol=1e-9)
        assert math.isclose(abs(left), six.turn_between(pose, taught), abs_tol=1e-6)
        axis = np.array([3.0, 4.0, 0.0, 1.0])
        assert np.allclose(pose @ axis, nearest @ axis)
    assert (
        EqualTurns((0.0, 0.0), 0).turn_between(taught, taught @ transform(about_z(2.0), np.zeros(3))) < 1e-6
    )


def turned(turn_deg: float) -> FloatArray:
    """A place of the part: tilted and turned."""
    return np.asarray(place(25.0) @ transform(about_z(math.radians(turn_deg)), np.zeros(3)))


def seen(design: Design, folder: Path, turn_deg: float, remark: str) -> Target:
    """The target of a design that is taught from its file and a pair, and turned and tilted.

    remark : what teaching says of its turns.
    """
    write_drawing(folder, design)
    _, shown = read_model(folder / "P9.step", "-z")
    look = replace(
        Look.drawn(np.random.default_rng(3)), table=0.1, table_contrast=0.05, wall=0.4, contrast=0.2
    )
    left, right = pictures(World(design, place(0.0), look, 1), world_rig())
    view = view_of(left, right, rig().rectification, None)
    settled = cadpair.teach_with_model(view, shown.curves, "P9", WantedJob("P9", 1))
    assert settled.remarks[-1].startswith(remark)
    job = replace(settled.job, tilt_rad=math.radians(45.0))
    pair = pictures(World(design, turned(turn_deg), look, 2), world_rig())
    (part,), dismissed, _ = locate_solid(StereoImages.of(rig().rectification, *pair), job)
    assert not dismissed
    assert part.target.rig_from_model is not None
    assert np.linalg.norm((part.target.rig_from_model - turned(turn_deg))[:3, 3]) < 0.05
    return part.target


@pytest.mark.long
def test_a_thick_ring_has_a_free_axis(tmp_path: Path) -> None:
    """No turn of it means anything: it is no reason to refuse it."""
    target = seen(flange(0), tmp_path, 100.0, "round: ")
    assert Reject.NONE == target.reject
    assert target.free_axis is not None


@pytest.mark.long
def test_equal_holes_are_no_reason_to_refuse_a_part_and_one_odd_detail_is(tmp_path: Path) -> None:
    """Of six turns that are one the nearest to the taught is given; a detail that decides must be seen."""
    target = seen(flange(6), tmp_path, 100.0, "the same after each turn of 60°")
    assert Reject.NONE == target.reject
    assert target.free_axis is None
    assert target.rig_from_model is not None
    between = target.rig_from_model[:3, :3].T @ turned(100.0)[:3, :3]
    steps = math.degrees(math.atan2(between[1, 0], between[0, 0])) / 60.0
    assert abs(steps - round(steps)) < 0.003
    mark = Wall("pin", circle(7.5, 0.5, 0.3), 0, False, 0.0, 0.2)
    with pytest.raises(TeachError, match="expected a pair that shows what tells its rotation"):
        seen(flange(6, mark), tmp_path, 100.0, "")
