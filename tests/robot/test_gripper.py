"""The gripper's body avoids zones and neighbours, and a symmetric part turns it least."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.snapshots import make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from edged.config.reading import limits_of
from edged.domain.arrays import FloatArray
from edged.domain.measurement import Circle3D, Edge3D, Outcome, Reject, Status, Target
from edged.domain.picking import Bounds, Box, Grasp, Gripper, Picking
from edged.robot.gripper import Solid, any_meet, body_of, flange_from_tip
from edged.robot.picking import RobotFrame, picked

ROBOT_FROM_RIG = make_transform((math.pi, 0.0, 0.4), (500.0, 100.0, 900.0))
FINGERS = (
    Box("left", (-30.0, -4.0, -60.0), (-24.0, 4.0, 5.0)),
    Box("right", (24.0, -4.0, -60.0), (30.0, 4.0, 5.0)),
)


def disc(x_mm: float, y_mm: float = 0.0, radius_mm: float = 20.0, turn_rad: float = 0.0) -> Target:
    """A part with one circle and a known rotation."""
    pose = make_transform((0.0, 0.0, turn_rad), (x_mm, y_mm, 400.0))
    circle = Circle3D("c0", pose[:3, 3], -pose[:3, 2], radius_mm, np.eye(4) * 1e-6)
    return replace(make_target(), rig_from_part=pose, circles=(circle,), edges=(), slots=(), corners=())


def picking(gripper: Gripper | None, symmetry: int = 1, keep_out: tuple[Box, ...] = ()) -> Picking:
    """One grasp, straight into the face, taught on a part that was not turned."""
    taught = disc(0.0).rig_from_part
    return Picking(
        bounds=(Bounds((), keep_out, gripper),), grasps=(Grasp("g", np.eye(4), taught, 50.0, 80.0, symmetry),)
    )


def vertices(solid: Solid) -> FloatArray:
    """Its eight corners (8, 3)."""
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    return solid.centre_mm + (signs * solid.half_mm) @ solid.axes.T


def in_common(one: Solid, other: Solid) -> bool:
    """Whether the boxes have a point in common, by linear programming."""
    a, b = vertices(one), vertices(other)
    equal = np.vstack([np.hstack([a.T, -b.T]), [[1] * 8 + [0] * 8], [[0] * 8 + [1] * 8]])
    return bool(linprog(np.zeros(16), A_eq=equal, b_eq=[0, 0, 0, 1, 1], method="highs").status == 0)


boxes = st.builds(
    lambda centre, turn, half: Solid(
        np.array(centre), Rotation.from_rotvec(turn).as_matrix(), np.array(half)
    ),
    st.tuples(*[st.floats(-2, 2)] * 3),
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.tuples(*[st.floats(0, 1.5)] * 3),
)


@pytest.mark.long
@settings(deadline=None, max_examples=150)
@given(boxes, boxes)
def test_two_boxes_meet_where_a_point_lies_in_both(one: Solid, other: Solid) -> None:
    """Two boxes, turned in any way, meet exactly if they have a point in common."""
    grown, shrunk = (
        any_meet([replace(one, half_mm=one.half_mm + by)], [other])
        for by in (1e-6, -np.minimum(1e-6, one.half_mm))
    )
    if grown == shrunk:  # neither just touches the other
        assert in_common(one, other) == any_meet([one], [other])


def test_a_part_is_the_box_around_what_was_measured_of_it() -> None:
    """A part's body is the box around its measured features in its own frame; without features there is
    none."""
    part = disc(40.0, 10.0, 20.0, 0.7)
    edge = Edge3D("e", part.rig_from_part[:3, 3], (part.rig_from_part @ [50.0, 0, 0, 1])[:3], np.eye(2))
    body = body_of(replace(part, edges=(edge,)))
    assert body is not None
    np.testing.assert_allclose([35.0, 20.0, 0.0], body.half_mm, atol=1e-9)
    np.testing.assert_allclose((part.rig_from_part @ [15.0, 0, 0, 1])[:3], body.centre_mm, atol=1e-9)
    np.testing.assert_allclose(part.rig_from_part[:3, :3], body.axes, atol=1e-12)
    assert body_of(replace(part, circles=())) is None


@pytest.mark.long
@pytest.mark.parametrize("turned_deg", [0, 40, 95, -130, 178])
@pytest.mark.parametrize("symmetry", [4, 0])
def test_a_symmetric_part_turns_the_flange_least_from_where_it_is(turned_deg: float, symmetry: int) -> None:
    """A symmetric part turns the flange least from its current pose, not from the taught one."""
    gripper = Gripper((10.0, -5.0, 150.0), (0.1, 0.2, 0.3))
    tip = (
        ROBOT_FROM_RIG
        @ disc(0.0).rig_from_part
        @ make_transform((0, 0, math.radians(turned_deg)), (0, 0, -99))
    )
    flange = tip @ np.linalg.inv(flange_from_tip(gripper))
    outcome = Outcome(Status.OK, (disc(5.0, turn_rad=0.3),))
    frame = RobotFrame(ROBOT_FROM_RIG, robot_from_flange=flange)
    found = picked(outcome, picking(gripper, symmetry), frame).targets[0].grasp
    assert found is not None
    ways = [
        disc(5.0, turn_rad=0.3).rig_from_part @ make_transform((0, 0, turn), (0, 0, 0))
        for turn in np.linspace(0, 2 * math.pi, symmetry or 3600, endpoint=False)
    ]
    turns_deg = [
        math.degrees(Rotation.from_matrix((ROBOT_FROM_RIG @ way)[:3, :3] @ tip[:3, :3].T).magnitude())
        for way in (*ways, found.rig_from_tcp)
    ]
    assert turns_deg[-1] <= min(turns_deg[:-1]) + 1e-6
    taught = picked(outcome, picking(gripper, symmetry), RobotFrame(ROBOT_FROM_RIG)).targets[0].grasp
    assert taught is not None
    assert np.allclose(taught.rig_from_tcp, found.rig_from_tcp) == (
        turned_deg == 0 or (turned_deg == 40 and symmetry == 4)
    )


def test_fingers_keep_clear_of_neighbours_good_and_bad() -> None:
    """If the fingers would hit a neighbour, good or bad, the grasp is turned by a quarter or refused."""
    gripper = Gripper((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), FINGERS)
    alone, beside = disc(0.0), disc(42.0)
    for neighbour in (beside, replace(beside, reject=Reject.RESIDUAL)):
        outcome = Outcome(Status.OK, (alone, neighbour))
        first = next(
            t for t in picked(outcome, picking(gripper), RobotFrame()).targets if t.position_mm[0] == 0
        )
        assert (Reject.NO_GRASP, None) == (first.reject, first.grasp)
        turned = picked(outcome, picking(gripper, symmetry=4), RobotFrame()).targets
        first = next(t for t in turned if t.position_mm[0] == 0)
        assert first.grasp is not None and abs(math.degrees(first.grasp.turn_rad)) == pytest.approx(90)
        free = picked(Outcome(Status.OK, (alone, disc(52.0))), picking(gripper), RobotFrame()).targets
        assert all(target.grasp is not None for target in free)
        blind = picked(outcome, picking(None), RobotFrame()).targets
        assert all(target.grasp is not None for target in blind if not target.reject & Reject.RESIDUAL)


@pytest.mark.parametrize("robot_from_rig", [None, ROBOT_FROM_RIG])
def test_fingers_meet_no_keep_out_zone_on_their_way(robot_from_rig: FloatArray | None) -> None:
    """The fingers must not meet a zone of the robot's frame, neither on the way in nor on the way back."""
    gripper = Gripper((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), FINGERS)
    frame = RobotFrame(robot_from_rig)
    # beside the right finger, and above it: between the grasp and the end of the retreat
    for place_mm, size_mm, is_free in (
        ((28.0, 0.0, 402.0), 1.0, False),
        ((28.0, 0.0, 275.0), 1.0, False),
        ((28.0, 0.0, 240.0), 1.0, True),
        ((36.0, 0.0, 402.0), 1.0, True),
    ):
        place = np.array(place_mm) if robot_from_rig is None else (robot_from_rig @ [*place_mm, 1])[:3]
        low, high = (tuple(float(x) for x in place + by) for by in (-size_mm, size_mm))
        zone = Box("wall", (low[0], low[1], low[2]), (high[0], high[1], high[2]))
        outcome = picked(Outcome(Status.OK, (disc(0.0),)), picking(gripper, keep_out=(zone,)), frame)
        assert is_free == (outcome.targets[0].grasp is not None), place_mm


def test_the_tip_is_read_as_a_robot_states_its_tool() -> None:
    """The tip is read in millimetres, and degrees about fixed x, y, z."""
    text = b"""[limits.gripper]
tip_mm = [1.0, 2.0, 150.0]
tip_deg = [10.0, 20.0, 30.0]
[[limits.gripper.box]]
name = "palm"
min_mm = [-1.0, -2.0, -30.0]
max_mm = [1.0, 2.0, -3.0]
"""
    gripper = limits_of(text).bounds().gripper
    assert gripper is not None
    assert (Box("palm", (-1.0, -2.0, -30.0), (1.0, 2.0, -3.0)),) == gripper.boxes
    pose = flange_from_tip(gripper)
    np.testing.assert_allclose([1.0, 2.0, 150.0], pose[:3, 3])
    expected = Rotation.from_euler("xyz", [10.0, 20.0, 30.0], degrees=True).as_matrix()
    np.testing.assert_allclose(expected, pose[:3, :3], atol=1e-12)
    assert limits_of(b"").bounds().gripper is None
