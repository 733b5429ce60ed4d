"""Contours: linked, split into the lines and arcs that were drawn; each kernel as its plain twin."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from helpers.cells import pictures, pose, scene, small_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from naive import edges as naive

from edged.domain.arrays import FloatArray, Image
from edged.sim.render.scene import Disc, Hole, Part, RoundedBox, Slot, Surface
from edged.vision.edges.contours import Contour, find_contours, link, misfit_px, pieces, ramer, split
from edged.vision.teaching.slots import fit_slot, slot_distance

BARE = Surface(albedo=0.6)
DARK = Surface(albedo=0.1)


@pytest.fixture(scope="module")
def picture() -> Image:
    """A plate with a slot and a hole, half turned, without texture."""
    part = Part(
        "plate",
        RoundedBox(0, 0, 24, 16),
        BARE,
        (Hole("slot", Slot(3, 2, 9, 4, 0.5)), Hole("d", Disc(-6, -3, 3))),
    )
    left, _ = pictures(small_rig(), scene((part, pose(turn_deg=25.0)), table=DARK))
    return left


def contours_of(picture: Image) -> list[Contour]:
    """All contours of a picture."""
    return find_contours(picture, np.full_like(picture, 255))


def test_each_outline_is_one_closed_contour(picture: Image) -> None:
    """The plate, the slot and the hole are one closed contour each, longest first, points in order,
    normals from dark to bright."""
    contours = contours_of(picture)
    assert len(contours) == 3
    assert all(contour.closed for contour in contours)
    plate = contours[0]
    assert np.linalg.norm(np.diff(plate.points, axis=0), axis=1).max() < 4.0
    inwards = np.sum(plate.normals * (plate.points.mean(axis=0) - plate.points), axis=1)
    assert (inwards > 0).all()


def test_an_outline_is_cut_into_what_was_drawn(picture: Image) -> None:
    """Four lines of the plate at right angles, two lines and two arcs of the slot, arcs of the hole."""
    plate, slot, hole = contours_of(picture)
    lines = split(plate)
    assert [piece.kind for piece in lines] == ["line"] * 4
    scale = small_rig().left.fx / 205.0
    lengths = sorted(piece.length_px for piece in lines)
    np.testing.assert_allclose(lengths, scale * np.array([16.0, 16.0, 24.0, 24.0]), rtol=0.03)
    angles = [math.atan2(*(piece.end - piece.start)[::-1]) for piece in lines]
    np.testing.assert_allclose(np.sin(2 * (np.array(angles) - angles[0])), 0.0, atol=0.01)
    kinds = [piece.kind for piece in split(slot)]
    assert kinds.count("line") == 2
    assert kinds.count("arc") >= 2
    rounds = split(hole)
    assert {piece.kind for piece in rounds} == {"arc"}
    assert all(piece.radius == pytest.approx(3.0 * scale, rel=0.03) for piece in rounds)


def test_pieces_of_an_empty_picture_are_none() -> None:
    """A blank picture and an empty region have no contours."""
    blank = np.full((80, 100), 90, np.uint8)
    assert list(pieces(contours_of(blank))) == []
    assert find_contours(blank, np.zeros_like(blank)) == []


@settings(max_examples=60)
@given(arrays.arrays(np.uint8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.integers(0, 1)))
def test_every_pixel_is_linked_once(thin: Image) -> None:
    """Chains hold every set pixel once, and neighbours in a chain are neighbours in the image."""
    pixels, starts, closed = link(thin)
    assert sorted(map(tuple, pixels.tolist())) == [tuple(place) for place in np.argwhere(thin).tolist()]
    assert starts[0] == 0
    assert starts[-1] == len(pixels)
    for first, last, loop in zip(starts[:-1], starts[1:], closed, strict=True):
        chain = pixels[first:last]
        assert (np.abs(np.diff(chain, axis=0)).max(axis=1, initial=1) <= 1).all()
        assert not loop or np.abs(chain[0] - chain[-1]).max() <= 1


@settings(max_examples=40)
@given(arrays.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 1)))
def test_linking_as_its_twin(thin: Image) -> None:
    """The kernel walks as the plain loop does."""
    pixels, starts, closed = link(thin)
    chains = [pixels[a:b].tolist() for a, b in itertools.pairwise(starts)]
    assert list(zip(chains, closed.tolist(), strict=True)) == naive.link(thin)


def random_walk(seed: int, count: int) -> FloatArray:
    """(N, 2) points of a chain."""
    return np.cumsum(np.random.default_rng(seed).normal(0, 1.5, (count, 2)), axis=0)


@given(st.integers(0, 1000), st.integers(2, 60), st.floats(0.1, 8.0))
def test_ramer_as_its_twin(seed: int, count: int, tolerance: float) -> None:
    """The kernel keeps the corners that the recursive definition keeps."""
    points = random_walk(seed, count)
    assert ramer(points, tolerance).tolist() == naive.ramer(points.tolist(), tolerance)


@given(st.integers(0, 1000), st.integers(3, 40))
def test_misfit_as_its_twin(seed: int, count: int) -> None:
    """The kernel's closed forms are those of singular values and of the normal equations."""
    points = random_walk(seed, count)
    assert misfit_px(points) == pytest.approx(naive.misfit(points), rel=1e-5)


def slot_outline(slot: FloatArray, count: int, noise: float) -> FloatArray:
    """Points (N, 2) near a slot: of a dense grid those on its outline."""
    rng = np.random.default_rng(0)
    scatter = rng.uniform(-8, 8, (60_000, 2)) + slot[:2]
    near = scatter[np.abs(slot_distance(scatter, slot)) < 0.02][:count]
    return np.asarray(near + rng.normal(0, noise, near.shape))


def test_a_slot_is_recognised() -> None:
    """From noisy points of its outline: place, angle, length and width to a hundredth."""
    slot = np.array([3.0, -2.0, 0.6, 9.0, 4.0])
    found = fit_slot(slot_outline(slot, 200, 0.01))
    assert found is not None
    np.testing.assert_allclose(np.delete(found, 2), np.delete(slot, 2), atol=0.01)
    assert math.sin(found[2] - slot[2]) == pytest.approx(0.0, abs=0.005)  # both ends look the same


def test_what_is_no_slot_is_none() -> None:
    """A circle, a rectangle, half a slot, a few points."""
    phase = np.linspace(0, 2 * np.pi, 200)
    circle = np.column_stack([np.cos(phase), np.sin(phase)])
    side = np.linspace(-1, 1, 60)
    box = np.concatenate([np.column_stack([3 * side, 0 * side + y]) for y in (-1.5, 1.5)])
    box = np.concatenate([box, *(np.column_stack([0 * side + x, 1.5 * side]) for x in (-3.0, 3.0))])
    slot = slot_outline(np.array([0.0, 0.0, 0.0, 9.0, 4.0]), 300, 0.005)
    assert fit_slot(circle) is None
    assert fit_slot(box) is None
    assert fit_slot(slot[slot[:, 0] > 0]) is None
    assert fit_slot(slot[:20]) is None
