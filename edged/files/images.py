"""Grey images from files."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike

from edged.domain.arrays import Image
from edged.errors import ImageError, translated
from edged.files.imagesizes import MAX_PIXELS, MAX_UNPACKED_BYTES, claimed_size
from edged.owners import file_to_read

MAX_IMAGE_BYTES = MAX_UNPACKED_BYTES + (1 << 20)
"""Largest file: an uncompressed picture and its header."""
SENSOR_BITS = (8, 10, 12, 14, 16)


def load_image(path: Path) -> Image:
    """Read an image as 8-bit grey (H, W) uint8; colour and 16-bit images are converted.

    Raises `ImageError` for a file that cannot be read, is not an image, is too large, or has
    floating-point pixels.
    """
    path = Path(path)
    if path.is_dir():
        raise ImageError(f"{path}: is a folder, expected an image")
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    with translated(ImageError, f"{path}: cannot be read"), file_to_read(path) as file:
        size = os.fstat(file.fileno()).st_size
        data = b"" if size > MAX_IMAGE_BYTES else file.read(MAX_IMAGE_BYTES + 1)
    if max(size, len(data)) > MAX_IMAGE_BYTES:
        raise ImageError(f"{path}: {size} bytes: expected an image, at most {MAX_IMAGE_BYTES}")
    return decode_image(data, str(path))


def decode_image(data: bytes, place: str) -> Image:
    """Decode the bytes of an image as `load_image` does; place : their name in messages."""
    if not data:
        raise ImageError(f"{place}: an empty file, expected an image")
    claimed = claimed_size(data)
    unreadable = f"{place}: not an image that can be read; save it as PNG, TIFF, BMP or JPEG"
    if claimed is None:
        raise ImageError(unreadable)
    if claimed.width * claimed.height > MAX_PIXELS or claimed.unpacked_bytes > MAX_UNPACKED_BYTES:
        raise ImageError(
            f"{place}: {claimed.width}x{claimed.height} pixels, unpacked {claimed.unpacked_bytes} bytes: "
            f"expected at most {MAX_PIXELS} pixels and {MAX_UNPACKED_BYTES} bytes"
        )
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageError(f"{unreadable} ({error.err})") from error
    if image is None:
        raise ImageError(unreadable)
    if image.dtype == np.uint16:
        image = _as_8_bits(image)
    if image.dtype != np.uint8:
        raise ImageError(f"{place}: {image.dtype} pixels; save it with 8 or 16 bits")
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY) if image.shape[2] > 2 else image[..., 0]
    return np.ascontiguousarray(image, dtype=np.uint8)


def _as_8_bits(image: MatLike) -> Image:
    """The sensor's upper eight bits: cameras store 10, 12 or 14 bits in 16."""
    bits = max(8, int(image.max()).bit_length())
    bits = next(depth for depth in SENSOR_BITS if bits <= depth)
    return np.asarray(np.asarray(image, np.uint16) >> (bits - 8), np.uint8)
