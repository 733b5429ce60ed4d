"""Both edges of broken rims, found in the teaching pair: drawn, with known truth."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import frame_pair
from helpers.drawnparts import pair, place, rig
from solids import random_design
from solidtruth import part_json

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject
from edged.files.jobs import load_job, save_job
from edged.pipeline import locate
from edged.setup.teaching.proposal import WantedJob, propose_from_pair
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import Job
from edged.vision.teaching.furtherpairs import with_breaks_shown
from edged.vision.teaching.pair import teach
from edged.vision.teaching.reteaching import carry_over

BROKEN = {4: 0.394, 207: 0.191, 216: 0.493}
"""Designs whose breaks all have one width: chamfers that each camera sees in another light."""
SHARP = (1, 5, 6, 10)


@functools.cache
def taught(design: int) -> Job:
    """A part taught from one pair, by single edges."""
    return teach(*pair(design), rig().rectification, None, "part")


@functools.cache
def settled(design: int) -> tuple[Job, tuple[str, ...]]:
    """The same part by both edges of its breaks, if the pair shows them."""
    return with_breaks_shown(taught(design), pair(design), (), rig().rectification)


def upper_circles(design: int) -> list[tuple[FloatArray, float]]:
    """The true centres (3,) in the rig's frame, and radii, of all edges in faces."""
    truth = part_json(random_design(design), place(0.0), 0.0, rig().rig)
    circles = [circle for circle in truth["circles"] if circle.get("role") == "break_face"]
    return [(np.array(circle["centre_left_mm"]), circle["radius_mm"]) for circle in circles]


@pytest.mark.long
@pytest.mark.parametrize("design", BROKEN)
def test_both_edges_of_each_break_are_found(design: int) -> None:
    """The break width is found to 0.03 mm, and most circles at the upper edges, to 0.03 mm."""
    job, said = settled(design)
    assert job.break_end == "face"
    assert job.break_mm == pytest.approx(BROKEN[design], abs=0.03)
    assert said == (f"edge breaks of {job.break_mm:.2f} mm: both edges of each were found, by this pair",)
    away = [
        min(
            np.abs(apply(job.rig_from_part, circle.centre_mm) - true).max() + abs(circle.radius_mm - radius)
            for true, radius in upper_circles(design)
        )
        for circle in job.circles
    ]
    assert sum(apart < 0.03 for apart in away) > 0.5 * len(away) or not away


@pytest.mark.long
@pytest.mark.parametrize("design", SHARP)
def test_walls_beside_sharp_edges_are_no_breaks(design: int) -> None:
    """For a part with sharp edges the job stays as it was."""
    job, said = settled(design)
    assert job is taught(design)
    assert said == ()


@pytest.mark.long
def test_a_part_whose_breaks_were_shown_is_measured_by_both_edges(tmp_path: Path) -> None:
    """At 25 degrees the part is measured by its saved job to 0.05 mm."""
    design = 216
    proposal = propose_from_pair(*pair(design), rig().rectification, WantedJob("part", 1, tilt_deg=45.0))
    save_job(tmp_path / "part", proposal.job)
    job = load_job(tmp_path / "part")
    assert (job.break_mm, job.break_end) == (proposal.job.break_mm, "face")
    outcome = locate(frame_pair(*pair(design, 25.0)), job, rig())
    target = min(outcome.targets, key=lambda one: one.reject.value)
    assert target.reject is Reject.NONE
    true = place(25.0) @ invert(place(0.0)) @ job.rig_from_part
    assert np.linalg.norm(target.position_mm - apply(true, job.place_of(job.reference))) < 0.05


@pytest.mark.slow
def test_such_a_part_is_measured_by_both_edges_whatever_tilt_it_may_have() -> None:
    """Without a tilt in the job the part is measured by both edges, too: right to 0.02 mm."""
    job = replace(settled(4)[0], tilt_rad=None)
    assert not job.solid
    target = locate(frame_pair(*pair(4)), job, rig()).targets[0]
    assert target.reject is Reject.NONE
    taught_mm = apply(job.rig_from_part, job.place_of(job.reference))
    assert np.linalg.norm(target.position_mm - taught_mm) < 0.02


@pytest.mark.slow
def test_taught_again_nothing_counts_as_edited() -> None:
    """No size counts as known or edited, because the light decides which edge of a break is measured."""
    job, _ = settled(216)
    assert job.witness is None
    again, said = carry_over(job, job)
    assert not any("measurement" in line or "radius" in line for line in said)
    assert again.measurements == job.measurements
