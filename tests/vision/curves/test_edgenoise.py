"""Noise of edges from picture to picture: its variance per px of arc, apart from constant shifts."""

from __future__ import annotations

import numpy as np
import pytest

from edged.domain.arrays import FloatArray
from edged.vision.curves.edgenoise import Sighting, edge_noise

COUNT, PICTURES, SIGMA_PX = 300, 40, 0.06


def sighting(noise_px: FloatArray, spacing_px: float) -> Sighting:
    """A circle whose edges have a constant shift and noise (2, N); one edge is not seen."""
    phase = 2 * np.pi * np.arange(COUNT) / COUNT
    out = np.column_stack([np.cos(phase), np.sin(phase)])
    radius = COUNT * spacing_px / (2 * np.pi) + 0.2 * np.sin(5 * phase)
    points = (radius + noise_px)[..., None] * out
    points[:, 17] = np.nan
    return points, np.ones((2, COUNT))


@pytest.mark.parametrize("together", [1, 3])
@pytest.mark.parametrize("spacing_px", [1.0, 2.0])
def test_it_is_the_variance_of_a_pixel_of_arc(spacing_px: float, together: int) -> None:
    """The variance is right for independent samples and for means of neighbours."""
    rng = np.random.default_rng(3)
    kernel = np.ones(together) / together
    seen = []
    for _ in range(PICTURES):
        noise = rng.normal(0, SIGMA_PX, (2, COUNT + together - 1))
        noise[1] *= 2
        seen.append(sighting(np.array([np.convolve(one, kernel, "valid") for one in noise]), spacing_px))
    found = edge_noise(seen)
    assert found is not None
    assert found[0] == pytest.approx(SIGMA_PX**2 * spacing_px, rel=0.15)
    assert found[1] == pytest.approx(4 * SIGMA_PX**2 * spacing_px, rel=0.15)


def test_too_little_tells_nothing() -> None:
    """Two pictures, differently sampled curves, or edges of little weight give no noise."""
    still = np.zeros((2, COUNT))
    one = sighting(still, 1.0)
    assert edge_noise([one] * 2) is None
    assert edge_noise([(one[0][:, :n], one[1][:, :n]) for n in (100, 101, 102)]) is None
    assert edge_noise([(one[0], 0.05 * one[1])] * 5) is None
    assert edge_noise([one] * 5) == pytest.approx((0.0, 0.0), abs=1e-20)
