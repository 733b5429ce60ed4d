"""Faces that a teaching pair shows by their texture."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.drawnparts import pair, place, rig

from edged.vision.geometry.rigid import Plane
from edged.vision.teaching.features import common_depths
from edged.vision.teaching.pair import teach, view_of
from edged.vision.teaching.surfaces import surfaces_of

FACE = Plane.through(place(0.0)[:3, 3], -place(0.0)[:3, 2])


def shown(design: int) -> tuple[Plane, ...]:
    """The surfaces of a drawn part's teaching pair."""
    rectification = rig().rectification
    return surfaces_of(view_of(*pair(design), rectification, None), common_depths(rectification))


@pytest.mark.parametrize("design", [207, 223, 241])
def test_a_textured_face_is_the_nearest_surface(design: int) -> None:
    """The face is found to 0.2 degrees and 0.05 mm, before the table behind it."""
    nearest = shown(design)[0]
    assert nearest.lean_rad(FACE) < math.radians(0.2)
    assert float(FACE.normal @ place(0.0)[:3, 3]) == pytest.approx(nearest.offset, abs=0.05)


def test_a_smooth_face_is_no_surface() -> None:
    """Matches that are smeared between the edges of a smooth face make no plane."""
    assert not shown(236)


@pytest.mark.parametrize("kind", ["noise", "one grey", "a line at the border"])
def test_pictures_of_nothing_have_no_surface(kind: str) -> None:
    """Nor do ranges of depth that the cameras do not have in common."""
    rectification = rig().rectification
    shape = rig().rig.left.height, rig().rig.left.width
    image = np.full(shape, 128, np.uint8)
    if kind == "noise":
        image = np.random.default_rng(1).integers(0, 255, shape).astype(np.uint8)
    elif kind == "a line at the border":
        image[5] = 255
    view = view_of(image, image, rectification, None)
    for depths_mm in (common_depths(rectification), (1.0, 2.0), (1e5, 1e6)):
        assert not surfaces_of(view, depths_mm)


@pytest.mark.long
@pytest.mark.parametrize("design", [212, 213, 241, 437])
def test_a_part_whose_edges_lean_is_taught_as_its_texture_lies(design: int) -> None:
    """Parts that few edges showed turned by 3 to 5 degrees, or not at all, are taught level to 0.3."""
    job = teach(*pair(design), rig().rectification, None, "part")
    lean = math.acos(min(float(job.rig_from_part[:3, 2] @ -FACE.normal), 1.0))
    assert lean < math.radians(0.3)


@pytest.mark.long
def test_a_hole_that_shows_its_wall_is_taught() -> None:
    """Three fifths of its rim are enough beside other holes, where its wall is as bright as the face."""
    job = teach(*pair(220), rig().rectification, None, "part")
    assert 2 == len(job.circles)
    assert np.ptp([circle.centre_mm[2] for circle in job.circles]) < 0.3
