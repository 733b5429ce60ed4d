"""Systematic edge shifts: their shapes follow the view, and their size is estimated from the samples."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.adjustments import problem, solve

from edged.domain.arrays import FloatArray
from edged.vision.curves.systematic import FAMILIES, fill_shifts, fill_slants


def ring(count: int) -> FloatArray:
    """(N, 3) directions around the z axis."""
    angle = np.arange(count) * (2 * np.pi / count)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])


def shift_basis(normals: FloatArray, gain: FloatArray, slant: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The shapes of the shifts in the left and in the right image."""
    shifts = np.empty((2, len(normals), len(FAMILIES)))
    fill_shifts(normals, gain, slant, shifts)
    return shifts[0], shifts[1]


def slants(points: FloatArray, outwards: FloatArray, pose: FloatArray) -> FloatArray:
    """Slants of points (N, 3) and directions in a plane seen from above, rig axes."""
    found = np.empty(len(points))
    face = np.concatenate([np.eye(3) * [1.0, 1.0, -1.0], np.zeros((1, 3))])
    plain = np.ascontiguousarray(points * [1.0, 1.0, -1.0])
    fill_slants(plain, np.ascontiguousarray(outwards[:, :2]), face, pose, found)
    return found


def test_a_wall_is_seen_where_the_ray_runs_outwards() -> None:
    """From above a ring every slant is radius over height; from the side the two ends differ in sign."""
    radial = ring(60)
    above = slants(np.array([0.0, 0.0, 200.0]) + 10.0 * radial, radial, np.eye(4))
    np.testing.assert_allclose(above, 0.05)
    camera = np.eye(4)
    camera[:3, 3] = -100.0, 0.0, 0.0  # stands at x = 100: the ring lies to its left
    aside = slants(np.array([0.0, 0.0, 200.0]) + 10.0 * radial, radial, camera)
    assert aside[0] == pytest.approx((10.0 - 100.0) / 200.0)
    assert aside[30] == pytest.approx((10.0 + 100.0) / 200.0)


def test_walls_displace_one_side_only() -> None:
    """The first wall displaces edges where the ray runs outwards, the second elsewhere, most at a small
    slant."""
    slant = np.array([-0.4, -0.05, -0.01, 0.0, 0.01, 0.05, 0.4])
    left, right = shift_basis(np.tile([1.0, 0.0], (7, 1)), np.ones((2, 7)), np.stack([slant, slant[::-1]]))
    shapes = left[:, 10:]
    np.testing.assert_allclose(right[:, 10:], shapes[::-1])
    assert (shapes[:4, 0] == 0).all()
    assert (shapes[3:, 1] == 0).all()
    np.testing.assert_allclose(shapes[:, 0], shapes[::-1, 1])
    assert shapes[5, 0] == shapes[:, 0].max() > 10 * shapes[6, 0]


@pytest.mark.parametrize(("true_px", "expected_px"), [(0.05, 0.002), (0.05, 0.2), (0.0, 0.05)])
def test_the_size_is_learned(true_px: float, expected_px: float) -> None:
    """Whatever sigma of the shifts is expected, the estimate is near the one they were drawn with."""
    learned = []
    for seed in range(20):
        samples, _ = problem(seed, bias=true_px, noise=0.02)
        samples = samples._replace(families=np.zeros(5, np.int64), expected=np.full((4, 1), expected_px))
        solution = solve(samples, 10, 5)
        assert solution is not None
        learned.append(solution.bias)
    # two kinds: the second has curves that share a displacement besides
    rms = np.sqrt(np.mean(np.square(learned), axis=0))
    assert (rms > 0.8 * true_px).all()
    assert (rms < 1.25 * true_px + 0.4 * min(expected_px, 0.05)).all()


def test_the_covariance_follows_what_was_learned() -> None:
    """With an expected sigma of a tenth of the true one, chi² is still near 1."""
    chi2 = []
    for seed in range(60):
        samples, truth = problem(seed, bias=0.05, noise=0.03)
        solution = solve(samples._replace(expected=np.full_like(samples.expected, 0.005)), 10, 5)
        assert solution is not None
        error = solution.delta[:5] - truth
        chi2.append(float(error @ np.linalg.solve(solution.covariance[:5, :5], error)) / 5)
    assert 0.8 < np.mean(chi2) < 1.4


def test_cameras_see_the_same_or_the_opposite() -> None:
    """The first waves displace both images as a motion in space does, the next ones in opposite
    directions."""
    angle = np.arange(40) * (2 * np.pi / 40)
    normals, gain = (
        np.column_stack([np.cos(angle), np.sin(angle)]),
        np.stack([np.full(40, 12.0), np.full(40, 8.0)]),
    )
    left, right = shift_basis(normals, gain, np.zeros((2, 40)))
    np.testing.assert_allclose(left[:, :5] / 12.0, right[:, :5] / 8.0)
    np.testing.assert_allclose(left[:, 5:10] / 12.0, -right[:, 5:10] / 8.0)
    assert left.shape[1] == len(FAMILIES)
