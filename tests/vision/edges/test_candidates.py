"""All edges across samples of a curve, among which a part's pose chooses."""

from __future__ import annotations

import numpy as np
from naive import edges as naive

from edged.domain.arrays import FloatArray
from edged.vision.edges.candidates import MOST, STEP_PX, candidates
from edged.vision.edges.subpixel import edge_profiles

TURN = np.linspace(0, 2 * np.pi, 40, endpoint=False)
NORMALS = np.column_stack([np.cos(TURN), np.sin(TURN)])
STARTS = np.array([0, len(TURN)])


def ring(radius_px: float) -> FloatArray:
    """Samples of a circle about the middle of the pictures."""
    return np.array([50.0, 40.0]) + radius_px * NORMALS


def test_both_edges_of_a_groove_are_candidates() -> None:
    """A dark groove from 19 to 22 px about the middle: across 20 px one edge falls, one rises, 3 px apart."""
    y, x = np.mgrid[:80, :100].astype(float)
    away = np.hypot(x - 50, y - 40)
    image = np.rint(160 - 100 / (1 + np.exp(-3 * (away - 19))) / (1 + np.exp(3 * (away - 22)))).astype(
        np.uint8
    )
    found = candidates(image, ring(20.0), NORMALS, STARTS, 4.0, 1)
    order = np.argsort(found.offset_px, axis=1)
    offsets = np.take_along_axis(found.offset_px, order, axis=1)
    slopes = np.take_along_axis(found.slope, order, axis=1)
    np.testing.assert_allclose(offsets[:, :2], np.tile([-1.0, 2.0], (len(TURN), 1)), atol=0.25)
    assert (slopes[:, 0] < 0).all()
    assert (slopes[:, 1] > 0).all()
    assert np.isnan(offsets[:, 2:]).all()


def test_the_kernel_equals_its_twin() -> None:
    """On noise, with samples that leave the picture, kernel and plain loops find the same edges."""
    image = np.random.default_rng(3).integers(0, 255, (80, 100)).astype(np.uint8)
    for reach_px, together in ((2.0, 4), (3.0, 1), (2.5, 3)):
        pixels = ring(37.0)
        found = candidates(image, pixels, NORMALS, STARTS, reach_px, together)
        profiles, _ = edge_profiles(image, pixels, NORMALS, reach_px + 3.5, STEP_PX)
        twin = naive.all_edges(profiles, together, round(reach_px / STEP_PX), STEP_PX)
        expected = np.full((2, len(TURN), MOST), np.nan)
        for n, edges in enumerate(twin):
            expected[:, n, : len(edges)] = np.array(edges).reshape(-1, 2).T
        assert 0 < np.isnan(expected[0, :, 0]).sum() < len(TURN)
        np.testing.assert_allclose(found.offset_px, expected[0], atol=1e-9)
        np.testing.assert_allclose(np.nan_to_num(found.slope), np.nan_to_num(expected[1]), atol=1e-9)
