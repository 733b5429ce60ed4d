"""Rotations and rigid transforms: algebraic truths and the fit's stated precision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError
from edged.vision.geometry.rigid import (
    about_z,
    angle_between,
    apply,
    cross,
    fit_rigid,
    invert,
    nearest_rotation,
    quaternion,
    rotation_2d,
    rotation_matrix,
    rotation_vector,
    skew,
    transform,
    turn_between,
    unit,
    wrapped,
)

component = st.floats(-1, 1, allow_nan=False)
unit_vectors = (
    st.tuples(component, component, component)
    .map(lambda v: np.array(v))
    .filter(lambda v: np.linalg.norm(v) > 1e-3)
    .map(lambda v: v / np.linalg.norm(v))
)
angles = st.one_of(st.floats(0, np.pi), st.floats(0, 1e-6), st.floats(0, 1e-6).map(lambda e: np.pi - e))
rotations = st.builds(lambda axis, angle: rotation_matrix(axis * angle), unit_vectors, angles)
points = st.tuples(*[st.floats(-500, 500)] * 3).map(lambda p: np.array(p))
transforms = st.builds(transform, rotations, points)


@given(points, points)
def test_products_of_two_vectors_are_numpys(a: FloatArray, b: FloatArray) -> None:
    """The cross product and the unit vector equal numpy's."""
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    if a @ a > 1e-12:
        np.testing.assert_allclose(unit(a), a / np.linalg.norm(a), rtol=1e-14)


@given(transforms, unit_vectors, angles)
def test_the_turn_between_two_poses_is_that_of_one_to_the_other(
    pose: FloatArray, axis: FloatArray, angle: float
) -> None:
    """The angle of the turn is found about any axis, wherever the poses are, in either order."""
    turned = pose @ transform(rotation_matrix(axis * angle), np.ones(3))
    assert turn_between(pose, turned) == pytest.approx(angle, abs=1e-6)
    assert turn_between(turned, pose) == pytest.approx(angle, abs=1e-6)


@given(unit_vectors, angles)
def test_rotation_vector_and_matrix_are_inverse(axis: FloatArray, angle: float) -> None:
    """Every rotation vector comes back from its matrix, near 0 and near pi (up to its sign there) too."""
    vector = axis * angle
    rotation = rotation_matrix(vector)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    again = rotation_vector(rotation)
    assert np.linalg.norm(again) <= np.pi + 1e-12
    same = np.allclose(again, vector, atol=1e-12, rtol=1e-12)
    opposite = np.allclose(again, -vector, atol=1e-7) and angle > np.pi - 1e-7
    assert same or opposite or np.allclose(rotation_matrix(again), rotation, atol=1e-14)


@given(unit_vectors, angles)
def test_a_quaternion_holds_half_the_angle(axis: FloatArray, angle: float) -> None:
    """The quaternion is (cos a/2, axis sin a/2), scalar first and not negative, also near 0 and near half
    a turn."""
    found = quaternion(rotation_matrix(axis * angle))
    assert found[0] >= 0
    expected = np.append(np.cos(angle / 2), axis * np.sin(angle / 2))
    same, opposite = np.allclose(found, expected, atol=1e-12), np.allclose(found, -expected, atol=1e-6)
    assert same or (opposite and angle > np.pi - 1e-6)


@given(st.floats(-100, 100), st.sampled_from([np.pi, 2 * np.pi, 360.0]))
def test_a_wrapped_angle_is_the_same_one_and_short(angle: float, period: float) -> None:
    """A wrapped angle differs by whole periods and lies within half a period; arrays are wrapped by
    element."""
    short = wrapped(angle, period)
    assert -period / 2 <= short <= period / 2
    turns = (angle - short) / period
    assert turns == pytest.approx(round(turns), abs=1e-9)
    assert wrapped(np.array([angle, 0.0]), period).tolist() == [short, 0.0]


def test_directions_differ_by_half_a_turn_at_most() -> None:
    """The difference is the shorter way round, in either order, without whole turns."""
    assert angle_between(0.1, -0.2) == pytest.approx(0.3)
    assert angle_between(3.0, -3.0) == pytest.approx(2 * np.pi - 6) == angle_between(-3.0, 3.0)
    assert angle_between(1.0 + 6 * np.pi, 1.0) == pytest.approx(0.0, abs=1e-12)
    assert angle_between(0.0, np.pi) == pytest.approx(np.pi)


@given(st.floats(-10, 10))
def test_a_rotation_of_the_plane_is_one_about_z(angle: float) -> None:
    """The 2D rotation is the upper left of the 3D rotation about z."""
    assert np.allclose(rotation_2d(angle), rotation_matrix(np.array([0, 0, angle]))[:2, :2], atol=1e-14)


def test_rotation_matrix_of_a_quarter_turn() -> None:
    """+90° about z takes x to y: the sense of rotation is right-handed."""
    quarter = rotation_matrix(np.array([0, 0, np.pi / 2]))
    assert np.allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_rotation_matrix_of_many_vectors_equals_one_at_a_time() -> None:
    """The leading axes of rotation_matrix and skew are batches."""
    vectors = np.random.default_rng(1).normal(size=(4, 2, 3))
    many = rotation_matrix(vectors)
    assert many.shape == (4, 2, 3, 3)
    assert np.array_equal(rotation_matrix(vectors[2, 1]), many[2, 1])
    assert np.array_equal(skew(vectors[3, 0]), skew(vectors)[3, 0])


@given(points, points)
def test_skew_is_the_cross_product(a: FloatArray, b: FloatArray) -> None:
    """skew(a) @ b is a x b."""
    assert np.allclose(skew(a) @ b, np.cross(a, b), atol=1e-9)


@given(transforms, transforms, points)
def test_transforms_chain_and_cancel(a: FloatArray, b: FloatArray, point: FloatArray) -> None:
    """apply(a @ b) is apply(a) after apply(b), and the inverse undoes it."""
    assert np.allclose(apply(a @ b, point), apply(a, apply(b, point)), atol=1e-9)
    assert np.allclose(invert(a) @ a, np.eye(4), atol=1e-9)
    assert np.allclose(apply(invert(a), apply(a, point)), point, atol=1e-9)


@given(rotations)
def test_nearest_rotation_removes_a_small_error(rotation: FloatArray) -> None:
    """A rotation is its own nearest rotation; a disturbed matrix becomes a rotation again."""
    assert np.allclose(nearest_rotation(rotation), rotation, atol=1e-12)
    disturbed = nearest_rotation(rotation + 1e-3)
    assert np.allclose(disturbed @ disturbed.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(disturbed) > 0


@pytest.mark.slow
@given(transforms, st.integers(3, 12), st.integers(0, 2**32 - 1), st.floats(0.2, 5))
def test_fit_rigid_finds_the_transform(pose: FloatArray, n: int, seed: int, scale: float) -> None:
    """From exact points the transform is found exactly, with the scale if it is asked for."""
    source = np.random.default_rng(seed).uniform(-50, 50, (n, 3))
    rigid = fit_rigid(source, apply(pose, source))
    assert np.allclose(rigid.to_from_source, pose, atol=1e-8)
    similar = fit_rigid(source, apply(pose, scale * source), with_scale=True)
    assert similar.scale == pytest.approx(scale)
    assert np.allclose(similar.to_from_source, pose, atol=1e-7)


def test_fit_rigid_of_planar_points_is_a_rotation_not_a_mirror() -> None:
    """For points in one plane the fit gives the rotation, not the mirror image."""
    source = np.array([[0, 0, 0], [10, 0, 0], [0, 7, 0], [4, 4, 0.0]])
    pose = transform(rotation_matrix(np.array([2.0, -1.0, 0.5])), np.array([5, 6, 7.0]))
    assert np.allclose(fit_rigid(source, apply(pose, source)).to_from_source, pose, atol=1e-12)


def test_fit_rigid_covariance_matches_the_scatter() -> None:
    """Over many noisy fits the normalised squared error of the pose is 1 per parameter."""
    rng = np.random.default_rng(5)
    source = rng.uniform((60, 10, -40), (140, 90, 40), (9, 3))
    pose = transform(rotation_matrix(np.array([0.3, -0.2, 1.1])), np.array([400, 20, 300.0]))
    squares, runs, freedom = 0.0, 400, 3 * 9 - 6
    for _ in range(runs):
        fit = fit_rigid(source, apply(pose, source) + rng.normal(0, 0.05, source.shape))
        turn = rotation_vector(pose[:3, :3] @ fit.to_from_source[:3, :3].T)
        error = np.concatenate([pose[:3, 3] - fit.to_from_source[:3, 3], turn])
        squares += error @ np.linalg.solve(fit.covariance, error) / 6
    # sigma is estimated from the residuals: Hotelling's T² has the mean freedom / (freedom - 2)
    assert squares / runs == pytest.approx(freedom / (freedom - 2), rel=0.1)


@given(st.floats(-10, 10))
def test_about_z_is_a_rotation_vector_along_z(angle: float) -> None:
    """It is bit by bit the rotation matrix of that vector."""
    np.testing.assert_array_equal(about_z(angle), rotation_matrix(np.array([0.0, 0.0, angle])))


@pytest.mark.parametrize(
    ("source", "target", "expected"),
    [
        (np.zeros((2, 3)), np.zeros((2, 3)), "at least three"),
        (np.zeros((4, 3)), np.zeros((5, 3)), "at least three"),
        (np.arange(12.0).reshape(4, 3), np.arange(12.0).reshape(4, 3), "one line"),
        (np.full((4, 3), np.nan), np.zeros((4, 3)), "finite"),
    ],
)
def test_fit_rigid_refuses_what_has_no_answer(source: FloatArray, target: FloatArray, expected: str) -> None:
    """Too few points, points on one line and missing values are refused with the reason."""
    with pytest.raises(CalibrationError, match=expected):
        fit_rigid(source, target)
