"""One exposure of both cameras, raw and rectified."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np

from edged.domain.arrays import FloatArray, Image, Side
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification, check_size


@dataclass(frozen=True, eq=False)  # no slots: cached properties live in the instance's dictionary
class StereoImages:
    """Raw images (H, W) and rectified ones (h, w), uint8, with the rectification between them.

    Their grey values are in proportion to the light: the response of the cameras is taken out. An image is
    rectified when somebody asks for it: to find a part takes the left one, to measure it takes none.
    """

    rectification: Rectification
    left: Image
    right: Image

    @staticmethod
    def of(rectification: Rectification, left: Image, right: Image) -> StereoImages:
        """Take a raw pair. Raises `ImageError` for images that the rig was not calibrated for."""
        rig = rectification.rig
        check_size(rig.left, left, "left")
        check_size(rig.right, right, "right")
        return StereoImages(
            rectification, linear_image(left, rig.left.gamma), linear_image(right, rig.right.gamma)
        )

    @cached_property
    def rectified_left(self) -> Image:
        """The left image as the rectified camera sees it."""
        return self.rectification.left_image(self.left)

    @cached_property
    def rectified_right(self) -> Image:
        """The right image as the rectified camera sees it."""
        return self.rectification.right_image(self.right)

    @property
    def rig(self) -> StereoRig:
        """The cameras as calibrated."""
        return self.rectification.rig

    @property
    def raw(self) -> tuple[Image, Image]:
        """Left and right, as the cameras deliver them."""
        return self.left, self.right

    def rays(self, side: Side, rectified_px: FloatArray) -> FloatArray:
        """Directions (N, 3), z = 1 in the raw camera's frame, of rectified pixels (N, 2) of one image."""
        camera = self.rig.left if side == "left" else self.rig.right
        normalised = camera.normalise(self.rectification.raw_points(side, rectified_px))
        return np.column_stack([normalised, np.ones(len(normalised))])


def linear_image(image: Image, gamma: float) -> Image:
    """An image (H, W) uint8 with grey values in proportion to the light; the same one of a linear camera."""
    if gamma == 1.0:
        return image
    return np.asarray(cv2.LUT(image, _inverse(gamma)), np.uint8)


@lru_cache(maxsize=8)
def _inverse(gamma: float) -> Image:
    """(256,) uint8: the linear grey value of each."""
    return np.rint(linear_grey(np.arange(256.0), gamma)).astype(np.uint8)


def linear_grey(grey: FloatArray, gamma: float) -> FloatArray:
    """Grey values, 0 to 255, that are in proportion to the light."""
    return np.asarray(255.0 * (grey / 255.0) ** (1.0 / gamma))
