"""The range of depths in which a face is looked for first: about where the optical axes meet."""

from __future__ import annotations

import math

import numpy as np
from helpers.cells import pictures, pose, region_around, scene, small_rig

from edged.sim.render.scene import Disc, Part, Surface
from edged.vision.geometry.rectification import StereoImages, make_rectification
from edged.vision.geometry.rigid import Plane
from edged.vision.part.initialplane import find_plane
from edged.vision.teaching.features import (
    TeachingView,
    common_depths,
    plane_of,
    strong_contours,
    usual_depths,
    where_axes_meet,
)
from edged.vision.teaching.pair import taught_mask

RECTIFICATION = make_rectification(small_rig())
WHERE = pose()


def striped() -> TeachingView:
    """A faint disc, and strong stripes where the right camera would see it if it were much nearer."""
    disc = Part("disc", Disc(0.0, 0.0, 6.0), Surface(0.30))
    left, right = pictures(small_rig(), scene((disc, WHERE), table=Surface(0.2)))
    centre = small_rig().right.project((small_rig().right_from_left @ WHERE)[None, :3, 3])[0, 0]
    columns = np.arange(right.shape[1])
    stripes = np.where(columns // 4 % 2, 250, 5).astype(np.uint8)
    nearer = columns < centre - 100  # than three quarters of where the axes meet
    right[:, nearer] = stripes[nearer]
    mask = taught_mask(region_around(small_rig(), WHERE[:3, 3], 7.0), (), RECTIFICATION)
    return TeachingView(StereoImages.of(RECTIFICATION, left, right), mask)


def is_face(plane: Plane | None) -> bool:
    """Whether a plane is that of the disc, to a degree and half a millimetre."""
    if plane is None:
        return False
    off_mm = abs(float(plane.normal @ WHERE[:3, 3]) - plane.offset)
    return off_mm < 0.5 and float(-plane.normal @ WHERE[:3, 2]) > math.cos(math.radians(1.0))


def test_the_usual_range_holds_what_lies_where_the_axes_meet() -> None:
    """It lies within all that both images can show, a quarter nearer to a quarter farther than that place."""
    images = striped().images
    nearest, farthest = common_depths(RECTIFICATION)
    low, high = usual_depths(images)
    depth = float((RECTIFICATION.rectified_from_left @ where_axes_meet(images))[2])
    assert nearest <= low < depth < high <= farthest
    assert math.isclose(high / low, 1.25**2)


def test_stronger_edges_elsewhere_do_not_hide_a_face() -> None:
    """Of each row, only so many rivals of an edge are kept, the strongest."""
    view = striped()
    contours = strong_contours(view)
    points = np.concatenate([contour.points for contour in contours])
    normals = np.concatenate([contour.normals for contour in contours])
    everywhere = common_depths(RECTIFICATION)
    assert not is_face(find_plane(view.images, points, normals, 1, everywhere))
    assert is_face(plane_of(view, contours, everywhere))
