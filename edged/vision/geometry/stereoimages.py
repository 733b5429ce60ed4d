"""One exposure of both cameras, raw and rectified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain import FloatArray, Image, Side
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification


@dataclass(frozen=True, slots=True, eq=False)
class StereoImages:
    """Raw images (H, W) and rectified ones (h, w), uint8, with the rectification between them."""

    rectification: Rectification
    left: Image
    right: Image
    rectified_left: Image
    rectified_right: Image

    @staticmethod
    def of(rectification: Rectification, left: Image, right: Image) -> StereoImages:
        """Rectify a raw pair. Raises `ImageError` for images that the rig was not calibrated for."""
        return StereoImages(
            rectification, left, right, rectification.left_image(left), rectification.right_image(right)
        )

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
