"""Exposure of a picture: clipped, dark, noisy, and the exposure time that would be better."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from edged.domain.arrays import Image

WHITE_GREY = 255
DARK_GREY = 12
"""Here a camera's black level and read noise are most of what is seen."""
MOST_CLIPPED = 0.002
"""Share of a picture that glints may have; a clipped edge lies elsewhere."""
BRIGHT_PERCENT = 99.5
TARGET_GREY, LEAST_GREY = 200.0, 130.0
"""What the bright parts of a picture should have, and where advice begins."""
LOUD_SHARE = 0.02
"""Noise of so much of the contrast costs more than light would."""
BLOCK_PX = 32
QUIET_PERCENT = 25.0
"""Share of the blocks of a picture that have no edges or texture."""
ROUNDING_GREY = 12.0**-0.5


class Advice(StrEnum):
    """Advice, as a code; the page has the words."""

    GOOD = "good"
    LESS_LIGHT = "less_light"
    MORE_LIGHT = "more_light"
    LIGHT_FOR_GAIN = "light_for_gain"


@dataclass(frozen=True, slots=True)
class LightFigures:
    """Figures of one picture.

    clipped_share, dark_share : of its pixels, 0 to 1. noise_grey : standard deviation of one pixel, median
    brightness. contrast_grey : between its dark and its bright parts. bright_grey : of the bright parts.
    """

    clipped_share: float
    dark_share: float
    noise_grey: float
    contrast_grey: float
    bright_grey: float

    def advice(self, gain_db: float | None = None) -> tuple[Advice, float]:
        """Advice, and the factor for the exposure time; 1 where it is good."""
        if self.clipped_share > MOST_CLIPPED:
            # how bright it is cannot be seen: take a third off, and look again
            return Advice.LESS_LIGHT, 0.7 if self.clipped_share < 0.1 else 0.4
        if self.bright_grey < LEAST_GREY:
            return Advice.MORE_LIGHT, min(10.0, TARGET_GREY / max(self.bright_grey, 1.0))
        if gain_db and self.noise_grey > LOUD_SHARE * self.contrast_grey:
            return Advice.LIGHT_FOR_GAIN, float(10.0 ** (gain_db / 20.0))
        return Advice.GOOD, 1.0


def light_of(image: Image) -> LightFigures:
    """The figures of a picture (H, W) uint8."""
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
    """Standard deviation of one pixel of a picture (H, W) uint8, grey values; at least that of rounding.

    By the difference of two Laplacians, which sees neither brightness nor its slope nor its bend, in those
    fields of the picture that have least of it.
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
