"""Encode images as JPEG for viewing, and as lossless PNG."""

from __future__ import annotations

import cv2
import numpy as np

from edged.domain.arrays import Image


def shrunk(image: Image, width_px: int) -> Image:
    """Shrink an image (H, W) uint8 to at most this width."""
    height, width = image.shape
    if width <= width_px:
        return image
    size = (width_px, max(1, round(height * width_px / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def jpeg(image: Image, quality: int, width_px: int | None = None) -> bytes:
    """Encode an image (H, W) uint8 as JPEG. quality : per cent. width_px : largest width; None: any."""
    image = image if width_px is None else shrunk(image, width_px)
    return _encoded(".jpg", image, cv2.IMWRITE_JPEG_QUALITY, quality)


def png(image: Image) -> bytes:
    """Encode an image (H, W) uint8 as PNG with low compression, in a tenth of the default's time."""
    return _encoded(".png", image, cv2.IMWRITE_PNG_COMPRESSION, 1)


def _encoded(suffix: str, image: Image, option: int, value: int) -> bytes:
    encoded, data = cv2.imencode(suffix, image, (option, value))
    if not encoded:
        raise ValueError(f"an image of the shape {image.shape} cannot be encoded as {suffix}")
    return data.tobytes()
