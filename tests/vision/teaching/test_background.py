"""A strongly textured table is not taught, only the part."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import PLACE_MM, Flange, flange, pictures, pose, region_around, scene

from edged.domain.arrays import FloatArray
from edged.sim.render.scene import Surface
from edged.vision.geometry.rectification import Rectification, StereoImages, make_rectification
from edged.vision.geometry.rigid import Plane, rotation_matrix
from edged.vision.shape.search import find_shapes
from edged.vision.teaching.background import (
    agreeing_with,
    fits_significantly_better,
    with_ratio,
    without_background,
)
from edged.vision.teaching.features import TeachingView, plane_of, strong_contours
from edged.vision.teaching.pair import teach

TABLE = Surface(albedo=0.3, contrast=0.9, feature_mm=0.8, seed=2)
"""Blotches as bright and dark as the part, 12 px wide."""


@pytest.fixture(scope="module")
def flat() -> Flange:
    """The flange, square to the left camera."""
    return flange()


@pytest.fixture(scope="module")
def rectification(flat: Flange) -> Rectification:
    """The rectification of its rig."""
    return make_rectification(flat.rig)


def outline_px(flat: Flange, rectification: Rectification, where: FloatArray) -> FloatArray:
    """(N, 2) points on all circles of the flange at a pose, in the rectified left image."""
    turns = np.linspace(0, 2 * math.pi, 720, endpoint=False)
    rings = [
        np.column_stack(
            [one.x_mm + one.radius_mm * np.cos(turns), one.y_mm + one.radius_mm * np.sin(turns), 0 * turns]
        )
        for _, one in flat.part.circles
    ]
    rig = np.concatenate(rings) @ where[:3, :3].T + where[:3, 3]
    return rectification.rectify_points("left", flat.rig.left.project(rig))


@pytest.mark.long
def test_a_strong_texture_is_not_learnt(flat: Flange, rectification: Rectification) -> None:
    """In regions with much of the table nine of ten model points lie on the part, and it is found on
    another such table, turned and nearer, to 0.5 px."""
    region = region_around(flat.rig, pose()[:3, 3], 16.0)
    outline, shares = outline_px(flat, rectification, pose()), []
    for seed in range(9, 15):
        pair = pictures(flat.rig, scene((flat.part, pose()), table=replace(TABLE, seed=seed)))
        job = teach(*pair, rectification, region, "flange")
        points = job.shape.levels[0].points + job.shape.origin_px
        apart = np.array([np.linalg.norm(outline - point, axis=1).min() for point in points])
        shares.append(np.mean(apart < 2.0))
    assert np.mean(shares) > 0.9

    x, y, z = PLACE_MM
    there = pose((x - 2.0, y + 1.5, z - 3.0), turn_deg=100.0)
    left, _ = pictures(flat.rig, scene((flat.part, there), table=replace(TABLE, seed=9)), seed=1)
    (match,) = find_shapes(rectification.left_image(left), job.shape, job.search, rectification.valid_left)
    truth = rectification.rectify_points("left", flat.rig.left.project(there[None, :3, 3]))[0]
    assert match.score > 0.8
    assert math.dist((match.x_px, match.y_px), truth) < 0.5


def test_on_a_quiet_table_the_region_stays_as_it_is(flat: Flange, rectification: Rectification) -> None:
    """If most edges are the part's, nothing is cut from the region; also not at a wrong depth, where no
    edge agrees."""
    mask = np.zeros_like(rectification.left_image(flat.left))
    x, y = outline_px(flat, rectification, pose())[:720].mean(axis=0).round().astype(int)
    mask[y - 130 : y + 130, x - 130 : x + 130] = 255
    view = TeachingView(StereoImages.of(rectification, flat.left, flat.right), mask)
    np.testing.assert_array_equal(without_background(view, pose(), mask), mask)

    np.testing.assert_array_equal(without_background(view, pose((8.0, 0.0, 260.0)), mask), mask)


def test_contours_tell_the_face_from_one_that_leans(flat: Flange, rectification: Rectification) -> None:
    """Contours tell the face from a plane that leans by 1.5°."""
    mask = np.full_like(rectification.left_image(flat.left), 255)
    view = TeachingView(StereoImages.of(rectification, flat.left, flat.right), mask)
    contours, middle = strong_contours(view), pose()[:3, 3]
    leant = pose()[:3, :3] @ rotation_matrix(np.array([0.0, math.radians(1.5), 0.0]))
    face, leaning = (Plane.through(middle, normal) for normal in (pose()[:3, 2], leant[:, 2]))
    assert fits_significantly_better(view, face, leaning, contours)
    assert not fits_significantly_better(view, leaning, face, contours)
    assert not fits_significantly_better(view, face, face, contours)
    found = plane_of(view, contours, (150.0, 260.0))
    assert found is not None
    assert math.degrees(math.acos(min(abs(float(found.normal @ face.normal)), 1.0))) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("darker", [0.3, 0.42, 0.7])
def test_contours_agree_also_where_one_picture_is_darker(
    flat: Flange, rectification: Rectification, darker: float
) -> None:
    """Most contours of the face are found again in a right picture that has any share of the brightness."""
    right = np.rint(darker * flat.right).astype(np.uint8)
    view = TeachingView(StereoImages.of(rectification, flat.left, right), rectification.valid_left)
    view = with_ratio(view)
    face = Plane.through(pose()[:3, 3], pose()[:3, 2])
    agreeing = np.concatenate([agreeing_with(view, face, contour) for contour in strong_contours(view)])
    assert agreeing.mean() > 0.8
