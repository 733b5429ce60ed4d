"""Decisions about a part's rotation need the evidence of both cameras."""

from __future__ import annotations

from functools import cache

import bench_decisions
import numpy as np
import pytest
from helpers.cells import frame_pair, pose

from edged.domain.arrays import Image
from edged.domain.measurement import Reject
from edged.pipeline import locate

LOOK = "plain"


@cache
def taught() -> bench_decisions.Taught:
    """A disc with a bore, four holes and one slot, which without the slot is symmetric by 90 degrees."""
    design = next(one for one in bench_decisions.DESIGNS if one.name == "slot disc")
    return bench_decisions.teach_design(design, LOOK, 1)


def seen(turn_deg: float) -> tuple[Image, Image]:
    """The turned part in both cameras."""
    part = bench_decisions.made(taught().design, LOOK)
    world = bench_decisions.world(LOOK, np.random.default_rng(5), (part, pose(turn_deg=turn_deg)))
    left, right = (view.radiance(world) for view in bench_decisions.views().values())
    rng = np.random.default_rng(6)
    return bench_decisions.exposed(left, 1.0, rng), bench_decisions.exposed(right, 1.0, rng)


def rejects(left: Image, right: Image) -> list[Reject]:
    """The reject reasons of each found part."""
    return [target.reject for target in locate(frame_pair(left, right), taught().job, taught().rig).targets]


@pytest.mark.long
def test_both_cameras_must_show_what_decides() -> None:
    """If the right camera shows the slot elsewhere, the rotation is ambiguous."""
    (left, right), (_, turned) = seen(20.0), seen(110.0)
    assert [Reject.NONE] == rejects(left, right)
    assert [Reject.AMBIGUOUS_ROTATION] == rejects(left, turned)


@pytest.mark.slow
def test_one_camera_decides_where_the_other_sees_nothing() -> None:
    """If half of the right picture is hidden, the left camera decides.

    Noise looks like anything now and then: one draw of eight may be ambiguous.
    """
    middle = round(float(taught().rig.rig.right.project(np.array([[0.0, 0.0, 205.0]]))[0, 1]))
    doubts = 0
    for turn_deg in (20.0, 110.0, 200.0, 290.0):
        left, right = seen(turn_deg)
        noise = np.random.default_rng(round(turn_deg)).normal(128, 60, right.shape)
        for rows in (slice(None, middle), slice(middle, None)):
            covered = right.copy()
            covered[rows] = np.clip(noise, 0, 255).astype(np.uint8)[rows]
            doubts += Reject.AMBIGUOUS_ROTATION in rejects(left, covered)
    assert doubts <= 1


@pytest.mark.long
def test_another_lay_than_the_taught_one_turns_nothing_silently() -> None:
    """A part that was taught ground and is seen milled is never wrong in its rotation."""
    look, name = "ground, seen milled", "keyway"
    index = next(k for k, design in enumerate(bench_decisions.DESIGNS) if design.name == name)
    row = bench_decisions.run_part(index, look, scenes=1, seed=0)
    assert bench_decisions.DRAWS_PER_SCENE == row.draws
    assert [] == row.wrong


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 4])
def test_end_of_a_short_slot_is_taught_as_no_circle(seed: int) -> None:
    """Half a circle that goes on straight is a slot, even if its sides are shorter than its ends."""
    design = next(one for one in bench_decisions.DESIGNS if one.name == "square slots")
    job = bench_decisions.teach_design(design, "milled, seen ground", seed).job
    assert () == job.circles
    assert 4 == len(job.slots)
