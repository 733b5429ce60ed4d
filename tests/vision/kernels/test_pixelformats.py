"""Pixels as cameras send them: every format gives the original grey values."""

from __future__ import annotations

import numpy as np
import pytest
from naive.kernels import grey_of_mosaic, nearest_of_256, pack_pixels

from edged.domain.arrays import Image
from edged.vision.kernels.pixelformats import BY_CODE, FORMATS, PixelFormat, grey8

EVERY = pytest.mark.parametrize("pixels", FORMATS.values(), ids=FORMATS)
COLOUR_AT = {"R": (1, 0, 0), "G": (0, 1, 0), "B": (0, 0, 1)}


def random_values(pixels: PixelFormat, height: int, width: int) -> np.ndarray:
    """Values over the whole range of a format, its ends included."""
    random = np.random.default_rng(pixels.code)
    values = random.integers(0, 1 << pixels.bits, (height, width))
    values.flat[:2] = 0, (1 << pixels.bits) - 1
    return values


def sent(values: np.ndarray, pixels: PixelFormat) -> Image:
    """The image that results when these values are sent."""
    data = np.frombuffer(pack_pixels(values.ravel().tolist(), pixels.bits, pixels.layout), np.uint8)
    return grey8(data, pixels, values.shape[1], values.shape[0])


@EVERY
@pytest.mark.parametrize("shape", [(6, 8), (5, 7)], ids=["even", "odd"])
def test_values_are_those_that_were_sent(pixels: PixelFormat, shape: tuple[int, int]) -> None:
    """Packed values come back as they were sent; mosaics give the mean of their neighbourhood."""
    values = random_values(pixels, *shape)
    grey = np.array([[nearest_of_256(int(value), pixels.bits) for value in row] for row in values])
    expected = grey_of_mosaic(grey) if pixels.bayer else grey

    image = sent(values, pixels)

    assert np.uint8 == image.dtype
    assert image.flags.owndata
    assert image.flags.writeable
    np.testing.assert_array_equal(expected, image)


def test_known_bytes_of_the_packed_formats() -> None:
    """Pixels 0x123 and 0xABC, and 0x2A7 and 0x155, are packed as GigE Vision 1.2 and PFNC draw them."""
    assert bytes.fromhex("12c3ab") == pack_pixels([0x123, 0xABC], 12, "pairs")
    assert bytes.fromhex("23c1ab") == pack_pixels([0x123, 0xABC], 12, "bits")
    assert bytes.fromhex("a91355") == pack_pixels([0x2A7, 0x155], 10, "pairs")
    assert bytes.fromhex("a75605") == pack_pixels([0x2A7, 0x155], 10, "bits")


def test_codes_are_those_of_the_convention() -> None:
    """No code is used twice, and its third byte is the size of a pixel, as in PFNC 2.4 chapter 5."""
    assert len(FORMATS) == len(BY_CODE)
    for pixels in FORMATS.values():
        assert pixels.size(8) == (pixels.code >> 16 & 0xFF)


@pytest.mark.parametrize("colours", ["GR", "RG", "GB", "BG"])
def test_a_patch_of_one_colour_becomes_one_grey(colours: str) -> None:
    """A patch of any colour gives R/4 + G/2 + B/4 in every pixel, also at the border, for each mosaic
    order."""
    order = {"RG": "RG GB", "GR": "GR BG", "GB": "GB RG", "BG": "BG GR"}[colours].split()
    red, green, blue = 200, 80, 16
    mosaic = np.empty((8, 10), np.uint8)
    for y in range(8):
        for x in range(10):
            mosaic[y, x] = np.dot(COLOUR_AT[order[y % 2][x % 2]], (red, green, blue))

    image = sent(mosaic, FORMATS[f"Bayer{colours}8"])

    assert {(red + 2 * green + blue) // 4} == set(image.ravel().tolist())


@pytest.mark.parametrize("name", ["BayerRG8", "BayerGB12p"])
def test_a_mosaic_does_not_move_an_edge(name: str) -> None:
    """The blurred edge of a grey part stays in place to 0.01 px."""
    random = np.random.default_rng(5)
    one = 1 << (FORMATS[name].bits - 8)  # a step of 8-bit grey
    y, x = np.mgrid[:32, :32]
    for at_px, angle in zip(random.uniform(10, 20, 10), random.uniform(0, 6.28, 10), strict=True):
        away = (x - at_px) * np.cos(angle) + (y - at_px) * np.sin(angle)
        values = np.round(one * (50 + 150 / (1 + np.exp(-away / 0.8)))).astype(int)

        after = sent(values, FORMATS[name]).astype(float)

        # a shift d of the edge adds d * gradient; a blur, which is even, adds nothing along it
        before = values / one
        gradient = np.hypot(*np.gradient(before))
        assert abs(((after - before) * gradient)[2:-2, 2:-2].sum() / (gradient**2).sum()) < 0.01


@EVERY
def test_a_wrong_number_of_bytes_is_refused(pixels: PixelFormat) -> None:
    """One byte less or more, or none, is refused."""
    whole = pixels.size(8 * 6)
    for count in (whole - 1, whole + 1, 0):
        with pytest.raises(ValueError, match=f"{pixels.name} 8x6 takes {whole} bytes, not {count}"):
            grey8(np.zeros(count, np.uint8), pixels, 8, 6)
