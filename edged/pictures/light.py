"""Exposure of a picture: clipping, darkness, noise, and a better exposure time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from edged.domain.arrays import Image

WHITE_GREY = 255
DARK_GREY = 12
"""Grey value at and below which black level and read noise of a camera dominate."""
MOST_CLIPPED = 0.002
"""Share of a picture that may be clipped by glints; clipping displaces edges."""
BRIGHT_PERCENT = 99.5
TARGET_GREY, LEAST_GREY = 200.0, 130.0
"""Grey value wanted in the bright parts of a picture, and the one below which more light is advised."""
LOUD_SHARE = 0.02
"""Noise over contrast above which more light instead of gain is advised."""
BLOCK_PX = 32
QUIET_PERCENT = 25.0
"""Percentage of a picture's blocks that are assumed to have no edges or texture."""
ROUNDING_GREY = 12.0**-0.5


class Advice(StrEnum):
    """Advice as a code; the page has the text."""

    GOOD = "good"
    LESS_LIGHT = "less_light"
    MORE_LIGHT = "more_light"
    LIGHT_FOR_GAIN = "light_for_gain"


@dataclass(frozen=True, slots=True)
class LightFigures:
    """Exposure figures of one picture.

    clipped_share, dark_share : of its pixels, 0 to 1. noise_grey : standard deviation of one pixel.
    contrast_grey : between its dark and its bright parts. bright_grey : of the bright parts.
    """

    clipped_share: float
    dark_share: float
    noise_grey: float
    contrast_grey: float
    bright_grey: float

    def advice(self, gain_db: float | None = None) -> tuple[Advice, float]:
        """Advice, and the factor for the exposure time; 1 if the exposure is good."""
        if self.clipped_share > MOST_CLIPPED:
            # the true brightness is unknown: reduce the exposure by a third or more, and try again
            return Advice.LESS_LIGHT, 0.7 if self.clipped_share < 0.1 else 0.4
        if self.bright_grey < LEAST_GREY:
            return Advice.MORE_LIGHT, min(10.0, TARGET_GREY / max(self.bright_grey, 1.0))
        if gain_db and self.noise_grey > LOUD_SHARE * self.contrast_grey:
            return Advice.LIGHT_FOR_GAIN, float(10.0 ** (gain_db / 20.0))
        return Advice.GOOD, 1.0


def light_of(image: Image) -> LightFigures:
    """Compute the figures of a picture (H, W) uint8."""
    counts = np.bincount(image.ravel(), minlength=256)
    shares = np.cumsum(counts) / image.size
    dark, bright = (float(np.searchsorted(shares, percent / 100)) for percent in (5.0, BRIGHT_PERCENT))
    return LightFigures(
        clipped_share=float(counts[WHITE_GREY] / image.size),
        dark_share=float(shares[DARK_GREY]),
        noise_grey=noise_of(image),
        contrast_grey=bright - dark,
        bright_grey=bright,
    )


def noise_of(image: Image) -> float:
    """Noise: standard deviation of one pixel of a picture (H, W) uint8, at least that of rounding.

    From the difference of two Laplacians, which does not respond to brightness, gradient or curvature, in
    the blocks of the picture with the smallest response.
    Source: J. Immerkær, "Fast noise variance estimation", 1996.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6.0
    rough = cv2.filter2D(image.astype(np.float32), cv2.CV_32F, mask)
    rows, columns = (length // BLOCK_PX for length in image.shape)
    if not rows or not columns:
        return ROUNDING_GREY
    shape = (rows, BLOCK_PX, columns, BLOCK_PX)
    cut = slice(rows * BLOCK_PX), slice(columns * BLOCK_PX)
    power = np.square(rough[cut]).reshape(shape).mean(axis=(1, 3))
    whole = image[cut].reshape(shape)
    unclipped = (whole.min(axis=(1, 3)) > 0) & (whole.max(axis=(1, 3)) < WHITE_GREY)
    if not unclipped.any():
        return ROUNDING_GREY
    return max(ROUNDING_GREY, float(np.sqrt(np.percentile(power[unclipped], QUIET_PERCENT))))
