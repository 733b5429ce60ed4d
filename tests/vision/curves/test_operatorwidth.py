"""The operator width that suits the image is chosen for a curve, and its shifts are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.adjustments import ChosenEdges, choose_widths
from naive import curves as naive

from edged.domain.arrays import FloatArray, Image
from edged.vision.curves.operatorwidth import variance_of_mean
from edged.vision.edges.subpixel import WIDTHS_PX, EdgeSamples, edges_at_widths

SIZE = 200
CENTRE = (SIZE - 1) / 2
RADIUS = 70.0
BLUR_PX = 0.7


def circle(count: int = 440) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (N, 2) and outward normals of a circle, and Fourier waves around it."""
    angle = np.arange(count) * (2 * np.pi / count)
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    rest = [math.sqrt(2) * f(m * angle) for m in (1, 2) for f in (np.cos, np.sin)]
    return CENTRE + RADIUS * normals, normals, np.column_stack([np.ones(count), *rest])


def disc_image(*steps: tuple[float, float], noise: float = 0.0, seed: int = 0) -> Image:
    """Concentric steps (radius, height) on a grey ground, blurred."""
    y, x = np.mgrid[:SIZE, :SIZE] - CENTRE
    distance = np.hypot(x, y)
    erf = np.vectorize(math.erf)
    grey = 160.0 + sum(
        height * 0.5 * (1 + erf((distance - radius) / (BLUR_PX * math.sqrt(2)))) for radius, height in steps
    )
    grey = grey + np.random.default_rng(seed).normal(0, noise, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def chosen(image: Image, min_slope: float = 1.5) -> tuple[ChosenEdges, EdgeSamples]:
    """The chosen edges of the circle."""
    points, normals, waves = circle()
    seen = edges_at_widths(image, points, normals, 3.0, -1)
    return choose_widths(seen, np.array([0, len(points)]), waves, min_slope), seen


def picked(edges: ChosenEdges, seen: EdgeSamples) -> int:
    """Index of the chosen width."""
    known = edges.base > 0
    return int(np.argmin([np.abs(offset[known] - edges.offset_px[known]).max() for offset in seen.offset_px]))


@pytest.mark.parametrize("seed", range(4))
def test_variance_equals_its_twin(seed: int) -> None:
    """White and correlated samples with gaps and outliers, from scratch and from shares of before."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(40, 300))
    waves = circle(count)[2]
    base = np.where(rng.random(count) < 0.2, 0.0, 1.0)
    rough = rng.normal(0, 0.1, count) + waves @ rng.normal(0, 0.1, 5) + 2.0 * (rng.random(count) < 0.05)
    for values in (rough, np.convolve(np.tile(rough, 2), np.ones(5), "same")[:count]):
        shares, expected_shares = np.ones(count), np.ones(count)
        for rounds in (3, 1):
            result = variance_of_mean(values, base, waves.T.copy(), rounds, shares)
            *expected, expected_shares = naive.variance_of_mean(values, base, waves, rounds, expected_shares)
            assert result == pytest.approx(tuple(expected))
            np.testing.assert_allclose(shares, expected_shares, atol=1e-9)
    few = np.zeros(count)
    few[:11] = 1.0
    assert variance_of_mean(rough, few, waves.T.copy(), 3, np.ones(count)) == (math.inf, 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_kernels_equal_their_twins(seed: int) -> None:
    """Two curves with gaps, clipping and weak stretches: width, weights, bias and blur are the twin's."""
    rng = np.random.default_rng(seed)
    counts = (150, 64)
    starts = np.array([0, 150, 214])
    angle = np.concatenate([np.arange(count) * (2 * np.pi / count) for count in counts])
    waves = np.column_stack(
        [np.ones(len(angle)), *(math.sqrt(2) * f(m * angle) for m in (1, 2) for f in (np.cos, np.sin))]
    )
    scatter = np.array([0.08, 0.06, 0.05, 0.07])[rng.permutation(4)][:, None]
    offset = rng.normal(0, 1, (4, len(angle))) * scatter + waves @ rng.normal(0, 0.03, 5)
    offset[1:] += rng.normal(0, 0.05, (3, 1)) * np.cos(angle)
    slope = np.array([60.0, 50.0, 40.0, 30.0])[:, None] * rng.uniform(0.1, 1.0, len(angle))
    offset[:, rng.random(len(angle)) < 0.1] = np.nan
    slope[np.isnan(offset)] = np.nan
    seen = EdgeSamples(offset, slope, rng.random(len(angle)) < 0.1)
    result = choose_widths(seen, starts, waves, 8.0)
    for k in range(2):
        rows = slice(starts[k], starts[k + 1])
        best, base, bias, blur2 = naive.choose_width(
            offset[:, rows], slope[:, rows], seen.clipped[rows], waves[rows], 8.0, WIDTHS_PX
        )
        np.testing.assert_allclose(result.base[rows], base, atol=1e-12)
        known = base > 0
        np.testing.assert_array_equal(result.offset_px[rows][known], offset[best, rows][known])
        assert np.isnan(result.offset_px[rows][~known]).all()
        assert result.bias_px[k] == pytest.approx(bias)
        assert result.blur2_px2[k] == pytest.approx(blur2)


def test_one_width_is_taken_as_it_is() -> None:
    """With a single width there is no bias and no blur."""
    points, normals, waves = circle()
    seen = edges_at_widths(disc_image((RADIUS, -100.0)), points, normals, 3.0, -1, [1.2])
    edges = choose_widths(seen, np.array([0, len(points)]), waves, 1.5)
    np.testing.assert_array_equal(edges.offset_px, seen.offset_px[0])
    assert edges.bias_px.tolist() == [0.0]
    assert edges.blur2_px2.tolist() == [0.0]


def test_noise_asks_for_a_wide_operator() -> None:
    """In white noise one of the two widths near sqrt(5) x blur is chosen, with hardly any bias."""
    for seed in range(5):
        edges, seen = chosen(disc_image((RADIUS, -100.0), noise=6.0, seed=seed))
        assert picked(edges, seen) in (2, 3)
        assert edges.bias_px[0] < 0.03


def test_a_second_edge_asks_for_a_narrow_operator() -> None:
    """A chamfer's edge 2.5 px outside: the narrowest width is taken, and its bias is stated."""
    edges, seen = chosen(disc_image((RADIUS, -60.0), (RADIUS + 2.5, -45.0), noise=1.0))
    assert picked(edges, seen) == 0
    error = abs(float(np.nanmedian(edges.offset_px)))
    assert error < 0.5 * abs(float(np.nanmedian(seen.offset_px[2])))
    assert edges.bias_px[0] > 0.5 * error


def test_the_blur_is_that_of_the_image() -> None:
    """From the slopes at two widths, to 10 % in sigma."""
    edges, _ = chosen(disc_image((RADIUS, -100.0), noise=1.0))
    assert math.sqrt(edges.blur2_px2[0]) == pytest.approx(BLUR_PX, rel=0.1)


def test_weak_edges_weigh_less() -> None:
    """A stretch with a fifth of the contrast has the weight 1/25."""
    points, normals, waves = circle()
    seen = edges_at_widths(disc_image((RADIUS, -100.0)), points, normals, 3.0, -1)
    seen.slope[:, 100:150] *= 0.2
    edges = choose_widths(seen, np.array([0, len(points)]), waves, 1.5)
    np.testing.assert_allclose(edges.base[110:140], 0.04, atol=0.003)
    assert np.median(edges.base) > 0.95


def test_nothing_seen_is_nothing_chosen() -> None:
    """On a blank image there is no edge, no weight and no exception."""
    edges, _ = chosen(np.full((SIZE, SIZE), 90, np.uint8))
    assert np.isnan(edges.offset_px).all()
    assert not edges.base.any()
    assert edges.blur2_px2.tolist() == [0.0]
