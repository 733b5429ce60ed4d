"""Ellipses among edges: found where they are drawn, with their sign, and none where there is none."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import Image
from edged.vision.edges.ellipses import ImageEllipse, find_ellipses

SIZE = (220, 260)


def drawn(*ellipses: tuple[ImageEllipse, float], back: float = 60.0, noise: float = 2.0) -> Image:
    """Filled ellipses of a grey value each, later ones on top; 4x supersampled, blurred, with noise."""
    y, x = (np.mgrid[: 4 * SIZE[0], : 4 * SIZE[1]] + 0.5) / 4 - 0.5
    picture = np.full(x.shape, back, np.float32)
    for e, grey in ellipses:
        u = (x - e.x) * math.cos(e.angle) + (y - e.y) * math.sin(e.angle)
        v = (y - e.y) * math.cos(e.angle) - (x - e.x) * math.sin(e.angle)
        picture[(u / e.a) ** 2 + (v / e.b) ** 2 < 1] = grey
    small = cv2.resize(picture, (SIZE[1], SIZE[0]), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), 0.7)
    return np.clip(np.rint(blurred + np.random.default_rng(0).normal(0, noise, SIZE)), 0, 255).astype(
        np.uint8
    )


def everywhere() -> Image:
    """The mask of the whole image."""
    return np.full(SIZE, 255, np.uint8)


def assert_same(found: ImageEllipse, true: ImageEllipse) -> None:
    """Equal to half a pixel: it is a start for the fit in space."""
    assert math.hypot(found.x - true.x, found.y - true.y) < 0.5
    points, _ = true.outline(64)
    assert np.abs(found.distance(points)[0]).max() < 0.7


@pytest.mark.parametrize(("ratio", "angle"), [(1.0, 0.0), (0.9, 0.5), (0.75, -1.0)])
def test_a_disc_and_its_bore_are_found(ratio: float, angle: float) -> None:
    """Both outlines, the larger first; the disc is darker outside, the bore brighter."""
    disc = ImageEllipse(131.3, 108.7, 90.0, 90.0 * ratio, angle, -1)
    bore = ImageEllipse(128.0, 110.2, 28.0, 28.0 * ratio, angle, 1)
    found = find_ellipses(drawn((disc, 170.0), (bore, 40.0)), everywhere())
    assert [e.polarity for e in found] == [-1, 1]
    assert_same(found[0], disc)
    assert_same(found[1], bore)


def test_a_bore_with_a_keyway_is_still_a_circle() -> None:
    """A bore that lacks a part of its circumference is still found as a circle."""
    disc = ImageEllipse(130.0, 110.0, 90.0, 90.0, 0.0, -1)
    bore = ImageEllipse(130.0, 110.0, 30.0, 30.0, 0.0, 1)
    slot = ImageEllipse(163.0, 110.0, 16.0, 13.0, 0.0, 1)
    found = find_ellipses(drawn((disc, 170.0), (bore, 40.0), (slot, 40.0)), everywhere())
    assert_same(found[0], disc)
    assert any(abs(e.a - 30) < 0.7 and math.hypot(e.x - 130, e.y - 110) < 0.7 for e in found)


def test_only_what_the_mask_holds() -> None:
    """Edges outside of the mask are not looked at."""
    left = ImageEllipse(70.0, 110.0, 40.0, 40.0, 0.0, -1)
    right = ImageEllipse(190.0, 110.0, 40.0, 40.0, 0.0, -1)
    image, mask = drawn((left, 170.0), (right, 170.0)), everywhere()
    mask[:, 130:] = 0
    found = find_ellipses(image, mask)
    assert len(found) == 1
    assert_same(found[0], left)


def test_what_is_no_circle_is_not_taken_for_one() -> None:
    """A square, a triangle, noise, one grey or half a disc gives no ellipse."""
    square = drawn()
    square[60:160, 80:180] = 170
    triangle = drawn()
    cv2.fillPoly(triangle, [np.array([[60, 180], [200, 180], [130, 50]])], (170.0,))
    half = drawn((ImageEllipse(130.0, 110.0, 80.0, 80.0, 0.0, -1), 170.0))
    half[:, 130:] = 60
    noise = drawn(noise=8.0)
    for image in (square, triangle, half, noise, np.full(SIZE, 90, np.uint8), np.zeros(SIZE, np.uint8)):
        assert find_ellipses(image, everywhere()) == []
    assert find_ellipses(square, np.zeros(SIZE, np.uint8)) == []


def test_the_same_image_gives_the_same_ellipses() -> None:
    """The same image gives the same ellipses, because the random trials are always the same."""
    image = drawn((ImageEllipse(130.0, 110.0, 60.0, 50.0, 0.3, -1), 170.0))
    assert find_ellipses(image, everywhere()) == find_ellipses(image, everywhere())


@settings(max_examples=50)
@given(
    a=st.floats(10, 200),
    ratio=st.floats(0.7, 1.0),
    angle=st.floats(-math.pi, math.pi),
    off_px=st.floats(-0.5, 0.5),
)
def test_distance_is_measured_from_the_outline(a: float, ratio: float, angle: float, off_px: float) -> None:
    """The outline has distance 0; beside it, along its normals, the distance is the step taken."""
    ellipse = ImageEllipse(12.0, -7.0, a, a * ratio, angle, 1)
    points, normals = ellipse.outline(40)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-12)
    assert np.abs(ellipse.distance(points)[0]).max() < 1e-9 * a
    np.testing.assert_allclose(ellipse.distance(points + off_px * normals)[0], off_px, atol=0.04)
    assert (np.sum(normals * (points - (12.0, -7.0)), axis=1) > 0).all()
