"""Which way a part of several heights looks, by its circles."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest

from edged.domain.measurement import Circle3D
from edged.vision.curves.planefit import CurveFit
from edged.vision.geometry.rigid import Plane
from edged.vision.part.frames import FoundCircle
from edged.vision.teaching.levels import in_front, turned_alike

UP = np.array([0.0, 0.0, -1.0])


def circle(x: float, y: float, z: float, radius_mm: float) -> FoundCircle:
    """One that was measured there; its own fit is not asked."""
    centre = np.array([x, y, 200.0 + z])
    return FoundCircle(
        Circle3D("circle", centre, UP, radius_mm, np.eye(4) * 1e-4), np.eye(6), cast("CurveFit", None)
    )


def test_circles_that_are_seen_by_other_ends_of_their_breaks_do_not_tilt_the_face() -> None:
    """A disc with a chamfer of 0.12 mm and a small hole without: the rim of 27 mm knows better."""
    found = [circle(0, 0, 0.131, 13.58), circle(7, -1.7, 0.004, 1.98), circle(2.7, -8.3, 0.137, 1.02),
             circle(-5.3, 4.2, -4.99, 2.83), circle(-4.9, -5.5, -3.42, 2.67)]  # fmt: skip
    normal, heights = turned_alike(found, UP)
    assert math.acos(float(normal @ UP)) < math.radians(0.1)
    below = heights.max() - heights
    assert [4.99 + 0.134, 4.99 + 0.004, 4.99 + 0.134, 0.0, 4.99 - 3.42] == pytest.approx(
        list(below), abs=0.01
    )


def test_circles_of_one_face_tilt_it_where_the_largest_one_does_not_contradict() -> None:
    """Four holes of 4 mm in a face that leans by 0.5 degrees, of which the first was taken for level."""
    lean = math.tan(math.radians(0.5))
    found = [circle(x, y, lean * x, 2.0) for x, y in ((-10, -8), (10, -8), (-10, 8), (10, 8))]
    found.append(circle(0, 0, -3.0, 1.5))
    normal, heights = turned_alike(found, UP)
    leaning = np.array([math.sin(math.radians(0.5)), 0.0, -math.cos(math.radians(0.5))])
    assert math.acos(float(normal @ leaning)) < math.radians(0.05)
    assert np.ptp(heights[:4]) < 1e-9


def test_what_contours_lie_in_is_a_face_where_no_circle_is_nearer() -> None:
    """A bore at the bottom of a counterbore 1.7 mm deep: its face has outlines only. A table is no face."""
    found = [circle(0, 0, 0.0, 1.15), circle(9, 4, 0.0, 1.0)]
    assert in_front(Plane(UP, -198.3), found, UP) == pytest.approx((-198.3,))
    assert in_front(Plane(UP, -205.0), found, UP) == ()
    assert in_front(None, found, UP) == ()
