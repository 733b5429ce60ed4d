"""Edges across given points: their places, the choice among several, and NaN where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import edges as naive

from edged.domain.arrays import FloatArray, Image
from edged.vision.edges.params import EDGE
from edged.vision.edges.subpixel import edge_profiles, edges_along_normals, edges_at_widths

SIZE = (64, 80)  # rows, columns
MIDDLE = np.array([39.0, 31.0])

_erf = np.vectorize(math.erf)


def step_image(
    distance_px: float, angle_rad: float = 0.0, blur_px: float = 0.8, low: float = 40.0, high: float = 200.0
) -> FloatArray:
    """A blurred straight edge, brighter along (cos, sin), this far from MIDDLE; grey values, not rounded."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    along = (x - MIDDLE[0]) * np.cos(angle_rad) + (y - MIDDLE[1]) * np.sin(angle_rad) - distance_px
    return np.asarray(low + (high - low) * 0.5 * (1 + _erf(along / (math.sqrt(2) * blur_px))))


def exposed(view: FloatArray, noise: float = 0.0, seed: int = 0) -> Image:
    """The view with white noise, in 8 bits."""
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(view + rng.normal(0, 1, view.shape) * noise), 0, 255).astype(np.uint8)


def across(angle_rad: float, count: int = 9) -> tuple[FloatArray, FloatArray]:
    """Points on a line along the edge through MIDDLE, 1.3 px apart, and the direction across it."""
    normal = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    steps = 1.3 * (np.arange(count) - count // 2)
    return MIDDLE + steps[:, None] * np.array([-normal[1], normal[0]]), np.tile(normal, (count, 1))


@settings(max_examples=60)
@given(
    distance_px=st.floats(-2.5, 2.5),
    angle_rad=st.floats(-math.pi, math.pi),
    blur_px=st.floats(0.75, 1.2),
)
def test_a_blurred_step_is_found_where_it_is(distance_px: float, angle_rad: float, blur_px: float) -> None:
    """At any sub-pixel place, direction and blur of a lens, each offset is right to 0.02 px when finely
    sampled; to 0.035 px, and 0.02 px on the average along the edge, when coarsely."""
    points, normals = across(angle_rad)
    image = exposed(step_image(distance_px, angle_rad, blur_px))
    fine = edges_at_widths(image, points, normals, 4.0, 1, [EDGE.sigma_px])
    assert np.abs(fine.offset_px - distance_px).max() < 0.02
    coarse, slope = edges_along_normals(image, points, normals, 4.0, 1)
    assert np.abs(coarse - distance_px).max() < 0.035
    assert abs(np.mean(coarse) - distance_px) < 0.02
    # the operator and the blur together are one Gaussian: its peak times the step
    expected = 160 / math.sqrt(2 * math.pi * (blur_px**2 + EDGE.sigma_px**2))
    np.testing.assert_allclose(slope, expected, rtol=0.03)
    np.testing.assert_allclose(fine.slope[0], expected, rtol=0.03)


@pytest.mark.parametrize(("width", "limit_px"), [(0, 0.05), (1, 0.03), (2, 0.02), (3, 0.015)])
def test_every_width_finds_the_same_place(width: int, limit_px: float) -> None:
    """A single edge is at the same place for all operators; narrow ones have an interpolation error."""
    points, normals = across(0.4)
    for distance in (-1.7, -0.25, 0.0, 0.5, 1.33):
        image = exposed(step_image(distance, 0.4))
        seen = edges_at_widths(image, points, normals, 3.0, 1)
        assert np.abs(seen.offset_px[width] - distance).max() < limit_px
        assert not seen.clipped.any()


def test_the_precision_is_near_the_bound() -> None:
    """In white noise the scatter is at most 1.3 times Cramér-Rao's bound, at the operator's own blur.

    Bound for the place of one straight edge, per px of its length: sigma² 2 sqrt(pi) blur / step²
    (sampled finely against the blur); neighbours 8 px apart share no pixel of the operator.
    """
    blur, noise, contrast = 0.55, 6.0, 160.0
    normals = np.tile([1.0, 0.0], (6, 1))
    points = np.column_stack([np.full(6, MIDDLE[0]), 10.0 + 8 * np.arange(6)])
    found = [
        edges_along_normals(exposed(step_image(0.3, 0.0, blur), noise, seed), points, normals, 3.0, 1)[0]
        for seed in range(60)
    ]
    scatter = float(np.std(found))
    bound = noise / contrast * math.sqrt(2 * math.sqrt(math.pi) * blur)
    assert bound < scatter < 1.3 * bound


def test_the_sign_is_obeyed() -> None:
    """A step is found with its own sign or with 0, not with the other sign; a reversed normal reverses
    both."""
    points, normals = across(0.0)
    rising = exposed(step_image(0.6))
    right, slope = edges_along_normals(rising, points, normals, 4.0, 1)
    wrong, _ = edges_along_normals(rising, points, normals, 4.0, -1)
    either, _ = edges_along_normals(rising, points, normals, 4.0, 0)
    assert (slope > 0).all()
    assert np.array_equal(right, either)
    assert np.isnan(wrong).all()
    back, back_slope = edges_along_normals(rising, points, -normals, 4.0, -1)
    np.testing.assert_allclose(back, -right, atol=1e-6)
    np.testing.assert_allclose(back_slope, -slope, rtol=1e-6)
    each = np.where(np.arange(len(points)) % 2, 1, -1)
    mixed = edges_at_widths(rising, points, normals, 4.0, each, [1.2]).offset_px[0]
    assert np.array_equal(np.isnan(mixed), each < 0)


def test_of_two_equal_edges_the_nearer_is_taken() -> None:
    """Of two equal edges 7 px apart the one nearer to the point is found."""
    points, normals = across(0.0)
    nearer = points + np.array([3.5, 0.0])
    twice = exposed(0.5 * (step_image(-2.0) + step_image(5.0)))
    assert np.abs(edges_along_normals(twice, points, normals, 6.0, 1)[0] + 2.0).max() < 0.05
    assert np.abs(edges_along_normals(twice, nearer, normals, 6.0, 1)[0] - 1.5).max() < 0.05


def test_no_edge_is_nan() -> None:
    """Flat grey, beyond the reach, over the border, points and normals that are no numbers: all NaN."""
    points, normals = across(0.0)
    flat = np.full(SIZE, 90, np.uint8)
    assert np.isnan(edges_along_normals(flat, points, normals, 4.0, 0)[0]).all()
    far = exposed(step_image(9.0))
    assert np.isnan(edges_along_normals(far, points, normals, 3.0, 1)[0]).all()
    image = exposed(step_image(0.0))
    for place in [(2.0, 30.0), (77.5, 30.0), (-1e9, 1e9), (np.nan, 30.0), (np.inf, 30.0), (1e300, 0.0)]:
        offset, slope = edges_along_normals(image, np.array([place]), normals[:1], 3.0, 0)
        assert np.isnan([offset[0], slope[0]]).all()
    assert np.isnan(edges_along_normals(image, points, np.full_like(normals, np.nan), 3.0, 0)[0]).all()
    none = np.zeros((0, 2))
    assert edges_along_normals(image, none, none, 3.0, 0)[0].shape == (0,)
    tiny = np.zeros((1, 1), np.uint8)
    assert np.isnan(edges_along_normals(tiny, points, normals, 3.0, 0)[0]).all()


def test_views_and_read_only_images_are_taken() -> None:
    """A crop, a transposed and a read-only image give the same edges."""
    points, normals = across(0.0)
    wide = exposed(np.hstack([step_image(0.4), step_image(0.4)]))
    expected, _ = edges_along_normals(wide[:, : SIZE[1]].copy(), points, normals, 3.0, 1)
    frozen = wide[:, : SIZE[1]].copy()
    frozen.flags.writeable = False
    for image in (wide[:, : SIZE[1]], np.asfortranarray(frozen), frozen):
        assert np.array_equal(edges_along_normals(image, points, normals, 3.0, 1)[0], expected)
    one_normal = np.broadcast_to(normals[0], normals.shape)
    assert np.array_equal(edges_along_normals(frozen, points, one_normal, 3.0, 1)[0], expected)


def test_a_saturated_plateau_is_noted() -> None:
    """The sample is marked as clipped if the sensor saturates on either side of the edge, otherwise not."""
    points, normals = across(0.0)
    assert edges_at_widths(exposed(step_image(0.0, high=300.0)), points, normals, 3.0, 1).clipped.all()
    assert edges_at_widths(exposed(step_image(0.0, low=-40.0)), points, normals, 3.0, 1).clipped.all()
    assert not edges_at_widths(exposed(step_image(0.0)), points, normals, 3.0, 1).clipped.any()


def test_profiles_are_what_lies_across() -> None:
    """The profile of a ramp equals the ramp; one that leaves the image is NaN."""
    ramp = np.tile(np.arange(SIZE[1], dtype=np.uint8) * 2, (SIZE[0], 1))
    values, places = edge_profiles(ramp, MIDDLE[None], np.array([[1.0, 0.0]]), 4.0)
    np.testing.assert_allclose(values[0], 2 * (MIDDLE[0] + places), atol=1e-4)
    assert places[0] == -4.0
    assert places[-1] == 4.0
    outside, _ = edge_profiles(ramp, np.array([[2.0, 30.0]]), np.array([[1.0, 0.0]]), 4.0)
    assert np.isnan(outside).all()


@pytest.mark.parametrize("polarity", [-1, 0, 1])
@pytest.mark.parametrize(("width_px", "step_px"), [(0.6, 0.5), (1.2, 1.0), (1.7, 1.0)])
def test_the_kernel_equals_its_twin(polarity: int, width_px: float, step_px: float) -> None:
    """On random texture with clipped patches, kernel and plain loops agree on every point."""
    rng = np.random.default_rng(7)
    image = np.clip(rng.normal(128, 90, (30, 34)), 0, 255).astype(np.uint8)
    points = rng.uniform((0, 0), (33, 29), (14, 2))
    angles = rng.uniform(-np.pi, np.pi, 14)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    offset, slope = edges_along_normals(image, points, normals, 2.0, polarity, width_px)
    for n, (point, normal) in enumerate(zip(points, normals, strict=True)):
        expected = naive.edge_along_normal(image, point, normal, 2.0, polarity, width_px, step_px)
        np.testing.assert_allclose([offset[n], slope[n]], expected[:2], rtol=1e-6, atol=1e-5)
    assert 2 <= np.isfinite(offset).sum() < 14


def test_points_do_not_know_of_each_other() -> None:
    """A point's edge does not depend on the other points of the call."""
    rng = np.random.default_rng(11)
    image = np.clip(rng.normal(128, 60, (90, 90)), 0, 255).astype(np.uint8)
    points, angles = rng.uniform(0, 89, (300, 2)), rng.uniform(-np.pi, np.pi, 300)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    signs = rng.integers(-1, 2, 300)
    together = edges_at_widths(image, points, normals, 3.0, signs)
    for part in (slice(0, 1), slice(1, 120), slice(120, 300)):
        alone = edges_at_widths(image, points[part], normals[part], 3.0, signs[part])
        assert np.array_equal(alone.offset_px, together.offset_px[:, part], equal_nan=True)
        assert np.array_equal(alone.slope, together.slope[:, part], equal_nan=True)
        assert np.array_equal(alone.clipped, together.clipped[part])
    assert 100 < np.isfinite(together.offset_px[2]).sum() < 300


def test_clipping_equals_its_twin() -> None:
    """Kernel and plain loops agree on which samples clip, in an image where some do and some do not."""
    rng = np.random.default_rng(3)
    image = np.clip(rng.normal(128, 75, (36, 36)), 0, 255).astype(np.uint8)
    points = rng.uniform(10, 25, (20, 2))
    angles = rng.uniform(-np.pi, np.pi, 20)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    seen = edges_at_widths(image, points, normals, 2.0, 0, [0.85])
    expected = [
        naive.edge_along_normal(image, p, n, 2.0, 0, 0.85, 0.5) for p, n in zip(points, normals, strict=True)
    ]
    assert [clipped for *_, clipped in expected] == seen.clipped.tolist()
    assert 0 < seen.clipped.sum() < 20
