"""Which of several parts comes first."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from snapshots import make_target, make_transform

from edged.domain import Match, Order, Outcome, Picking, Reject, Status, Target
from edged.robot.picking import picked


def part(
    name: str, score: float, place_mm: tuple[float, float, float], x_px: float, sigma_mm: float
) -> Target:
    """A target whose job's name tells it from the others."""
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
    """Whatever order they were found in; a rejected part is never first."""
    bad = dataclasses.replace(PARTS[2], job="x", reject=Reject.RESIDUAL)
    for found in ((*PARTS, bad), (bad, *PARTS[::-1])):
        outcome = picked(Outcome(Status.OK, found), Picking(order), None)
        assert [*names, "x"] == [target.job for target in outcome.targets]
        assert Status.OK is outcome.status


def test_topmost_is_said_of_the_robots_frame() -> None:
    """Registered with its z along the rig's y, what is far along that is on top."""
    low, high = (part("p", 0.9, (0.0, y_mm, 200.0), 0.0, 0.01) for y_mm in (-5.0, 5.0))
    outcome = picked(Outcome(Status.OK, (low, high)), Picking(Order.TOPMOST), TURNED)
    assert (high, low) == outcome.targets


def test_parts_that_are_equal_stay_in_the_order_of_their_score_and_what_is_no_number_comes_last() -> None:
    """Two of one place; one whose position is not known."""
    twin = dataclasses.replace(PARTS[1], job="t")
    lost = dataclasses.replace(PARTS[0], job="n", rig_from_part=np.full((4, 4), np.nan))
    outcome = picked(Outcome(Status.OK, (lost, PARTS[1], twin)), Picking(Order.NEAREST), None)
    assert ["b", "t", "n"] == [target.job for target in outcome.targets]
