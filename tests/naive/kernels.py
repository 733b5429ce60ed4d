"""Plain-loop twins of the kernels of `vision/kernels`: slow, but simple enough to trust."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray


def median_scale(residuals: FloatArray, base: FloatArray) -> float:
    """Sigma of normal errors from the median of the samples with positive weight."""
    kept = np.abs(residuals[base > 0])
    return 1.4826 * float(np.median(kept)) if len(kept) else 0.0


def tukey_weights(ratio: FloatArray) -> FloatArray:
    """Tukey's biweight, c = 4.685."""
    return np.where(np.abs(ratio) < 4.685, (1 - (ratio / 4.685) ** 2) ** 2, 0.0)


def pack_pixels(values: list[int], bits: int, layout: str) -> bytes:
    """Bytes in which a camera sends these values, bit by bit as the standard defines them."""
    if layout == "bytes":
        return bytes(values)
    if layout == "words":
        return b"".join(bytes((value & 0xFF, value >> 8)) for value in values)
    if layout == "pairs":
        low_bits = bits - 8
        packed = bytearray()
        for place in range(0, len(values), 2):
            first, *rest = values[place : place + 2]
            low = first & (1 << low_bits) - 1
            packed += bytes((first >> low_bits, low))
            for second in rest:
                packed[-1] |= (second & (1 << low_bits) - 1) << 4
                packed.append(second >> low_bits)
        return bytes(packed)
    stream = "".join(f"{value:0{bits}b}"[::-1] for value in values)  # low bit first
    stream += "0" * (-len(stream) % 8)
    return bytes(int(stream[start : start + 8][::-1], 2) for start in range(0, len(stream), 8))


def grey_of_mosaic(mosaic: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """(R + 2 G + B) / 4 around every pixel: binomial mean, rounded half up, mirrored at the border."""
    height, width = mosaic.shape
    out = np.zeros(mosaic.shape, np.int64)
    for y in range(height):
        for x in range(width):
            total = 0
            for dy, weight_y in ((-1, 1), (0, 2), (1, 1)):
                for dx, weight_x in ((-1, 1), (0, 2), (1, 1)):
                    row, column = abs(y + dy), abs(x + dx)
                    row = 2 * (height - 1) - row if row >= height else row
                    column = 2 * (width - 1) - column if column >= width else column
                    total += weight_y * weight_x * int(mosaic[row, column])
            out[y, x] = (total + 8) // 16
    return out


def nearest_of_256(value: int, bits: int) -> int:
    """A value of `bits` bits converted to 8, rounded half up, at most 255."""
    return min(255, math.floor(value / 2 ** (bits - 8) + 0.5))
