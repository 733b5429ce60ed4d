"""A long and a short exposure as one picture: no false edge at the seam, and movement is seen."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray, Image
from edged.pictures.twoexposures import FADES, WHITE, merge_exposures

BLACK, PER_GREY = 3.0, 12_000.0 / 255


def light(*, moved_px: float = 0.0) -> FloatArray:
    """Discs that glint on a dark table, in grey values of a long exposure, up to seven times white."""
    y, x = np.mgrid[0:480, 0:640].astype(float)
    seen = 30 + 20 * np.sin(x / 50)
    for at_x, at_y, radius, grey in (
        (150, 150, 60, 900), (400, 260, 120, 120), (450, 280, 40, 1700), (560, 90, 40, 60),
    ):  # fmt: skip
        inside = 0.5 * (1 + np.tanh((radius - np.hypot(x - at_x - moved_px, y - at_y)) / 0.9))
        seen = seen * (1 - inside) + grey * inside
    return np.asarray(seen)


def exposed(seen: FloatArray, share: float, seed: int = 0) -> Image:
    """A picture with shot and read noise and a black level."""
    electrons = seen * share * PER_GREY
    noise = np.random.default_rng(seed).standard_normal(seen.shape) * np.sqrt(electrons + 144)
    return np.clip(np.rint((electrons + noise) / PER_GREY + BLACK), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("ratio", [4.0, 8.0, 16.0])
def test_a_pair_that_lies_still_has_its_ratio_and_no_movement(ratio: float) -> None:
    """For a still pair the ratio is the exposures', whatever the black level, and no movement is found."""
    merged = merge_exposures(exposed(light(), 1.0), exposed(light(), 1 / ratio, 1), ratio)

    assert pytest.approx(ratio, rel=0.02) == merged.ratio
    assert merged.moved_px < 0.5


@pytest.mark.parametrize(("moved_px", "least"), [(1.0, 1.0), (3.0, 2.0), (10.0, 10.0), (60.0, 60.0)])
@pytest.mark.parametrize("ratio", [4.0, 8.0, 16.0])
def test_what_moves_by_a_pixel_or_more_is_seen(moved_px: float, least: float, ratio: float) -> None:
    """A movement of a pixel or more is measured, or infinite if the edges differ."""
    merged = merge_exposures(exposed(light(), 1.0), exposed(light(moved_px=moved_px), 1 / ratio, 1), ratio)
    assert least <= merged.moved_px


def test_a_flickering_lamp_gives_the_true_ratio_and_no_seam() -> None:
    """With 15 % more light in the short exposure the ratio is the true one, and the picture the same to
    two grey values."""
    still = merge_exposures(exposed(light(), 1.0), exposed(light(), 1 / 8, 1), 8.0)
    lit = merge_exposures(exposed(light(), 1.0), exposed(1.15 * light(), 1 / 8, 1), 8.0)

    assert pytest.approx(8.0 / 1.15, rel=0.02) == lit.ratio
    assert lit.moved_px < 0.6
    # its white is at less light: compared below that
    below = light() < 600
    assert np.median(np.abs(still.image[below].astype(int) - lit.image[below])) <= 2


def test_below_the_fade_it_is_half_the_long_exposure() -> None:
    """Below the fade the picture is half the long exposure, so its edges stay in place."""
    long = exposed(light(), 1.0)
    merged = merge_exposures(long, exposed(light(), 1 / 8, 1), 8.0).image
    dark = light() < FADES - 30

    assert np.abs(merged[dark] - long[dark] / 2.0).mean() < 1.0


def test_only_what_the_short_exposure_too_shows_white_is_white() -> None:
    """Exactly the pixels that are white in the short exposure, too, are white."""
    seen = light()
    seen[:50, :50] = 5000.0
    short = exposed(seen, 1 / 8, 1)
    merged = merge_exposures(exposed(seen, 1.0), short, 8.0).image

    assert np.array_equal(merged == 255, short >= WHITE)


@given(st.floats(2.0, 16.0), st.floats(-0.15, 0.15))
def test_more_light_is_never_darker(ratio: float, error: float) -> None:
    """On a ramp without noise grey values do not fall, although the ratio is not exact.

    Apart from rounding: a step of the short exposure is up to 16 of the long one.
    """
    ramp = np.tile(np.linspace(0.0, 255.0 * ratio, 4096), (4, 1))
    long = np.clip(np.rint(ramp), 0, 255).astype(np.uint8)
    short = np.clip(np.rint(ramp / ratio), 0, 255).astype(np.uint8)
    grey = merge_exposures(long, short, ratio * (1 + error)).image[0].astype(int)

    assert np.diff(grey).min() >= -2
    assert np.diff(grey).max() <= 9


def test_a_black_pair_is_black_and_its_ratio_is_not_known() -> None:
    """A black pair gives a black picture, an unknown ratio and no movement."""
    black = np.zeros((64, 64), np.uint8)
    merged = merge_exposures(black, black, 8.0)

    assert 0 == merged.image.max()
    assert np.isnan(merged.ratio)
    assert 0.0 == merged.moved_px


def test_a_picture_smaller_than_a_tile_is_merged() -> None:
    """A picture smaller than a tile is merged."""
    small = np.full((10, 12), 100, np.uint8)
    assert (10, 12) == merge_exposures(small, small // 8, 8.0).image.shape
