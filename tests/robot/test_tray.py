"""Trays and pallets: the pocket of a part, the order of pockets, and parts in none."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from helpers.snapshots import make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.domain.picking import Bounds, Box, Grasp, Gripper, Order, Picking, Tray
from edged.robot.picking import RobotFrame, picked
from edged.robot.tray import centres_mm, pocket_of, step_mm

ROBOT_FROM_RIG = make_transform((math.pi, 0.0, 0.4), (500.0, 100.0, 900.0))
TRAY = Tray(
    (400.0, 50.0, 700.0), ((560.0, 50.0, 700.0), (400.0, 140.0, 700.0), (400.0, 50.0, 700.0)), (5, 4, 1), 12.0
)


def lying_at(robot_mm: np.ndarray, name: str = "p") -> Target:
    """A part at a place of the robot's frame."""
    place = np.linalg.inv(ROBOT_FROM_RIG) @ [*robot_mm, 1.0]
    pose = make_transform((0.0, 0.0, 0.0), tuple(place[:3]))
    return dataclasses.replace(make_target(), job=name, rig_from_part=pose)


def test_pockets_are_numbered_along_the_row_then_the_rows_then_the_layers() -> None:
    """In a tray of 5 by 4 pockets 2 is beside 1 in its row, 6 begins the next row, and 20 is the opposite
    corner; layers follow.
    """
    for number, place_mm in (
        (1, (400, 50, 700)),
        (2, (440, 50, 700)),
        (6, (400, 80, 700)),
        (20, (560, 140, 700)),
    ):
        np.testing.assert_allclose(centres_mm(TRAY)[number - 1], place_mm, atol=1e-9)
    layered = Tray((0.0, 0.0, 0.0), ((10.0, 0, 0), (0.0, 30.0, 0), (0, 0, -60.0)), (2, 3, 2), 4.0)
    assert [0.0, 0.0, -60.0] == centres_mm(layered)[6].tolist()
    assert (20, 12, 30.0, 10.0) == (TRAY.pockets, layered.pockets, step_mm(TRAY), step_mm(layered))


COUNT = st.integers(1, 4)
AWAY = st.floats(-1.0, 1.0)


@given(COUNT, COUNT, COUNT, st.data(), st.tuples(AWAY, AWAY, AWAY), st.booleans())
@settings(max_examples=200, derandomize=True)
def test_a_part_is_in_the_pocket_whose_middle_it_is_near_and_else_in_none(
    columns: int, rows: int, layers: int, data: st.DataObject, away: tuple[float, float, float], is_near: bool
) -> None:
    """For any pose of the tray a part within the tolerance of a pocket is in it, beyond it in none."""
    first, steps = (
        np.array([300.0, -20.0, 80.0]),
        np.array([[30.0, 9.0, 1.0], [-8.0, 41.0, 0.0], [2.0, 0.0, 35.0]]),
    )
    counts = (columns, rows, layers)
    ends = [tuple((first + (count - 1) * step).tolist()) for count, step in zip(counts, steps, strict=True)]
    tray = Tray(tuple(first.tolist()), (ends[0], ends[1], ends[2]), counts, 14.0)
    at = [data.draw(st.integers(0, count - 1)) for count in counts]
    direction = np.array(away)
    length = float(np.linalg.norm(direction))
    unit = direction / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    place_mm = first + np.array(at) @ steps + unit * (13.99 if is_near else 14.01)
    expected = at[0] + columns * (at[1] + rows * at[2]) + 1
    assert (expected if is_near else 0) == pocket_of(tray, place_mm)


def test_parts_come_in_the_order_of_their_pockets_and_what_lies_in_none_is_refused() -> None:
    """Parts come in the order of their pockets; a part between two pockets, or with an unknown frame, is
    OUT_OF_LIMITS."""
    centres = centres_mm(TRAY)
    places = [centres[13], centres[2] + [0, 11.0, 0], centres[7], (centres[0] + centres[1]) / 2]
    targets = tuple(lying_at(place, name) for place, name in zip(places, "abcd", strict=True))
    rules = Picking(Order.POCKET, tray=TRAY)
    outcome = picked(Outcome(Status.OK, targets), rules, RobotFrame(ROBOT_FROM_RIG))
    assert [("b", 3), ("c", 8), ("a", 14), ("d", 0)] == [(t.job, t.pocket) for t in outcome.targets]
    assert [Reject.NONE] * 3 + [Reject.OUT_OF_LIMITS] == [t.reject for t in outcome.targets]
    assert (Status.OK, 20) == (outcome.status, outcome.pockets)
    empty = picked(Outcome(Status.NO_TARGET), rules, RobotFrame(ROBOT_FROM_RIG))
    assert (Status.NO_TARGET, 20) == (empty.status, empty.pockets)
    unknown = picked(Outcome(Status.OK, targets), rules, RobotFrame(None, is_known=False))
    assert {(0, Reject.OUT_OF_LIMITS)} == {(t.pocket, t.reject) for t in unknown.targets}
    assert 0 == picked(Outcome(Status.OK, targets), Picking(), RobotFrame(ROBOT_FROM_RIG)).pockets


def test_a_part_in_a_pocket_is_no_neighbour_of_itself() -> None:
    """A part in a pocket is not treated as its own neighbour."""
    target = lying_at(centres_mm(TRAY)[0])
    gripper = Gripper((0, 0, 0), (0, 0, 0), (Box("palm", (-500, -500, -500), (500, 500, 0.0)),))
    grasp = Grasp("g", np.eye(4), target.rig_from_part, 10.0, 10.0)
    rules = Picking(bounds=(Bounds(gripper=gripper),), grasps=(grasp,), tray=TRAY)
    (found,) = picked(Outcome(Status.OK, (target,)), rules, RobotFrame(ROBOT_FROM_RIG)).targets
    assert (1, Reject.NONE) == (found.pocket, found.reject)
