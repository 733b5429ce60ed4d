"""Teaching again keeps what people edited, and names what it cannot keep."""

from __future__ import annotations

from dataclasses import replace

import pytest
from helpers import cells

from edged.vision.geometry.rectification import make_rectification
from edged.vision.part.job import Job, MeasurementSpec
from edged.vision.teaching.pair import teach
from edged.vision.teaching.reteaching import carry_over


def taught(seed: int) -> Job:
    """The flange, taught from one of several noisy pairs at slightly different distances."""
    part = cells.flange()
    where = cells.pose((8.0, 0.0, 205.0 + 0.5 * seed))
    left, right = cells.pictures(part.rig, cells.scene((part.part, where)), seed)
    return teach(left, right, make_rectification(part.rig), None, "flange")


@pytest.fixture(scope="module")
def before() -> Job:
    """The first job."""
    return taught(1)


@pytest.fixture(scope="module")
def after() -> Job:
    """The job taught again."""
    return taught(2)


@pytest.mark.long
def test_an_unedited_job_is_replaced_without_a_word(before: Job, after: Job) -> None:
    """Without edits the new job replaces the old one, and no line is said."""
    job, said = carry_over(before, after)
    assert () == said
    assert (after.limits, after.search, after.measurements) == (job.limits, job.search, job.measurements)


@pytest.mark.long
def test_edits_stay(before: Job, after: Job) -> None:
    """Limits, search parameters and a stated size with its tolerance stay, and each is listed."""
    bolts = MeasurementSpec("bolts", "distance", ("c2", "c4"), 19.4, 0.05)
    radius = replace(before.measurements[0], nominal=14.0, tolerance=0.02)
    edited = replace(
        before,
        limits=replace(before.limits, max_sigma_mm=0.05, radius_tolerance_mm=0.2, depth_mm=(150.0, 260.0)),
        search=replace(before.search, min_score=0.75, max_matches=1),
        measurements=(radius, bolts),
    )
    job, said = carry_over(edited, after)

    assert edited.limits == job.limits
    assert edited.search == job.search
    assert (radius, bolts) == job.measurements
    assert after.circles == job.circles
    text = "\n".join(said)
    for words in (
        "limits.max_sigma_mm = 0.05 (teaching would set 0.2)",
        "search.min_score",
        "measurement bolts",
    ):
        assert words in text


@pytest.mark.long
def test_what_cannot_stay_is_said(before: Job, after: Job) -> None:
    """A measurement of a missing feature and a feature's own name are lost, and listed."""
    lost = MeasurementSpec("slot", "distance", ("bore", "c0"), 1.0, 0.1)
    renamed = tuple(replace(c, name="bore") if c.name == "c1" else c for c in before.circles)
    _, said = carry_over(replace(before, circles=renamed, measurements=(lost,), witness=None), after)

    assert any("measurement slot is dropped" in line for line in said)
    assert any("renamed by hand before: bore" in line for line in said)
