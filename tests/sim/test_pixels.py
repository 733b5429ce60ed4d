"""The virtual sensor's pixel formats: the bytes of the standards, and what the adapter reads."""

from __future__ import annotations

import numpy as np
import pytest

from edged.sim.gige.genicam import PIXEL_FORMATS
from edged.sim.gige.pixels import encode
from edged.vision.kernels.pixelformats import FORMATS, grey8


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Mono8", "80 41 ff"),
        ("Mono10", "0002 0401 fc03"),
        ("Mono12", "0008 1004 f00f"),
        ("Mono10Packed", "80 00 41 ff 00"),
        ("Mono12Packed", "80 00 41 ff 00"),
        ("Mono10p", "00 12 c4 3f"),
        ("Mono12p", "00 08 41 f0 0f"),
        ("BayerRG8", "80 41 ff"),
    ],
)
def test_the_bytes_are_those_of_the_standards(name: str, expected: str) -> None:
    """Grey 0x80, 0x41, 0xff become the bytes in PFNC 2.4 and GigE Vision 1.2, appendix D."""
    image = np.array([[0x80, 0x41, 0xFF]], np.uint8)

    assert bytes.fromhex(expected) == encode(image, FORMATS[name])


@pytest.mark.parametrize("name", PIXEL_FORMATS)
@pytest.mark.parametrize("width", [1, 6, 7])
def test_what_the_sensor_saw_is_what_the_adapter_gets(name: str, width: int) -> None:
    """Any format, also with odd widths, gives the sensor's picture back; a mosaic of one grey gives that
    grey."""
    bayer = FORMATS[name].bayer
    image = np.random.default_rng(width).integers(0, 256, (5, width), dtype=np.uint8)
    image = np.full_like(image, 77) if bayer else image
    data = np.frombuffer(encode(image, FORMATS[name]), np.uint8)

    assert np.array_equal(image, grey8(data, FORMATS[name], width, 5))
