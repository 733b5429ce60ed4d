"""Conversion of cameras' pixel formats to 8-bit grey.

Names, codes and bit layouts are those of the Pixel Format Naming Convention (PFNC 2.4, EMVA) and, for the
older `Packed` formats, of GigE Vision 1.2 (appendix D).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import Image
from edged.vision.kernels.jit import kernel

Layout = Literal["bytes", "words", "pairs", "bits"]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A pixel format.

    code : its PFNC number. bits : per pixel value.
    layout : "bytes", "words" (16 bits, little-endian), "pairs" (two pixels in three bytes, the low bits of
    both in the middle one), "bits" (one after the other, low bit first).
    """

    name: str
    code: int
    bits: int
    layout: Layout

    @property
    def bayer(self) -> bool:
        """Whether neighbouring pixels see different colours."""
        return self.name.startswith("Bayer")

    def size(self, pixels: int) -> int:
        """Bytes of an image with a number of pixels."""
        match self.layout:
            case "bytes":
                return pixels
            case "words":
                return 2 * pixels
            case "pairs":
                return (3 * pixels + 1) // 2
            case "bits":
                return (self.bits * pixels + 7) // 8


def _formats() -> tuple[PixelFormat, ...]:
    mono = (
        PixelFormat("Mono8", 0x01080001, 8, "bytes"),
        PixelFormat("Mono10", 0x01100003, 10, "words"),
        PixelFormat("Mono12", 0x01100005, 12, "words"),
        PixelFormat("Mono14", 0x01100025, 14, "words"),
        PixelFormat("Mono16", 0x01100007, 16, "words"),
        PixelFormat("Mono10Packed", 0x010C0004, 10, "pairs"),
        PixelFormat("Mono12Packed", 0x010C0006, 12, "pairs"),
        PixelFormat("Mono10p", 0x010A0046, 10, "bits"),
        PixelFormat("Mono12p", 0x010C0047, 12, "bits"),
    )
    kinds: tuple[tuple[str, str, int, int, int, Layout], ...] = (
        ("8", "GR RG GB BG", 0x01080008, 1, 8, "bytes"),
        ("10", "GR RG GB BG", 0x0110000C, 1, 10, "words"),
        ("12", "GR RG GB BG", 0x01100010, 1, 12, "words"),
        ("16", "GR RG GB BG", 0x0110002E, 1, 16, "words"),
        ("10Packed", "GR RG GB BG", 0x010C0026, 1, 10, "pairs"),
        ("12Packed", "GR RG GB BG", 0x010C002A, 1, 12, "pairs"),
        ("10p", "BG GB GR RG", 0x010A0052, 2, 10, "bits"),
        ("12p", "BG GB GR RG", 0x010C0053, 2, 12, "bits"),
    )
    bayer = [
        PixelFormat(f"Bayer{colours}{suffix}", first + step * place, bits, layout)
        for suffix, order, first, step, bits, layout in kinds
        for place, colours in enumerate(order.split())
    ]
    return (*mono, *bayer)


FORMATS = {pixel_format.name: pixel_format for pixel_format in _formats()}
BY_CODE = {pixel_format.code: pixel_format for pixel_format in FORMATS.values()}


def grey8(data: npt.NDArray[np.uint8], pixels: PixelFormat, width: int, height: int) -> Image:
    """Image (height, width) uint8 from a camera's bytes, in memory of its own.

    data : (n,) uint8, exactly `pixels.size(width * height)` of them (`ValueError` otherwise).
    More than 8 bits are rounded to the nearest of 256 values, not cut off: no bias of half a grey value.
    data is not kept.

    A Bayer mosaic is smoothed with the binomial kernel [1 2 1] x [1 2 1] / 16. At any pixel, red, green and
    blue enter it with 1/4, 1/2 and 1/4: a patch of one colour becomes one grey, an edge keeps its place (the
    kernel is symmetric), and neither the order of the colours nor white balance matters. The cost is a blur
    of sigma 0.7 px, hardly more than that of any interpolation of colours.
    """
    count = width * height
    if data.size != pixels.size(count):
        raise ValueError(f"{pixels.name} {width}x{height} takes {pixels.size(count)} bytes, not {data.size}")
    if pixels.layout == "bytes":
        image = np.array(data.reshape(height, width))
    else:
        data = np.require(
            data, requirements=["C", "W"]
        )  # as the kernels are compiled for; bytes are read-only
        image = np.empty((height, width), np.uint8)
        round_to_8(_values(data, pixels, count), pixels.bits - 8, image.reshape(-1))
    if not pixels.bayer:
        return image
    # mirrored at the border pixel, which continues the mosaic's pattern
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0, borderType=cv2.BORDER_REFLECT_101), np.uint8)


def _values(data: npt.NDArray[np.uint8], pixels: PixelFormat, count: int) -> npt.NDArray[np.uint16]:
    if pixels.layout == "words":
        return data.view("<u2").astype(np.uint16, copy=False)
    values = np.empty(count, np.uint16)
    (unpack_pairs if pixels.layout == "pairs" else unpack_bits)(data, pixels.bits, values)
    return values


@kernel("void(u1[::1], i8, u2[::1])")
def unpack_pairs(data: npt.NDArray[np.uint8], bits: int, out: npt.NDArray[np.uint16]) -> None:
    """Unpack two pixels per three bytes: high eight bits in the outer bytes, low bits in the middle."""
    low_bits = np.uint16(bits - 8)
    mask = np.uint16((1 << low_bits) - 1)
    pairs = out.size // 2
    for pair in range(pairs):
        middle = np.uint16(data[3 * pair + 1])
        out[2 * pair] = np.uint16(data[3 * pair]) << low_bits | middle & mask
        out[2 * pair + 1] = np.uint16(data[3 * pair + 2]) << low_bits | middle >> np.uint16(4) & mask
    if out.size % 2:
        out[-1] = np.uint16(data[3 * pairs]) << low_bits | np.uint16(data[3 * pairs + 1]) & mask


@kernel("void(u1[::1], i8, u2[::1])")
def unpack_bits(data: npt.NDArray[np.uint8], bits: int, out: npt.NDArray[np.uint16]) -> None:
    """Unpack pixels that begin at bit k * bits, which is even for 10 and 12 bits: each lies in two bytes."""
    mask = np.uint32((1 << bits) - 1)
    for k in range(out.size):
        start = k * bits
        byte = start >> 3
        word = np.uint32(data[byte]) | np.uint32(data[byte + 1]) << np.uint32(8)
        out[k] = word >> np.uint32(start & 7) & mask


@kernel("void(u2[::1], i8, u1[::1])")
def round_to_8(values: npt.NDArray[np.uint16], shift: int, out: npt.NDArray[np.uint8]) -> None:
    """Round to the nearest of 256 values; shift : dropped bits, at least 1. Stray high bits saturate."""
    half, drop = np.uint32(1 << (shift - 1)), np.uint32(shift)
    for k in range(values.size):
        out[k] = min(np.uint32(values[k] + half) >> drop, np.uint32(255))
