"""Encoding of grey values of a virtual sensor in the pixel formats of cameras (PFNC)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import Image
from edged.vision.kernels.pixelformats import PixelFormat


def encode(image: Image, pixels: PixelFormat) -> bytes:
    """Encode a (height, width) uint8 image; grey g becomes g * 2**(bits - 8).

    A Bayer sensor sees a grey scene, in which the filters have no effect. Slow and simple on purpose: it is
    the counterpart of `vision.pixelformats`, and shares only names, codes and layouts with it.
    """
    if pixels.layout == "bytes":
        return image.tobytes()
    values = image.reshape(-1).astype(np.uint16) << np.uint16(pixels.bits - 8)
    if pixels.layout == "words":
        return values.astype("<u2").tobytes()
    if pixels.layout == "pairs":
        return _pairs(values, pixels.bits)
    bits = values[:, None] >> np.arange(pixels.bits, dtype=np.uint16) & 1  # low bit first
    return np.packbits(bits.astype(np.uint8), bitorder="little").tobytes()


def _pairs(values: npt.NDArray[np.uint16], bits: int) -> bytes:
    """Two pixels in three bytes: high bits, low bits of both, high bits."""
    low = bits - 8
    padded = np.append(values, np.uint16(0)) if values.size % 2 else values
    first, second = padded[::2], padded[1::2]
    mask = (1 << low) - 1
    middle = first & mask | (second & mask) << 4
    packed = np.stack([first >> low, middle, second >> low], axis=1).astype(np.uint8)
    return packed.tobytes()[: (3 * values.size + 1) // 2]
