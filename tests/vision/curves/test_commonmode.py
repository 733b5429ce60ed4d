"""Pairs of edges: mean and difference of both cameras, from which each can be recovered."""

from __future__ import annotations

import numpy as np
import pytest

from edged.domain.arrays import FloatArray
from edged.vision.curves.commonmode import Pairs, by_camera, pair

STARTS = np.array([0, 400, 640])


def edges(seed: int, of_left: float, of_right: float, common: float) -> tuple[FloatArray, FloatArray]:
    """Offsets (2, 640) of two curves, in px, and their gain: scatter of each camera, and one in space."""
    rng = np.random.default_rng(seed)
    gain = np.stack([12.0 + np.sin(np.arange(640) / 40), 9.0 + np.cos(np.arange(640) / 50)])
    space = rng.normal(0, common, 640)
    scatter = np.stack([rng.normal(0, of_left, 640), rng.normal(0, of_right, 640)])
    return gain, (space + scatter) * gain


def paired(seed: int = 0, of_left: float = 0.01, of_right: float = 0.01, common: float = 0.01) -> Pairs:
    """Two curves with all edges seen by both cameras."""
    gain, offset = edges(seed, of_left, of_right, common)
    return pair(offset, np.ones((2, 640)), gain, STARTS, True)


def test_there_and_back() -> None:
    """The offsets of each camera are recovered from the rows, for pairs and single edges."""
    gain, offset = edges(1, 0.01, 0.02, 0.01)
    base = np.ones((2, 640))
    base[0, 50:100] = base[1, 200:260] = 0.0
    pairs = pair(offset, base, gain, STARTS, True)
    assert pairs.paired.all()
    assert list(pairs.parts) == [0, 4, 6]
    back, weights = np.empty((2, *base.shape))
    by_camera(pairs, pairs.rows_of(*offset), pairs.base, back, weights)
    np.testing.assert_allclose(back[base > 0], offset[base > 0])
    assert (weights > 0)[base > 0].all()
    assert not weights[base == 0].any()


@pytest.mark.parametrize(("of_left", "of_right"), [(0.01, 0.01), (0.01, 0.02), (0.02, 0.01)])
def test_mean_and_difference_are_independent(of_left: float, of_right: float) -> None:
    """For any scatter of the cameras and in common, mean and difference are uncorrelated."""
    together = []
    for seed in range(40):
        gain, offset = edges(seed, of_left, of_right, 0.015)
        pairs = pair(offset, np.ones((2, 640)), gain, STARTS, True)
        means, differences = pairs.rows_of(*offset)[:800].reshape(2, 400)
        together.append(np.corrcoef(means, differences)[0, 1])
        assert pairs.share[0] == pytest.approx(of_right**2 / (of_left**2 + of_right**2), abs=0.25)
    assert abs(np.mean(together)) < 4 / np.sqrt(40 * 400)
    assert np.std(together) < 0.12


def test_what_moves_in_space_is_no_difference() -> None:
    """A displacement of the curve moves the mean as much, and the difference not at all."""
    pairs = paired()
    rows = pairs.rows_of(*pairs.gain)
    scale = pairs.gain.mean(axis=0)
    np.testing.assert_allclose(rows[:400], scale[:400])
    np.testing.assert_allclose(rows[400:800], 0.0, atol=1e-12)


def test_a_spoilt_edge_is_not_paired() -> None:
    """An edge that is bad in one image is not paired; too few edges make no part."""
    gain, offset = edges(2, 0.01, 0.01, 0.01)
    base = np.ones((2, 640))
    base[1, :400] = 0.02
    base[:, 408:] = 0.0
    pairs = pair(offset, base, gain, STARTS, True)
    assert not pairs.both[:400].any()
    assert list(pairs.parts) == [0, 2, 2]
    assert not pairs.paired.any()
    assert list(pairs.base[[0, 400]]) == [1.0, 0.02]


def test_what_is_not_in_place_is_not_paired() -> None:
    """Curves that still move keep the edges of each camera; if nothing is seen, there is no row."""
    gain, offset = edges(3, 0.01, 0.01, 0.01)
    apart = pair(offset, np.ones((2, 640)), gain, STARTS, False)
    np.testing.assert_array_equal(
        apart.rows_of(*offset), np.concatenate([offset[:, :400].ravel(), offset[:, 400:].ravel()])
    )
    nothing = pair(np.full((2, 640), np.nan), np.zeros((2, 640)), gain, STARTS, True)
    assert list(nothing.parts) == [0, 0, 0]
    assert nothing.rows_of(*offset).shape == (0,)
