"""Dirt on a plate of reference marks: swarf, and films of oil."""

from __future__ import annotations

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.sim.render.scene import Part, PlacedPart, RoundedBox, Surface
from edged.vision.geometry.rigid import rotation_matrix, transform

SWARF_MM = (0.4, 3.0), (0.1, 0.5)
"""Ranges of length and width of a steel chip."""
ABOVE_MM = 0.2
OIL_DARK, OIL_BLUR_PX = 0.4, 2.0
"""Share of the light that a film absorbs in its middle, and the blur of what is below it."""


def swarf(rng: np.random.Generator, rig_from_plate: FloatArray, near_mm: FloatArray) -> list[PlacedPart]:
    """A dark or bright chip about half a millimetre from each point (N, 3) of the plate."""
    chips = []
    for place in near_mm:
        long_mm, wide_mm = (float(rng.uniform(*limits)) for limits in SWARF_MM)
        turned = rotation_matrix(np.array([0.0, 0.0, rng.uniform(0.0, np.pi)]))
        at = transform(turned, np.add(place, (*rng.normal(0.0, 0.5, 2), -ABOVE_MM)))
        shape = RoundedBox(0.0, 0.0, long_mm, wide_mm, wide_mm / 2)
        chip = Part("swarf", shape, Surface(albedo=float(rng.choice([0.08, 0.75]))))
        chips.append(PlacedPart(chip, rig_from_plate @ at))
    return chips


def oiled(image: Image, places_px: FloatArray, radius_px: float) -> Image:
    """The picture (H, W) with a drop of oil at each point (N, 2): darker and blurred, with a soft edge."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    film = np.zeros(image.shape)
    for place in places_px:
        film = np.maximum(film, 1.0 - np.hypot(x - place[0], y - place[1]) / radius_px)
    film = np.sqrt(np.clip(film, 0.0, 1.0))
    smeared = cv2.GaussianBlur(image, (0, 0), OIL_BLUR_PX).astype(float)
    seen = (1.0 - film) * image + film * smeared
    return np.asarray(np.clip(np.rint((1.0 - OIL_DARK * film) * seen), 0, 255), np.uint8)
