"""The sharpness of pictures with a known blur."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edged.domain.arrays import FloatArray, Image
from edged.sim.cell import demo_part, demo_rig
from edged.sim.render.scene import PlacedPart, RenderedView, Scene, Sensor, Surface, Table
from edged.sim.stage import stage_board
from edged.vision.edges.params import SHARPNESS
from edged.vision.edges.sharpness import cost_of_spread, sharpness
from edged.vision.edges.subpixel import edges_at_widths

PIXEL_PX = 12.0**-0.5
"""Spread by the pixel's own area."""


def at(x: float, y: float, z: float, turn_rad: float = 0.0) -> FloatArray:
    """A pose turned about z."""
    pose = np.eye(4)
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    pose[:2, :2] = (c, -s), (s, c)
    pose[:3, 3] = x, y, z
    return pose


TABLE = Table(Surface(albedo=0.16, contrast=0.25, feature_mm=0.6, seed=2), at(8, 0, 215))
BOARD = Scene(TABLE, (PlacedPart(stage_board().part, at(-10, -14, 200, 0.3)),))
PART = Scene(TABLE, (PlacedPart(demo_part(), at(8, 0, 205)),))


@pytest.mark.slow
@pytest.mark.parametrize(
    "psf_px, off",
    [(0.4, 0.08), (0.6, 0.04), (0.9, 0.04), (1.4, 0.04), (2.4, 0.05)],
    ids=lambda value: f"{value:g}",
)
@pytest.mark.parametrize("scene", [BOARD, PART], ids=["board", "part"])
def test_the_spread_is_that_of_lens_and_pixel(psf_px: float, off: float, scene: Scene) -> None:
    """For a board and a textured part, bright, dark or noisy, the spread is right to 4 %, to 5 % far out
    of focus."""
    view = RenderedView(demo_rig().left, np.eye(4), Sensor(psf_sigma_px=psf_px))
    expected = math.hypot(psf_px, PIXEL_PX)
    for exposure_us, gain_db, noise_grey in ((2000.0, 0.0, 0.9), (700.0, 0.0, 0.6), (700.0, 10.0, 1.8)):
        image = view.render(scene, np.random.default_rng(1), exposure_us, gain_db)
        seen = sharpness(image, noise_grey)
        assert seen.spread_px == pytest.approx(expected, rel=off)
        assert seen.edges > 700


@pytest.mark.slow
def test_each_field_has_its_own_spread() -> None:
    """A lens that is sharp on the left and soft on the right gives two spreads; fields without edges have
    none."""
    views = [RenderedView(demo_rig().left, np.eye(4), Sensor(psf_sigma_px=psf)) for psf in (0.6, 1.4)]
    sharp, soft = (view.render(BOARD, np.random.default_rng(1)) for view in views)
    image = np.concatenate([sharp[:, :640], soft[:, 640:]], axis=1)
    fields = sharpness(image, 0.9).fields_px
    assert (6, 8) == fields.shape
    np.testing.assert_allclose(fields[2:4, 2], math.hypot(0.6, PIXEL_PX), rtol=0.1)
    np.testing.assert_allclose(fields[2:4, 5], math.hypot(1.4, PIXEL_PX), rtol=0.1)
    assert np.isnan(fields[5, 7])


@pytest.mark.parametrize("image", [np.zeros((60, 80), np.uint8), np.full((60, 80), 255, np.uint8)])
def test_a_picture_without_edges_has_no_spread(image: Image) -> None:
    """A dark or fully clipped picture has no edges and no spread."""
    seen = sharpness(image, 0.3)
    assert math.isnan(seen.spread_px)
    assert 0 == seen.edges


@pytest.mark.parametrize("psf_px", [0.9, 1.5])
def test_what_blur_costs_is_what_edges_scatter(psf_px: float) -> None:
    """The cost of blur equals the scatter of edges, at their best width, relative to a sharp picture, to
    10 %."""

    def scatter_px(spread_px: float) -> float:
        rng = np.random.default_rng(0)
        x = np.arange(64) - 31.5
        profile = 60.0 + 100.0 * np.array([0.5 * (1 + math.erf(v / spread_px / math.sqrt(2))) for v in x])
        image = np.rint(profile + rng.normal(0, 2.0, (4000, 64))).astype(np.uint8)
        rows = np.arange(4.0, 3990.0)
        points = np.stack([np.full(len(rows), 31.5), rows], axis=1)
        found = edges_at_widths(image, points, np.tile((1.0, 0.0), (len(rows), 1)), 3.0, 1)
        return float(np.nanstd(found.offset_px, axis=1).min())

    assert scatter_px(psf_px) / scatter_px(SHARPNESS.sharp_px) == pytest.approx(
        cost_of_spread(psf_px), rel=0.1
    )
