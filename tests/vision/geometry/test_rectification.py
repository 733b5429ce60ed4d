"""Rectification: rows agree, nothing seen by both is lost, images and points say the same."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from helpers.rigs import make_camera, make_rig, random_points, rigs
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edged.errors import CalibrationError, ImageError
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import make_rectification, row_difference_px
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

few = settings(max_examples=12)  # each example builds four maps


@few
@given(rigs, st.integers(0, 1000))
def test_corresponding_points_lie_on_one_row_inside_both_images(rig: StereoRig, seed: int) -> None:
    """Rectified rows of one point agree to 1e-7 px, and every point that both cameras see lies in both
    images."""
    rectification = make_rectification(rig)
    try:
        points = random_points(rig, 50, seed)
    except ValueError:
        assume(False)
    left = rectification.rectify_points("left", rig.left.project(points))
    right = rectification.rectify_points("right", rig.right.project(apply(rig.right_from_left, points)))
    assert np.abs(left[:, 1] - right[:, 1]).max() < 1e-7
    width, height = rectification.size
    for view in (left, right):
        assert (view > -0.5).all()
        assert (view < (width - 0.5, height - 0.5)).all()
    assert rectification.size[0] % 16 == rectification.size[1] % 16 == 0


@few
@given(rigs, st.integers(0, 1000))
def test_points_go_to_the_rectified_image_and_back(rig: StereoRig, seed: int) -> None:
    """raw_points inverts rectify_points to 1e-8 px anywhere in the raw image."""
    rectification = make_rectification(rig)
    raw = np.random.default_rng(seed).uniform((0, 0), (rig.left.width - 1, rig.left.height - 1), (50, 2))
    for side in ("left", "right"):
        again = rectification.raw_points(side, rectification.rectify_points(side, raw))
        assert np.abs(again - raw).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("model", ["brown", "division"])
def test_images_and_points_are_rectified_alike(model: str) -> None:
    """A blob drawn in the raw image is in the rectified image where rectify_points says."""
    rectification = make_rectification(make_rig(model))
    y, x = np.mgrid[0:960, 0:1280]
    for side, warp in (("left", rectification.left_image), ("right", rectification.right_image)):
        for centre in ((300.3, 250.7), (900.0, 640.5), (640.2, 480.1)):
            blob = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * 3.0**2))
            warped = warp(np.rint(250 * blob).astype(np.uint8)).astype(float)
            rows, columns = np.mgrid[0 : warped.shape[0], 0 : warped.shape[1]]
            found = np.array([(warped * columns).sum(), (warped * rows).sum()]) / warped.sum()
            expected = rectification.rectify_points(side, np.array(centre))
            assert np.abs(found - expected).max() < 0.025  # the centroid of a warped, rounded blob


@pytest.mark.parametrize("model", ["brown", "division"])
def test_maps_and_masks_agree_with_exact_points(model: str) -> None:
    """A map entry is raw_points of that pixel; the mask says whether it lies in the raw image."""
    rectification = make_rectification(make_rig(model))
    width, height = rectification.size
    grid = np.stack(np.meshgrid(np.arange(0, width, 37), np.arange(0, height, 41)), axis=-1).astype(float)
    sides = (
        ("left", rectification.maps_left, rectification.valid_left),
        ("right", rectification.maps_right, rectification.valid_right),
    )
    for side, maps, valid in sides:
        raw = rectification.raw_points(side, grid)
        mapped = np.stack([m[::41, ::37] for m in maps], axis=-1)
        inside = ((raw >= 0) & (raw <= (1279, 959))).all(axis=-1)
        assert np.abs(mapped - raw)[inside].max() < 1e-3
        assert np.array_equal(valid[::41, ::37] == 255, inside)
        assert 0.5 < inside.mean() < 1


def test_maps_cannot_be_written() -> None:
    """The maps, which threads share, are read-only."""
    rectification = make_rectification(make_rig())

    for plane in (*rectification.maps_left, *rectification.maps_right):
        with pytest.raises(ValueError, match="read-only"):
            plane[0, 0] = 0.0


def test_pixel_scale_is_that_of_the_raw_images() -> None:
    """The rectified focal length keeps the pixel area at the image centres within 10 %."""
    rig = make_rig()
    rectification = make_rectification(rig)
    centre = np.array([639.5, 479.5])
    for side in ("left", "right"):
        corners = rectification.rectify_points(side, centre + np.array([[0, 0], [1, 0], [0, 1]]))
        assert np.linalg.det(corners[1:] - corners[0]) == pytest.approx(1, abs=0.1)


def test_one_distant_point_is_in_both_images_of_a_verged_rig() -> None:
    """At 24° vergence the point where both axes meet lies near the middle of both rectified images."""
    rig = make_rig(tilt_deg=0.0)
    rectification = make_rectification(rig)
    meeting = np.array([0, 0, 0.5 * rig.baseline_mm / np.sin(np.radians(12))])
    left = rectification.rectify_points("left", rig.left.project(meeting))
    right = rectification.rectify_points("right", rig.right.project(apply(rig.right_from_left, meeting)))
    middle = (np.array(rectification.size) - 1) / 2
    assert np.abs(left - middle).max() < 100
    assert np.abs(right - middle).max() < 100


def test_disparity_of_a_depth() -> None:
    """disparity_px is left.x - right.x of a point at that rectified depth, principal points included."""
    rig = make_rig()
    rectification = make_rectification(rig)
    points = random_points(rig, 20, 1)
    left = rectification.rectify_points("left", rig.left.project(points))
    right = rectification.rectify_points("right", rig.right.project(apply(rig.right_from_left, points)))
    depths = (points @ rectification.rectified_from_left.T)[:, 2]
    expected = [rectification.disparity_px(depth) for depth in depths]
    assert np.allclose(left[:, 0] - right[:, 0], expected, atol=1e-8)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.zeros((480, 640), np.uint8), "640x480, the rig was calibrated for 1280x960"),
        (np.zeros((960, 1280, 3), np.uint8), "3x1280x960, the rig was calibrated for 1280x960"),
        (np.zeros((960, 1280), np.uint16), "uint16 pixels, expected 8-bit grey"),
    ],
)
def test_an_image_that_does_not_fit_the_rig_is_refused(image: np.ndarray, reason: str) -> None:
    """A wrong size, colour or depth of an image is refused with both values."""
    rectification = make_rectification(make_rig())
    with pytest.raises(ImageError, match=f"right image: {reason}"):
        rectification.right_image(image)


def test_rigs_that_cannot_be_rectified_are_refused() -> None:
    """A camera behind the other and cameras that look apart are refused."""
    camera = make_camera("division")
    behind = StereoRig(camera, camera, transform(np.eye(3), np.array([0.0, 0, 50])), "x")
    with pytest.raises(CalibrationError, match="along the baseline"):
        make_rectification(behind)
    apart = rotation_matrix(np.array([0.0, np.radians(140), 0]))
    with pytest.raises(CalibrationError, match="cannot be rectified"):
        make_rectification(StereoRig(camera, camera, transform(apart, np.array([-100.0, 0, 0])), "x"))
    up = rotation_matrix(np.array([np.radians(40), 0, 0]))
    with pytest.raises(CalibrationError, match="no common row"):
        make_rectification(StereoRig(camera, camera, transform(up, up @ np.array([-100.0, 0, 0])), "x"))


def test_a_lens_that_folds_back_leaves_no_ghost() -> None:
    """The rectified image is empty, not a repeated scene, where Brown's polynomial turns back."""
    rig = make_rig("brown", vergence_deg=10)
    # The radius turns round at sqrt(1 / (3 * 0.3)) = 1.05 of the focal length, outside the image's corner
    folding = dataclasses.replace(rig.left, fx=1300.0, fy=1300.0, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0))
    rectification = make_rectification(dataclasses.replace(rig, left=folding, right=folding))
    directions = np.array([[1.6, 0.0], [0.3, 0.1]])
    assert (folding.pixels(directions[0]) < 1280).all()
    ideal = directions * rectification.focal_px + rectification.centre_left_px
    raw = rectification.raw_points("left", ideal)
    assert np.isnan(raw[0]).all()
    assert np.isfinite(raw[1]).all()


def test_right_frame_is_the_left_frame_turned() -> None:
    """Both rotations lead to one rectified frame, in which the right camera lies on the x axis."""
    rig = make_rig("brown")
    rectification = make_rectification(rig)
    left_from_right = rig.right_from_left[:3, :3].T
    assert np.allclose(
        rectification.rectified_from_right, rectification.rectified_from_left @ left_from_right
    )
    centre = -left_from_right @ rig.right_from_left[:3, 3]
    assert np.allclose(rectification.rectified_from_left @ centre, [rig.baseline_mm, 0, 0], atol=1e-9)


def test_plain_opencv_finds_the_same_rows() -> None:
    """cv2.undistortPoints with our rotation gives our rectified points."""
    rig = make_rig("brown")
    rectification = make_rectification(rig)
    raw = np.random.default_rng(2).uniform((0, 0), (1279, 959), (40, 2))
    k = rectification.focal_px
    cx, cy = rectification.centre_right_px
    projection = np.array([[k, 0, cx], [0, k, cy], [0, 0, 1]])
    expected = cv2.undistortPoints(
        raw[:, None],
        rig.right.matrix,
        np.array(rig.right.distortion),
        R=rectification.rectified_from_right,
        P=projection,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12),
    )[:, 0]
    assert np.allclose(rectification.rectify_points("right", raw), expected, atol=1e-6)


def test_the_row_difference_needs_no_maps() -> None:
    """row_difference_px is the difference of rectified rows, also for points that do not correspond."""
    rig = make_rig("brown")
    rectification = make_rectification(rig)
    rng = np.random.default_rng(6)
    left, right = rng.uniform((0, 0), (1279, 959), (2, 40, 2))
    expected = (
        rectification.rectify_points("left", left)[:, 1] - rectification.rectify_points("right", right)[:, 1]
    )
    assert np.allclose(row_difference_px(rig, left, right), expected, atol=1e-9)


LENSES = {
    "long": (3000.0, (1280, 960), (-0.21, 0.14, 5e-4, -4e-4, 0.0)),
    "wide": (350.0, (640, 480), (-0.3, 0.1, 1e-3, -5e-4, -0.012)),
    "small": (160.0, (128, 96), (-0.2, 0.1, 0.0, 0.0, 0.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("vergence_deg", [0.0, 12.0, 24.0, 35.0])
@pytest.mark.parametrize("factor", [1, 2])
def test_rows_agree_for_any_vergence_lens_and_size(lens: str, vergence_deg: float, factor: int) -> None:
    """With 85° wide lenses, small images and a right camera of twice the resolution every point keeps its
    row.

    And every point that both cameras see lies inside both rectified images, where the masks say so.
    """
    focal_px, size, distortion = LENSES[lens]
    rig = make_rig("brown", vergence_deg, focal_px=focal_px, size=size)
    left, right = (
        dataclasses.replace(rig.left, distortion=distortion),
        dataclasses.replace(rig.right, distortion=distortion),
    )
    right = dataclasses.replace(
        right,
        width=factor * right.width,
        height=factor * right.height,
        fx=factor * right.fx,
        fy=factor * right.fy,
        cx=factor * (right.cx + 0.5) - 0.5,
        cy=factor * (right.cy + 0.5) - 0.5,
    )
    rig = dataclasses.replace(rig, left=left, right=right)
    rectification = make_rectification(rig)
    points = random_points(rig, 100, seed=1)
    raw = left.project(points), right.project(apply(rig.right_from_left, points))
    rows_px = []
    for side, pixels, valid in (
        ("left", raw[0], rectification.valid_left),
        ("right", raw[1], rectification.valid_right),
    ):
        x, y = rectification.rectify_points(side, pixels).T
        rows_px.append(y)
        assert ((x > -1) & (y > -1) & (x < rectification.size[0]) & (y < rectification.size[1])).all()
        inside = (pixels > 2).all(axis=1) & (pixels < np.array([right.width, right.height]) / factor - 3).all(
            1
        )
        inside &= (x > 1) & (y > 1) & (x < rectification.size[0] - 2) & (y < rectification.size[1] - 2)
        assert valid[np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int)].all()
    np.testing.assert_allclose(rows_px[0], rows_px[1], atol=1e-9)
    np.testing.assert_allclose(row_difference_px(rig, *raw), 0.0, atol=1e-9)
    pixels = rectification.size[0] * rectification.size[1]
    assert pixels <= 4.3 * max(left.width * left.height, right.width * right.height)
