"""Detect in front of which camera a hand is waved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image

Key = TypeVar("Key")

COLUMNS = 24
"""Fields across a picture: enough to show a hand, while small movements within a field, and noise, vanish."""
LEAST_GREY, LEAST_SHARE_OF_GREY = 6.0, 0.1
"""A changed field differs by more than both, after removing the change common to all (flickering light)."""
LEAST_SHARE = 0.04
"""Smallest share of changed fields; a hand covers more."""
CLEARLY = 3.0
"""Factor by which one picture must have changed more than any other."""


def changed_share(before: Image, after: Image) -> float:
    """Share of a picture that changed, apart from global brightness; 0 to 1.

    before, after : (H, W) uint8, of the same size.
    """
    first, second = _small(before), _small(after)
    seen = (first > LEAST_GREY) & (first < 250.0)
    flicker = float(np.median(second[seen] / first[seen])) if seen.any() else 1.0
    limit = np.maximum(LEAST_GREY, LEAST_SHARE_OF_GREY * first)
    return float(np.mean(np.abs(second - flicker * first) > limit))


def changed_most(shares: Mapping[Key, float]) -> Key | None:
    """Key of the picture that clearly changed more than all others; None if there is none."""
    ranked = sorted(shares, key=lambda key: shares[key], reverse=True)
    if not ranked or shares[ranked[0]] < LEAST_SHARE:
        return None
    if len(ranked) > 1 and shares[ranked[0]] < CLEARLY * shares[ranked[1]]:
        return None
    return ranked[0]


def _small(image: Image) -> FloatArray:
    height, width = image.shape
    size = (COLUMNS, max(1, round(COLUMNS * height / width)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float64)
