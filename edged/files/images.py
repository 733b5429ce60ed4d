"""Grey images from files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from edged.domain import Image
from edged.errors import ImageError


def load_image(path: Path) -> Image:
    """Read an 8-bit grey image (H, W) uint8; colour files are converted when all channels agree.

    Raises `ImageError` for what cannot be read or is no image, has another depth, or is really coloured.
    """
    path = Path(path)
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror or error}") from error
    return decode_image(data, str(path))


def decode_image(data: bytes, place: str) -> Image:
    """`load_image` of bytes; place : what a message calls them."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise ImageError(f"{place}: not an image that can be read (PNG, TIFF, BMP and JPEG are)")
    if image.dtype != np.uint8:
        raise ImageError(f"{place}: {image.dtype} pixels, expected 8-bit grey")
    if image.ndim == 3:
        colour = image[..., :3]
        if np.ptp(colour.astype(np.int16), axis=2).max() > 0:
            raise ImageError(f"{place}: a colour image, expected 8-bit grey")
        image = colour[..., 0]
    return np.ascontiguousarray(image, dtype=np.uint8)
