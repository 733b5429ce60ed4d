"""Where a tool takes a part."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers.snapshots import make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.domain.picking import Bounds, Box, Grasp, GraspPose, Picking
from edged.robot.grasping import allowed_grasps, alternatives, lever_covariance
from edged.robot.picking import RobotFrame, picked

TAUGHT = make_transform((0.0, 0.0, 0.0), (0.0, 0.0, 200.0))
RIG = RobotFrame()


def lying(
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0), place_mm: tuple[float, float, float] = (0, 0, 200)
) -> Target:
    """A part at a place, with a full covariance."""
    return dataclasses.replace(make_target(), rig_from_part=make_transform(turn_rad, place_mm))


def grasp(
    part_from_tcp: FloatArray | None = None, symmetry: int = 1, name: str = "g", approach_mm: float = 50.0
) -> Grasp:
    """A grasp of a job that was taught at TAUGHT."""
    tool = np.eye(4) if part_from_tcp is None else part_from_tcp
    return Grasp(name, tool, TAUGHT @ tool, approach_mm, 80.0, symmetry)


def turned_deg(pose: FloatArray, taught: Grasp) -> float:
    """The angle between the tool and its taught pose."""
    return math.degrees(Rotation.from_matrix(pose[:3, :3] @ taught.rig_from_tcp[:3, :3].T).magnitude())


def only(target: Target, taught: Grasp) -> GraspPose:
    """The best alternative if everything is allowed."""
    return allowed_grasps(target, [taught], lambda _pose: True)[0]


def test_the_tool_stands_where_it_was_taught_in_the_part() -> None:
    """The tool's pose is rig_from_part part_from_tcp; approach and retreat lie behind it along its z."""
    tool = make_transform((0.3, -0.2, 0.1), (10.0, -5.0, 3.0))
    target = lying((0.1, 0.2, 0.3), (4.0, 5.0, 210.0))
    found = only(target, grasp(tool))
    np.testing.assert_allclose(found.rig_from_tcp, target.rig_from_part @ tool, atol=1e-12)
    for pose, distance_mm in ((found.rig_from_approach, 50.0), (found.rig_from_retreat, 80.0)):
        np.testing.assert_allclose(
            pose, found.rig_from_tcp @ make_transform((0, 0, 0), (0, 0, -distance_mm)), atol=1e-12
        )
    assert (1, "g", 0.0) == (found.number, found.name, found.turn_rad)


@pytest.mark.parametrize(
    ("part_deg", "turn_deg"), [(0, 0), (44, 0), (95, -90), (-100, 90), (178, 180), (46, -90)]
)
def test_of_symmetric_ways_the_one_is_taken_that_turns_the_tool_least(
    part_deg: float, turn_deg: float
) -> None:
    """Of symmetric poses the one with the least turn comes first, so a square part turned by 95° is taken
    as by 5°."""
    taught = grasp(make_transform((0, 0, 0.7), (20.0, 0.0, 0.0)), symmetry=4)
    target = lying((0, 0, math.radians(part_deg)))
    ways = list(alternatives(target, taught, 1))
    assert abs(turn_deg) == pytest.approx(abs(math.degrees(ways[0].turn_rad)), abs=1e-9)
    left_deg = abs((part_deg + turn_deg + 180) % 360 - 180)
    assert left_deg == pytest.approx(turned_deg(ways[0].rig_from_tcp, taught), abs=1e-6)
    angles = [turned_deg(way.rig_from_tcp, taught) for way in ways]
    assert 4 == len(ways) and sorted(angles) == pytest.approx(angles, abs=1e-6)
    places = np.array(
        [target.rig_from_part[:3, :3].T @ (w.rig_from_tcp[:3, 3] - target.position_mm) for w in ways]
    )
    np.testing.assert_allclose(np.linalg.norm(places[:, :2], axis=1), 20.0, atol=1e-9)


UNIT = st.floats(-3, 3, allow_subnormal=False)


@given(st.tuples(UNIT, UNIT, UNIT), st.tuples(UNIT, UNIT, UNIT), st.floats(-math.pi, math.pi))
@settings(max_examples=80, derandomize=True)
def test_a_disc_is_taken_with_the_least_turn_of_all(
    part: tuple[float, float, float], tool: tuple[float, float, float], other_rad: float
) -> None:
    """With symmetry 0 no rotation about the part's z turns the tool less; eight are offered."""
    taught = grasp(make_transform(tool, (5.0, 0.0, 0.0)), symmetry=0)
    target = lying(part)
    way, *others = alternatives(target, taught, 1)
    eighths = {round((other.turn_rad - way.turn_rad) / (math.pi / 4)) % 8 for other in others}
    assert {*range(1, 8)} == eighths
    other = target.rig_from_part @ make_transform((0, 0, other_rad), (0, 0, 0)) @ taught.part_from_tcp
    assert turned_deg(way.rig_from_tcp, taught) <= turned_deg(other, taught) + 1e-4


def test_a_part_whose_rotation_is_not_known_is_taken_as_a_disc() -> None:
    """For a part with an unknown rotation the tool does not turn with it."""
    axis = np.array([0.0, 0.0, 1.0])
    target = dataclasses.replace(lying((0, 0, 2.0)), free_axis=axis)
    assert turned_deg(only(target, grasp()).rig_from_tcp, grasp()) == pytest.approx(0.0, abs=1e-6)
    assert turned_deg(only(lying((0, 0, 2.0)), grasp()).rig_from_tcp, grasp()) > 100


def test_the_sigma_of_the_tool_is_what_sampling_gives() -> None:
    """20,000 small motions of the part move and turn the tool as the stated covariance says (3 %)."""
    tool = make_transform((0.3, -0.2, 0.1), (40.0, -25.0, 10.0))
    factor = np.tril(np.arange(1.0, 37.0).reshape(6, 6)) * 1e-4
    target = dataclasses.replace(lying((0.1, 0.2, 0.3)), covariance=factor @ factor.T)
    found = only(target, grasp(tool))
    draws = np.random.default_rng(1).standard_normal((20_000, 6)) @ factor.T
    turns = Rotation.from_rotvec(draws[:, 3:])
    arm = found.rig_from_tcp[:3, 3] - target.position_mm
    tips = draws[:, :3] + turns.apply(arm) - arm
    sampled = np.cov(np.hstack([tips, draws[:, 3:]]).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    np.testing.assert_allclose(found.covariance / scale, sampled / scale, atol=0.03)
    assert np.linalg.norm(found.covariance[:3, :3]) > 2 * np.linalg.norm(target.covariance[:3, :3])


def test_what_nobody_knows_about_a_disc_moves_no_tool() -> None:
    """An error of a disc's rotation about its axis adds nothing to the tip; one across it does."""
    target, tip = lying(), TAUGHT @ make_transform((0, 0, 0), (30.0, 0.0, 0.0))
    covariance = np.diag([0, 0, 0, 0, 1e-6, 1.0])
    found = lever_covariance(dataclasses.replace(target, covariance=covariance), tip, is_any=True)
    np.testing.assert_allclose(np.diag(found), [0, 0, 900e-6, 0, 1e-6, 0], atol=1e-12)


BIN = Box("bin", (-100.0, -100.0, 150.0), (100.0, 100.0, 260.0))
POST = Box("post", (25.0, -5.0, 140.0), (35.0, 5.0, 160.0))


def judged(grasps: tuple[Grasp, ...], bounds: Bounds, frame: RobotFrame = RIG) -> tuple[Reject, str]:
    """The rejection of a part at TAUGHT, and its grasp."""
    outcome = picked(Outcome(Status.OK, (lying(),)), Picking(bounds=(bounds,), grasps=grasps), frame)
    (target,) = outcome.targets
    assert (outcome.status is Status.OK) == (target.reject is Reject.NONE)
    return target.reject, "" if target.grasp is None else target.grasp.name


def test_the_first_grasp_that_is_allowed_is_given() -> None:
    """The first allowed grasp in the job's order is given; without one the part is rejected with NO_GRASP."""
    far, near = (
        grasp(make_transform((0, 0, 0), (x, 0, 0)), name=name) for x, name in ((150.0, "far"), (30.0, "near"))
    )
    assert (Reject.NONE, "far") == judged((far, near), Bounds())
    assert (Reject.NONE, "near") == judged((far, near), Bounds((BIN,)))
    assert (Reject.NO_GRASP, "") == judged((far,), Bounds((BIN,)))
    assert (Reject.NONE, "") == judged((), Bounds((BIN,)))
    other = grasp(make_transform((0, 0, 0), (150.0, 0, 0)), symmetry=2, name="other")
    box = Box("left", (-200.0, -1.0, 199.0), (1.0, 1.0, 201.0))
    assert (Reject.NONE, "other") == judged((other,), Bounds((box,)))


def test_the_tool_meets_no_keep_out_zone_on_its_way() -> None:
    """A tool whose way from the approach to the part crosses a keep-out zone is not allowed."""
    straight = grasp(make_transform((0, 0, 0), (30.0, 0, 0)), name="straight")
    beside = grasp(make_transform((0, 0, 0), (-30.0, 0, 0)), name="beside")
    assert (Reject.NO_GRASP, "") == judged((straight,), Bounds((), (POST,)))
    assert (Reject.NONE, "beside") == judged((straight, beside), Bounds((), (POST,)))
    short = dataclasses.replace(straight, approach_mm=20.0, retreat_mm=20.0)
    assert (Reject.NONE, "straight") == judged((short,), Bounds((), (POST,)))
    back = dataclasses.replace(straight, approach_mm=20.0)
    assert (Reject.NO_GRASP, "") == judged((back,), Bounds((), (POST,)))
    slanted = grasp(make_transform((0, -0.5, 0), (30.0, 0, 0)), name="slanted")
    assert (Reject.NONE, "slanted") == judged((slanted,), Bounds((), (POST,)))


def test_the_tool_is_judged_in_the_robots_frame() -> None:
    """The tool is checked in the robot's frame."""
    robot_from_rig = make_transform((np.pi, 0, 0), (0.0, 0.0, 500.0))
    box = Box("bin", (-100.0, -100.0, 250.0), (100.0, 100.0, 320.0))
    assert (Reject.NONE, "g") == judged((grasp(),), Bounds((box,)), RobotFrame(robot_from_rig))
    deep = grasp(make_transform((0, 0, 0), (0, 0, 60.0)))
    assert (Reject.NO_GRASP, "") == judged((deep,), Bounds((box,)), RobotFrame(robot_from_rig))


def test_a_bad_part_has_no_grasp_and_one_that_is_no_number_is_refused() -> None:
    """A bad part has no grasp, and one with NaN is rejected."""
    bad = dataclasses.replace(lying(), reject=Reject.RESIDUAL)
    lost = dataclasses.replace(lying(), covariance=np.full((6, 6), np.nan))
    for target, reject in ((bad, Reject.RESIDUAL), (lost, Reject.NO_GRASP)):
        outcome = picked(Outcome(Status.OK, (target,)), Picking(grasps=(grasp(),)), RIG)
        assert (reject, None) == (outcome.targets[0].reject, outcome.targets[0].grasp)
