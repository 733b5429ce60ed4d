"""Triangulation: exact round trips, the right frame, and covariances that match the scatter."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.rigs import make_camera, make_rig, random_points, rigs
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rectification import make_rectification
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import (
    raw_covariance,
    triangulate,
    triangulate_raw,
    triangulation_covariance,
)


@settings(max_examples=12)
@given(rigs, st.integers(0, 1000))
def test_projected_points_come_back(rig: StereoRig, seed: int) -> None:
    """Through raw images or rectified ones, points return to the rig frame to 1e-6 of their distance."""
    try:
        points = random_points(rig, 40, seed)
    except ValueError:
        assume(False)
    left, right = rig.left.project(points), rig.right.project(apply(rig.right_from_left, points))
    tolerance = 1e-6 * np.abs(points).max()
    assert np.abs(triangulate_raw(rig, left, right) - points).max() < tolerance
    rectification = make_rectification(rig)
    ideal_left = rectification.rectify_points("left", left)
    ideal_right = rectification.rectify_points("right", right)
    assert np.abs(triangulate(rectification, ideal_left, ideal_right[:, 0]) - points).max() < tolerance


def test_rays_that_do_not_meet_in_front_are_nan() -> None:
    """Rays without parallax or with a negative one give NaN, never a point behind the cameras."""
    rig = make_rig(vergence_deg=0)
    rectification = make_rectification(rig)
    left = np.array([[700.0, 400.0], [700.0, 400.0], [700.0, 400.0]])
    offset = rectification.centre_right_px[0] - rectification.centre_left_px[0]
    points = triangulate(rectification, left, 700 + offset + np.array([-50.0, 0.0, 5.0]))
    assert np.isfinite(points[0]).all()
    assert np.isnan(points[1:]).all()
    raw_left, raw_right = np.array([[600.0, 480.0]]), np.array([[900.0, 480.0]])
    assert np.isnan(triangulate_raw(rig, raw_left, raw_right)).all()


@pytest.mark.parametrize("model", ["brown", "division"])
def test_covariances_match_the_scatter(model: str) -> None:
    """The normalised squared error of noisy points is 1 per coordinate, raw and rectified."""
    rig = make_rig(model)
    rectification = make_rectification(rig)
    rng = np.random.default_rng(4)
    points = random_points(rig, 2000, 3)
    sigma = 0.2
    left = rig.left.project(points) + rng.normal(0, sigma, (2000, 2))
    right = rig.right.project(apply(rig.right_from_left, points)) + rng.normal(0, sigma, (2000, 2))
    error = triangulate_raw(rig, left, right) - points
    covariance = raw_covariance(rig, points, sigma)
    assert _normalised(error, covariance) == pytest.approx(1, abs=0.06)

    ideal = rectification.rectify_points("left", rig.left.project(points))
    right_x = rectification.rectify_points("right", rig.right.project(apply(rig.right_from_left, points)))[
        :, 0
    ]
    noise_px = np.array([[0.04, 0.01, 0.0], [0.01, 0.02, 0.0], [0.0, 0.0, 0.09]])
    noise = rng.multivariate_normal(np.zeros(3), noise_px, 2000)
    error = triangulate(rectification, ideal + noise[:, :2], right_x + noise[:, 2]) - points
    covariance = triangulation_covariance(rectification, ideal, right_x, noise_px)
    assert _normalised(error, covariance) == pytest.approx(1, abs=0.06)


def _normalised(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(
        np.mean(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])) / 3
    )


def test_the_optimal_point_beats_any_neighbour() -> None:
    """No point near the found one has a smaller reprojection error in both images."""
    rig = make_rig("brown")
    points = random_points(rig, 10, 8)
    rng = np.random.default_rng(1)
    left = rig.left.project(points) + rng.normal(0, 1, (10, 2))
    right = rig.right.project(apply(rig.right_from_left, points)) + rng.normal(0, 1, (10, 2))
    best = triangulate_raw(rig, left, right)

    def cost(candidates: np.ndarray) -> np.ndarray:
        in_right = rig.right.project(apply(rig.right_from_left, candidates))
        return np.asarray(
            np.sum((rig.left.project(candidates) - left) ** 2 + (in_right - right) ** 2, axis=1)
        )

    for step in rng.normal(0, 0.02, (30, 10, 3)):
        assert (cost(best + step) >= cost(best)).all()


@pytest.mark.parametrize("model", ["brown", "division"])
def test_projection_jacobians_equal_finite_differences(model: str) -> None:
    """The derivatives by point and by parameter are those of CameraModel.project."""
    camera = make_camera(model)
    points = np.random.default_rng(0).uniform((-40, -30, 180), (40, 30, 240), (25, 3))
    pixels, by_point, by_parameter = project_with_jacobians(camera, points)
    assert np.allclose(pixels, camera.project(points), atol=1e-10)
    for axis, step in enumerate(np.eye(3) * 1e-4):
        numeric = (camera.project(points + step) - camera.project(points - step)) / 2e-4
        assert np.allclose(by_point[:, :, axis], numeric, atol=1e-5)
    values = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    for index in range(len(values)):
        step = np.zeros(len(values))
        step[index] = 1e-3 if index < 4 else 1e-5
        above, below = (
            type(camera)(model, camera.width, camera.height, *v[:4], tuple(v[4:])).project(points)
            for v in (values + step, values - step)
        )
        assert np.allclose(by_parameter[:, :, index], (above - below) / (2 * step[index]), atol=1e-4)
