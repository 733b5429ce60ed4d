"""A region that cuts the part is named; the whole picture teaches as well as a region."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import cells

from edged.vision.geometry.rectification import Rectification, make_rectification
from edged.vision.teaching.cuts import Cut, cut_edges
from edged.vision.teaching.pair import taught_mask, teach
from edged.vision.teaching.region import Region


@pytest.fixture(scope="module")
def flat() -> cells.Flange:
    """The demo's flange."""
    return cells.flange()


@pytest.fixture(scope="module")
def rectification(flat: cells.Flange) -> Rectification:
    """The rectification of its rig."""
    return make_rectification(flat.rig)


def cuts_of(flat: cells.Flange, rectification: Rectification, region: Region | None) -> tuple[Cut, ...]:
    """The cuts of the job that a region teaches."""
    job = teach(flat.left, flat.right, rectification, region, "x")
    mask = taught_mask(region, (), rectification)
    return cut_edges(job, rectification.left_image(flat.left), mask, rectification)


@pytest.mark.slow
def test_the_whole_picture_teaches_as_well(flat: cells.Flange, rectification: Rectification) -> None:
    """Without a region the same circles are taught, to a micrometre, and nothing is cut."""
    one, two = (teach(flat.left, flat.right, rectification, each, "x") for each in (flat.region, None))

    assert [circle.radius_mm for circle in one.circles] == pytest.approx(
        [circle.radius_mm for circle in two.circles], abs=1e-3
    )
    assert () == cuts_of(flat, rectification, None)


@pytest.mark.long
def test_a_region_around_the_part_cuts_nothing(flat: cells.Flange, rectification: Rectification) -> None:
    """A region around the part cuts nothing, tight or with much textured table."""
    r = flat.region
    for wider in (-10.0, 0.0, 60.0):
        around = Region(r.x - wider, r.y - wider, r.width + 2 * wider, r.height + 2 * wider)
        assert () == cuts_of(flat, rectification, around)


def test_a_circle_that_is_cut_is_named(flat: cells.Flange, rectification: Rectification) -> None:
    """The cut reference is named, with the place where the region's border meets it."""
    r = flat.region
    texts = [cut.text for cut in cuts_of(flat, rectification, Region(r.x, r.y, 0.8 * r.width, r.height))]

    assert texts[0].startswith("c0, a disc of radius 14.0")
    assert ", the reference, at 457, " in texts[0]


def test_a_part_that_is_cut_all_around_is_noticed(flat: cells.Flange, rectification: Rectification) -> None:
    """A region inside the outline is reported as a cut."""
    r = flat.region
    inner = Region(r.x + 0.1 * r.width, r.y + 0.1 * r.height, 0.8 * r.width, 0.8 * r.height)
    cuts = cuts_of(flat, rectification, inner)

    assert cuts
    assert all(cut.by_region for cut in cuts)


def test_a_part_that_leaves_the_picture_is_noticed(flat: cells.Flange, rectification: Rectification) -> None:
    """A disc that is half outside of the picture is reported as cut by the picture."""
    where = cells.pose((8.0, 22.0, 205.0))
    left, right = cells.pictures(flat.rig, cells.scene((flat.part, where)))
    job = teach(left, right, rectification, None, "x")
    mask = taught_mask(None, (), rectification)
    cuts = cut_edges(job, rectification.left_image(left), mask, rectification)

    assert cuts
    assert not any(cut.by_region for cut in cuts)
    assert np.all([np.isfinite(cut.points).all() for cut in cuts])
