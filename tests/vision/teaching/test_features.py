"""Faces without circles of parts of many heights."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.drawnparts import place, rig
from solids import Design, Wall, box, polygon
from solidworld import drawn

from edged.domain.arrays import Image
from edged.errors import TeachError
from edged.vision.geometry.rigid import apply, invert
from edged.vision.teaching.features import common_depths, plane_of, strong_contours
from edged.vision.teaching.pair import TeachingView, teach, view_of

BASE = Wall("base", box(0.0, 0.0, 36.0, 26.0, 3.0), -1, True, 0.0, 6.0)
BOSSES = tuple(
    Wall(f"b{k}", polygon(((x - 3, y - 4), (x + 3, y - 4), (x + 2, y + 4), (x - 3, y + 3))), 0, True, z, 0.0)
    for k, (x, y, z) in enumerate(
        ((-8, -7, -4.0), (0, -7, -9.0), (8, -7, -2.5), (-8, 6, -12.0), (0, 6, -6.5), (8, 6, -10.5))
    )
)
SLOTS = tuple(
    Wall(f"s{k}", box(x, y, 2.0, 5.0, 0.99), 0, False, 0.0, 6.0)
    for k, (x, y) in enumerate(((-14.5, 5), (14.5, -5)))
)
STAIR = (
    Wall("base", box(0.0, 0.0, 30.0, 22.0, 0.01), -1, True, 0.0, 6.0),
    Wall("b1", polygon(((-13, -9), (-3, -9), (-3, 9), (-13, 9))), 0, True, -5.0, 0.0),
    Wall("b2", polygon(((2, -9), (12, -9), (12, -1), (6, -1), (2, -4))), 0, True, -10.0, 0.0),
)


def pair_of(*walls: Wall) -> tuple[Image, Image]:
    """The teaching pair of a part of some walls."""
    pair, _ = drawn(Design("part", walls), place(0.0), np.random.default_rng(5), teaching=True)
    return pair


def holds_a_plane(view: TeachingView) -> bool:
    """Whether most contours of a view lie in one plane."""
    return plane_of(view, strong_contours(view), common_depths(rig().rectification)) is not None


@pytest.mark.long
def test_a_face_is_found_by_its_slot_among_contours_of_other_heights() -> None:
    """Where no plane holds most contours, that of one contour and of what lies in it is the face."""
    pair = pair_of(BASE, *BOSSES, *SLOTS)
    assert not holds_a_plane(view_of(*pair, rig().rectification, None))
    job = teach(*pair, rig().rectification, None, "crowded")
    true = place(0.0)
    assert math.degrees(math.acos(job.rig_from_part[:3, 2] @ true[:3, 2])) < 0.05
    off = [apply(invert(true), job.rig_from_part[:3, 3]) - [x, y, 0.0] for x, y in ((14.5, -5), (-14.5, 5))]
    assert min(np.abs(apart).max() for apart in off) < 0.03


@pytest.mark.long
def test_edges_that_any_plane_holds_are_no_face() -> None:
    """Edges along the rows have no depth: with two at two heights a plane through all leans by 4°."""
    pair = pair_of(*STAIR)
    assert not holds_a_plane(view_of(*pair, rig().rectification, None))
    with pytest.raises(TeachError, match="no circle found, and no face with straight edges"):
        teach(*pair, rig().rectification, None, "stair")
