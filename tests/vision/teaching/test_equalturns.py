"""Faces that are the same after a turn, taught while they lean."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import frame_pair, pictures, small_rig
from helpers.flatparts import METAL
from helpers.tilted import lying, thin

from edged.domain.measurement import Reject
from edged.pipeline import PreparedRig, locate, prepare
from edged.sim.render.scene import Disc, Hole, Part, PolygonShape, Slot
from edged.vision.geometry.rigid import apply, invert, is_turn_within, turn_about_z
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

CORNERS = ((-13, -9), (13, -9), (13, 9), (-13, 9))
PLACES = ((-8.0, 5.0), (8.0, -5.0), (8.0, 5.0), (-8.0, -5.0))


def plate(odd_mm: float = 0.0) -> Part:
    """A plate with four holes, one of which may be wider."""
    holes = (Hole(f"h{k}", Disc(x, y, 1.8 + (odd_mm if k == 0 else 0.0))) for k, (x, y) in enumerate(PLACES))
    return Part("plate", PolygonShape(CORNERS), METAL, tuple(holes))


def slotted() -> Part:
    """A plate with four slots."""
    holes = (Hole(f"s{k}", Slot(x, y - 1.5, x, y + 1.5, 1.4)) for k, (x, y) in enumerate(PLACES))
    return Part("slotted", PolygonShape(CORNERS), METAL, tuple(holes))


@functools.cache
def prepared() -> PreparedRig:
    """The rig."""
    return prepare(small_rig())


def taught(part: Part) -> Job:
    """The job of a part that leans at teaching."""
    rig = prepared()
    where = lying(rig.rig, 15.0, 30.0, 20.0)
    return teach(*pictures(rig.rig, thin(part, where)), rig.rectification, None, "plate")


@pytest.mark.slow
def test_a_leaning_face_that_is_the_same_after_half_a_turn_is_known_as_such() -> None:
    """Perspective makes its picture another one after the turn; the face is the same."""
    assert [abs(angle) for angle in taught(plate()).shape.equal_motions[:, 2]] == [
        pytest.approx(math.pi, abs=0.02)
    ]
    assert not len(taught(plate(0.3)).shape.equal_motions)


@pytest.mark.long
@pytest.mark.parametrize("part", [plate(), slotted()], ids=["holes", "slots"])
def test_it_is_accepted_where_it_lies(part: Part) -> None:
    """Looked for by all edges, it is accepted after either half turn, where one of them lays it."""
    job, rig = replace(taught(part), tilt_rad=math.radians(30.0)), prepared()
    part_from_job = invert(lying(rig.rig, 15.0, 30.0, 20.0)) @ job.rig_from_part
    for turn_deg in (40.0, 205.0):
        there = lying(rig.rig, 24.0, -50.0, turn_deg)
        (target,) = locate(frame_pair(*pictures(rig.rig, thin(part, there))), job, rig).targets
        assert target.reject is Reject.NONE
        alike = [lying(rig.rig, 24.0, -50.0, turn_deg + half) @ part_from_job for half in (0.0, 180.0)]
        places = [apply(true, job.place_of(job.reference)) for true in alike]
        assert min(float(np.linalg.norm(target.position_mm - place)) for place in places) < 0.03


@pytest.mark.long
@pytest.mark.parametrize("start_deg", [-90.0, 60.0, None])
def test_a_range_of_turns_tells_those_apart_that_nothing_shown_does(start_deg: float | None) -> None:
    """A plate that may differ on its back is in doubt after half a turn, unless its job allows only half.

    It is reported turned within that range, where it lies or turned by half.
    """
    rig, job = prepared(), taught(plate())
    job = replace(
        job,
        tilt_rad=math.radians(30.0),
        # as if a mark told the turns apart at teaching
        shape=replace(job.shape, symmetries=np.zeros((0, 4))),
    )
    start = math.radians(-180.0 if start_deg is None else start_deg)
    extent = math.tau if start_deg is None else math.pi
    job = replace(job, search=replace(job.search, angle_start_rad=start, angle_extent_rad=extent))
    for turn_deg in (40.0, 205.0):
        there = lying(rig.rig, 24.0, -50.0, turn_deg)
        (target,) = locate(frame_pair(*pictures(rig.rig, thin(plate(), there))), job, rig).targets
        assert target.reject is (Reject.AMBIGUOUS_ROTATION if start_deg is None else Reject.NONE)
        if start_deg is not None:
            turn = turn_about_z(job.rig_from_part[:3, :3].T @ target.rig_from_part[:3, :3])
            assert is_turn_within(turn, start, extent, math.radians(1.0))
