"""The plane of a face from its outline in two rectified images: truth, refusals, the kernels' twins."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import PLACE_MM, pictures, pose, scene, small_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import part as naive

from edged.domain.arrays import FloatArray
from edged.sim.render.scene import Disc, Part, Surface
from edged.vision.geometry.rectification import Rectification, StereoImages, make_rectification
from edged.vision.geometry.rigid import Plane
from edged.vision.part import initialplane as startplane
from edged.vision.part.initialplane import find_plane

RIG = small_rig()
DISC = Part("disc", Disc(0.0, 0.0, 12.0), Surface(albedo=0.62, contrast=0.08, feature_mm=0.6, seed=1))


@pytest.fixture(scope="module")
def rectification() -> Rectification:
    """The small rig, prepared."""
    return make_rectification(RIG)


def seen(rectification: Rectification, where: FloatArray, seed: int = 0) -> StereoImages:
    """Both images of the disc at a pose."""
    return StereoImages.of(rectification, *pictures(RIG, scene((DISC, where)), seed))


def outline(
    rectification: Rectification, where: FloatArray, off_px: float = 1.5
) -> tuple[FloatArray, FloatArray]:
    """The disc's true outline in the rectified left image, shifted, and its outward normals."""
    phase = np.arange(240) * (2 * np.pi / 240)
    ring = np.column_stack([np.cos(phase), np.sin(phase), np.zeros(240)]) * 12.0
    points = rectification.rectify_points("left", RIG.left.project(ring @ where[:3, :3].T + where[:3, 3]))
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    normals = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals *= np.sign(np.sum(normals * (points - points.mean(axis=0)), axis=1))[:, None]
    return points + off_px * np.array([0.6, -0.8]), normals


def depths(rectification: Rectification, where: FloatArray, share: float = 0.06) -> tuple[float, float]:
    """A search range around the true rectified depth."""
    depth = float((rectification.rectified_from_left @ where[:3, 3])[2])
    return depth * (1 - share), depth * (1 + share)


def find(images: StereoImages, where: FloatArray) -> Plane | None:
    """`find_plane` for the disc's outline."""
    points, normals = outline(images.rectification, where)
    return find_plane(images, points, normals, -1, depths(images.rectification, where))


@pytest.mark.parametrize(("turn_deg", "tilt_deg"), [(0.0, 0.0), (0.0, 6.0), (120.0, 6.0), (250.0, 12.0)])
def test_the_plane_is_found(rectification: Rectification, turn_deg: float, tilt_deg: float) -> None:
    """From an outline 1.5 px off, half-resolution images: direction to 0.2°, distance to 0.1 mm."""
    where = pose(turn_deg=turn_deg, tilt_deg=tilt_deg)
    plane = find(seen(rectification, where), where)
    assert plane is not None
    assert math.degrees(math.acos(min(1.0, plane.normal @ -where[:3, 2]))) < 0.2
    assert plane.normal[2] < 0
    assert abs(plane.normal @ where[:3, 3] - plane.offset) < 0.1


def test_a_blank_image_has_no_plane(rectification: Rectification) -> None:
    """With a blank left or right image there is no plane."""
    where = pose(tilt_deg=3.0)
    images = seen(rectification, where)
    blank = np.full_like(images.right, 70)
    assert find(replace(images, right=blank), where) is None
    assert find(replace(images, left=blank), where) is None


def test_a_part_out_of_range_has_no_plane(rectification: Rectification) -> None:
    """A disc 40 mm outside of the depth limits is not found."""
    where = pose()
    images = seen(rectification, where)
    points, normals = outline(rectification, where)
    near, far = depths(rectification, where, share=0.02)
    plane = find_plane(images, points, normals, -1, (near + 40, far + 40))
    assert plane is None


def test_points_that_are_no_numbers_are_left_out(rectification: Rectification) -> None:
    """NaN among the points changes little; only NaN, or no points, gives no plane."""
    where = pose(tilt_deg=2.0)
    images = seen(rectification, where)
    points, normals = outline(rectification, where)
    limits = depths(rectification, where)
    some = points.copy()
    some[::5] = np.nan
    plane = find_plane(images, some, normals, -1, limits)
    assert plane is not None
    assert plane.normal @ -where[:3, 2] > math.cos(math.radians(0.3))
    nowhere = np.full_like(points, np.nan)
    assert find_plane(images, nowhere, normals, -1, limits) is None
    none = np.zeros((0, 2))
    assert find_plane(images, none, none, -1, limits) is None


def test_the_same_images_give_the_same_bits(rectification: Rectification) -> None:
    """The same images give the same plane, because the random trials are always the same."""
    where = pose(tilt_deg=4.0)
    images = seen(rectification, where)
    one, two = find(images, where), find(images, where)
    assert one is not None
    assert two is not None
    assert np.array_equal(one.normal, two.normal)
    assert one.offset == two.offset


def test_a_ray_meets_a_plane_where_both_are() -> None:
    """The point lies on the ray and on the plane."""
    normal = pose(tilt_deg=20.0)[:3, 2]
    plane = Plane.through(PLACE_MM, -normal)
    rays = np.array([[0.0, 0.0, 1.0], [0.1, -0.2, 1.0], [0.3, 0.1, 2.0]])
    points = plane.meet(rays)
    np.testing.assert_allclose(points @ plane.normal, plane.offset, rtol=1e-12)
    assert np.abs(np.cross(points, rays)).max() < 1e-9


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    low=st.floats(-40, 10),
    span=st.floats(0, 60),
    min_slope=st.floats(0.1, 30),
    most=st.integers(1, 6),
)
def test_edges_of_a_row_equal_their_twin(
    seed: int, low: float, span: float, min_slope: float, most: int
) -> None:
    """On random pictures, inside and outside of them, the kernel keeps the strongest of its twin's edges."""
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (12, 40), np.uint8)
    points = rng.uniform((-10, -2), (50, 14), (6, 2))
    sign = rng.choice([-1.0, 1.0], 6)
    rivals = startplane.row_edges(image, points, sign, low, low + span, min_slope, most)
    for row, point, one in zip(rivals, points, sign, strict=True):
        known = {
            round(disparity, 9): slope
            for slope, disparity in naive.row_edges(image, point, one, low, low + span, min_slope)
        }
        kept = [known[round(float(disparity), 9)] for disparity in row if np.isfinite(disparity)]
        assert sorted(kept, reverse=True) == list(known.values())[:most]  # of equal ones, any


@settings(max_examples=20)
@given(
    seed=st.integers(0, 10_000),
    slopes=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
    wrong=st.floats(0.0, 0.5),
)
def test_the_plane_most_points_agree_with(seed: int, slopes: tuple[float, float], wrong: float) -> None:
    """The vote counts as its twin does, and with up to half of the points wrong the true plane wins."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-100, 100, (60, 2))
    truth = points @ slopes + 3.0 + rng.normal(0, 0.2, 60)
    rivals = np.full((60, 3), np.nan)
    rivals[:, 0] = np.where(rng.random(60) < wrong, rng.uniform(-60, 60, 60), truth)
    rivals[::2, 1] = rng.uniform(-60, 60, 30)
    a, b, c, count = startplane.ransac(points, rivals, 1500, 0.25, 1.0, 100.0)
    assert naive.plane_agreement(points, rivals, (a, b, c), 1.0) == count
    assert count >= 0.9 * naive.plane_agreement(points, rivals, (*slopes, 3.0), 1.0)
    assert max(abs(a - slopes[0]), abs(b - slopes[1])) < 0.05


def test_without_rivals_there_is_no_vote() -> None:
    """With no rivals, or all points in one place, no point agrees."""
    points = np.random.default_rng(0).uniform(-10, 10, (8, 2))
    assert startplane.ransac(points, np.full((8, 2), np.nan), 100, 0.25, 1.0, 1.0)[3] == 0
    assert startplane.ransac(np.zeros((8, 2)), np.zeros((8, 2)), 100, 0.25, 1.0, 0.0)[3] == 0
