"""What a robot may pick, and which of several parts comes first."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.snapshots import make_target, make_transform

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Match, Outcome, Reject, Status, Target
from edged.domain.picking import Bounds, Box, Order, Picking
from edged.robot.picking import RobotFrame, narrowed, picked, within


def part(
    name: str, score: float, place_mm: tuple[float, float, float], x_px: float, sigma_mm: float
) -> Target:
    """A target that is recognised by its job's name."""
    return dataclasses.replace(
        make_target(),
        job=name,
        match=Match(x_px, 0.0, 0.0, 1.0, 1.0, score),
        rig_from_part=make_transform((0.0, 0.0, 0.0), place_mm),
        covariance=np.eye(6) * sigma_mm**2,
    )


PARTS = (
    part("a", 0.9, (50.0, 0.0, 200.0), 700.0, 0.03),
    part("b", 0.8, (0.0, 0.0, 205.0), 600.0, 0.02),
    part("c", 0.7, (-90.0, 0.0, 190.0), 100.0, 0.01),
)
RIG = RobotFrame()
TURNED = make_transform((np.pi / 2, 0.0, 0.0), (0.0, 0.0, 0.0))  # the robot's z is the rig's y


@pytest.mark.parametrize(
    ("order", "names"),
    [
        (Order.SCORE, "abc"),
        (Order.NEAREST, "bac"),
        (Order.TOPMOST, "cab"),
        (Order.LEFTMOST, "cba"),
        (Order.LEAST_SIGMA, "cba"),
    ],
)
def test_good_parts_come_in_the_order_asked_for_and_bad_ones_behind(order: Order, names: str) -> None:
    """Good parts come in the asked order and bad ones behind, whatever order they were found in."""
    bad = dataclasses.replace(PARTS[2], job="x", reject=Reject.RESIDUAL)
    for found in ((*PARTS, bad), (bad, *PARTS[::-1])):
        outcome = picked(Outcome(Status.OK, found), Picking(order), RIG)
        assert [*names, "x"] == [target.job for target in outcome.targets]
        assert Status.OK is outcome.status


def test_topmost_is_said_of_the_robots_frame() -> None:
    """Topmost is decided in the robot's frame."""
    low, high = (part("p", 0.9, (0.0, y_mm, 200.0), 0.0, 0.01) for y_mm in (-5.0, 5.0))
    outcome = picked(Outcome(Status.OK, (low, high)), Picking(Order.TOPMOST), RobotFrame(TURNED))
    assert (high, low) == outcome.targets


def test_parts_that_are_equal_stay_in_the_order_of_their_score_and_what_is_no_number_comes_last() -> None:
    """Equal parts stay in the order of their score, and a part with NaN comes last."""
    twin = dataclasses.replace(PARTS[1], job="t")
    lost = dataclasses.replace(PARTS[0], job="n", rig_from_part=np.full((4, 4), np.nan))
    outcome = picked(Outcome(Status.OK, (lost, PARTS[1], twin)), Picking(Order.NEAREST), RIG)
    assert ["b", "t", "n"] == [target.job for target in outcome.targets]


@pytest.mark.parametrize("robot_from_rig", [None, TURNED])
def test_a_part_that_could_not_be_picked_comes_behind_the_other_good_ones(
    robot_from_rig: FloatArray | None,
) -> None:
    """A part that could not be picked comes behind the other good ones, also if it was moved a little;
    alone it is given."""
    frame = RobotFrame(robot_from_rig)
    turn = np.eye(4) if robot_from_rig is None else robot_from_rig
    bad = dataclasses.replace(PARTS[2], job="x", reject=Reject.RESIDUAL)
    for shift_mm, names in ((0.0, "bcax"), (29.0, "bcax"), (31.0, "abcx"), (-31.0, "acbx")):
        x, y, z = (float(one) for one in (turn @ [50.0 + shift_mm, 0.0, 200.0, 1.0])[:3])
        rules = Picking(Order.SCORE, skipped_mm=(x, y, z))
        outcome = picked(Outcome(Status.OK, (*PARTS, bad)), rules, frame)
        assert (Status.OK, [*names]) == (outcome.status, [target.job for target in outcome.targets])
        alone = picked(Outcome(Status.OK, PARTS[:1]), rules, frame)
        assert (Status.OK, ["a"]) == (alone.status, [target.job for target in alone.targets])
    assert ["x"] == [t.job for t in picked(Outcome(Status.LOW_QUALITY, (bad,)), rules, frame).targets]


# --- limits --------------------------------------------------------------------------------------

BIN = Box("bin", (-100.0, -50.0, 100.0), (100.0, 50.0, 300.0))
CLAMP = Box("clamp", (-20.0, -20.0, 100.0), (20.0, 20.0, 300.0))
FAR = Box("far", (900.0, 900.0, 900.0), (999.0, 999.0, 999.0))


def at(x_mm: float, y_mm: float = 0.0, z_mm: float = 200.0, reject: Reject = Reject.NONE) -> Target:
    """A part at a place of the rig's frame."""
    return dataclasses.replace(part("p", 0.9, (x_mm, y_mm, z_mm), 0.0, 0.01), reject=reject)


def judged(target: Target, bounds: tuple[Bounds, ...], frame: RobotFrame = RIG) -> tuple[Status, Reject]:
    """The status with this part alone, and its rejection."""
    outcome = picked(Outcome(Status.OK, (target,)), Picking(bounds=bounds), frame)
    return outcome.status, outcome.targets[0].reject


@pytest.mark.parametrize(
    ("x_mm", "reject"),
    [
        (50.0, Reject.NONE),
        (100.0, Reject.NONE),
        (100.001, Reject.OUT_OF_LIMITS),
        (-20.0, Reject.KEEP_OUT),
        (-20.001, Reject.NONE),
        (0.0, Reject.KEEP_OUT),
    ],
)
def test_a_part_is_good_within_a_box_and_outside_of_every_keep_out_zone(x_mm: float, reject: Reject) -> None:
    """A part is good within one of the boxes and outside of all keep-out zones, to the micrometre."""
    expected = (Status.LOW_QUALITY if reject else Status.OK, reject)
    assert expected == judged(at(x_mm), (Bounds((BIN,), (CLAMP,)),))
    assert expected == judged(at(x_mm), (Bounds((FAR, BIN), (FAR, CLAMP)),))


def test_cell_and_job_must_both_allow_it() -> None:
    """Both cell and job must allow a part."""
    job = Picking(bounds=(Bounds((BIN,)),))
    for cell, status in (
        (Bounds(), Status.OK),
        (Bounds((BIN,)), Status.OK),
        (Bounds((FAR,)), Status.LOW_QUALITY),
    ):
        assert status is picked(Outcome(Status.OK, (at(50.0),)), within(job, cell), RIG).status
    cell = within(Picking(bounds=(Bounds((FAR,)),)), Bounds((BIN,)))
    assert Status.LOW_QUALITY is picked(Outcome(Status.OK, (at(50.0),)), cell, RIG).status


def test_of_several_boxes_one_alone_may_count() -> None:
    """A box can be chosen by its number from 1; a number without a box allows nothing, and keep-out zones
    apply."""
    two = Bounds((BIN, FAR), (CLAMP,))
    seen = [judged(at(x_mm), (narrowed(two, box),))[1] for box in (0, 1, 2, 3) for x_mm in (50.0, 0.0)]
    none, out, kept = Reject.NONE, Reject.OUT_OF_LIMITS, Reject.KEEP_OUT
    assert [none, kept, none, kept, out, out | kept, out, out | kept] == seen


def test_boxes_lie_in_the_robots_frame() -> None:
    """Boxes are in the robot's frame."""
    tower = (Bounds((Box("tower", (-1.0, -999.0, 40.0), (1.0, 999.0, 60.0)),)),)
    assert (Status.OK, Reject.NONE) == judged(at(0.0, 50.0), tower, RobotFrame(TURNED))
    assert (Status.LOW_QUALITY, Reject.OUT_OF_LIMITS) == judged(at(0.0, -50.0), tower, RobotFrame(TURNED))
    assert (Status.LOW_QUALITY, Reject.OUT_OF_LIMITS) == judged(at(0.0, 50.0), tower)


def test_where_the_robots_frame_is_not_known_nothing_is_allowed() -> None:
    """With limits but an unknown robot frame nothing is allowed."""
    unknown = RobotFrame(None, is_known=False)
    for bounds in (Bounds((BIN,)), Bounds((), (FAR,))):
        assert (Status.LOW_QUALITY, Reject.OUT_OF_LIMITS) == judged(at(50.0), (bounds,), unknown)
    assert (Status.OK, Reject.NONE) == judged(at(50.0), (), unknown)


def test_what_is_forbidden_gives_way_to_what_is_allowed_and_keeps_its_other_reasons() -> None:
    """An allowed part comes before a better one outside; a bad part outside gets a further reason."""
    outside, inside = at(150.0), dataclasses.replace(at(50.0), match=Match(0, 0, 0, 1, 1, 0.5))
    outcome = picked(Outcome(Status.OK, (outside, inside)), Picking(bounds=(Bounds((BIN,)),)), RIG)
    assert (Status.OK, [Reject.NONE, Reject.OUT_OF_LIMITS]) == (
        outcome.status,
        [target.reject for target in outcome.targets],
    )
    bad = Outcome(Status.LOW_QUALITY, (at(150.0, reject=Reject.RESIDUAL),))
    outcome = picked(bad, Picking(bounds=(Bounds((BIN,)),)), RIG)
    assert (Status.LOW_QUALITY, Reject.RESIDUAL | Reject.OUT_OF_LIMITS) == (
        outcome.status,
        outcome.targets[0].reject,
    )
    nothing = picked(Outcome(Status.NO_TARGET), Picking(bounds=(Bounds((BIN,)),)), RIG)
    assert (Status.NO_TARGET, ()) == (nothing.status, nothing.targets)


def test_a_place_that_is_no_number_is_in_no_box() -> None:
    """A part at NaN is in no box, and is not allowed beside a keep-out zone."""
    lost = dataclasses.replace(at(0.0), rig_from_part=np.full((4, 4), np.nan))
    for bounds in (Bounds((BIN,)), Bounds((), (CLAMP,))):
        assert (Status.LOW_QUALITY, Reject.OUT_OF_LIMITS) == judged(lost, (bounds,))
