"""The normal of a part with several heights, from its circles."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest
from helpers.cells import PLACE_MM, pose, small_rig

from edged.domain.measurement import Circle3D
from edged.vision.curves.planefit import CurveFit
from edged.vision.geometry.rectification import StereoImages, make_rectification
from edged.vision.geometry.rigid import Plane
from edged.vision.part.frames import FoundCircle
from edged.vision.part.job import CircleFeature
from edged.vision.teaching.features import FoundFeatures, TeachingView
from edged.vision.teaching.levels import SolidFeatures, in_front, main_face_mask, turned_alike

UP = np.array([0.0, 0.0, -1.0])


def circle(x: float, y: float, z: float, radius_mm: float) -> FoundCircle:
    """A measured circle at this place, with a fit that is not used."""
    centre = np.array([x, y, 200.0 + z])
    return FoundCircle(
        Circle3D("circle", centre, UP, radius_mm, np.eye(4) * 1e-4), np.eye(6), cast("CurveFit", None)
    )


def test_circles_that_are_seen_by_other_ends_of_their_breaks_do_not_tilt_the_face() -> None:
    """A large rim decides the normal; a small hole seen at another end of its break does not tilt it."""
    found = [circle(0, 0, 0.131, 13.58), circle(7, -1.7, 0.004, 1.98), circle(2.7, -8.3, 0.137, 1.02),
             circle(-5.3, 4.2, -4.99, 2.83), circle(-4.9, -5.5, -3.42, 2.67)]  # fmt: skip
    normal, heights = turned_alike(found, UP)
    assert math.acos(float(normal @ UP)) < math.radians(0.1)
    below = heights.max() - heights
    assert [4.99 + 0.134, 4.99 + 0.004, 4.99 + 0.134, 0.0, 4.99 - 3.42] == pytest.approx(
        list(below), abs=0.01
    )


def test_circles_of_one_face_tilt_it_where_the_largest_one_does_not_contradict() -> None:
    """Circles of one face decide the normal if the largest one does not contradict."""
    lean = math.tan(math.radians(0.5))
    found = [circle(x, y, lean * x, 2.0) for x, y in ((-10, -8), (10, -8), (-10, 8), (10, 8))]
    found.append(circle(0, 0, -3.0, 1.5))
    normal, heights = turned_alike(found, UP)
    leaning = np.array([math.sin(math.radians(0.5)), 0.0, -math.cos(math.radians(0.5))])
    assert math.acos(float(normal @ leaning)) < math.radians(0.05)
    assert np.ptp(heights[:4]) < 1e-9


def test_what_contours_lie_in_is_a_face_where_no_circle_is_nearer() -> None:
    """The plane of contours counts as a face only if it is in front of the circles."""
    found = [circle(0, 0, 0.0, 1.15), circle(9, 4, 0.0, 1.0)]
    assert in_front(Plane(UP, -198.3), found, UP) == pytest.approx((-198.3,))
    assert in_front(Plane(UP, -205.0), found, UP) == ()
    assert in_front(None, found, UP) == ()


def test_a_face_without_features_is_searched_for_by_those_of_the_reference() -> None:
    """All circles lie a millimetre and a half below the face that most edges are in."""
    rectification = make_rectification(small_rig())
    images = StereoImages.of(rectification, *(np.zeros((480, 640), np.uint8),) * 2)
    view = TeachingView(images, np.full_like(rectification.valid_left, 255))
    face = pose(tuple(PLACE_MM))
    features = [CircleFeature("c0", np.array([0.0, 0.0, 1.5]), 2.0, 1)]
    found = SolidFeatures(face, (), FoundFeatures((), (), ()))
    around = main_face_mask(view, features, found)
    assert 500 < np.count_nonzero(around) < 5000
