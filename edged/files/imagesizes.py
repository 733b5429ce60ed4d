"""Read the size stated in an image file's header, without decoding it.

A kilobyte of PNG may unpack to more than a PC's memory: the size read here is what OpenCV would allocate.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

MAX_PIXELS = 1 << 26
"""Most pixels of a picture: the largest sensors of industrial cameras have 9344 x 7000 (Gpixel GMAX3265)."""
MAX_UNPACKED_BYTES = 4 * MAX_PIXELS
"""`MAX_PIXELS` in colour with transparency; decoding takes as much again."""
PNG, JPEG, BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM"
TIFF = {b"II*\0": "<", b"MM\0*": ">", b"II+\0": "<", b"MM\0+": ">"}
"""Byte order by the first four bytes; those with a plus are BigTIFF."""
_PNM = re.compile(rb"P([1-6])" + 2 * rb"(?:\s|#[^\r\n]*[\r\n])+([0-9]{1,9})")
"""Netpbm's formats; comments may stand between the numbers (pgm(5))."""
_PNG_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 4, 6: 4}
"""Channels by colour type (PNG specification, 11.2.1) as OpenCV unpacks them: a palette may have
transparency."""
_NO_FRAMES = {0xC4, 0xC8, 0xCC}
"""Markers in the range of the JPEG frames, SOF0 to SOF15, that begin no frame (ITU-T T.81, table B.1)."""
_BARE_MARKERS = {0x01, *range(0xD0, 0xD8)}
"""Markers without a length and content (same table)."""
_TIFF_TYPES = {3: "H", 4: "I", 16: "Q"}
"""Struct codes of the integer types: SHORT, LONG and BigTIFF's LONG8 (TIFF 6.0, section 2)."""
_WIDTH, _LENGTH, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_LENGTH = 256, 257, 258, 277, 322, 323
_MOST_TAGS, _MOST_VALUES = 1000, 64
"""Most entries read of a TIFF directory, and values of an entry; cameras and drawing programs write a few
dozen."""


@dataclass(frozen=True, slots=True)
class ClaimedSize:
    """Size in pixels, and bytes of the decoded image."""

    width: int
    height: int
    unpacked_bytes: int


def claimed_size(data: bytes) -> ClaimedSize | None:
    """Size stated by the header of a PNG, JPEG, BMP, TIFF or PNM; None for other or damaged headers."""
    try:
        return next((read(data) for begins, read in _READERS if data.startswith(begins)), None)
    except (struct.error, ValueError, LookupError):
        return None


def _size(width: int, height: int, pixel_bytes: int) -> ClaimedSize:
    return ClaimedSize(width, height, width * height * pixel_bytes)


def _png(data: bytes) -> ClaimedSize | None:
    kind, width, height, depth, colours = struct.unpack_from(">4sIIBB", data, 12)
    return (
        _size(width, height, _PNG_CHANNELS[colours] * (2 if depth == 16 else 1)) if kind == b"IHDR" else None
    )


def _bmp(data: bytes) -> ClaimedSize | None:
    """Size in a BMP header; a negative height means top-down rows."""
    (head,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if head == 12 else "<ii", data, 18)
    return _size(abs(width), abs(height), 4)


def _jpeg(data: bytes) -> ClaimedSize | None:
    """Size in the header of the first frame; None if bytes between two markers are not as expected."""
    at = 2
    while data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill bytes may precede a marker
            at += 1
        elif marker in _BARE_MARKERS:
            at += 2
        elif 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES:
            _, height, width, channels = struct.unpack_from(">BHHB", data, at + 4)
            return _size(width, height, 1 if channels == 1 else 4)
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _pnm(data: bytes) -> ClaimedSize | None:
    """Size in a PNM header; 16 bits, and three colours where the format allows them, are assumed."""
    found = _PNM.match(data)
    if found is None:
        return None
    return _size(int(found[2]), int(found[3]), {b"1": 1, b"4": 1, b"2": 2, b"5": 2}.get(found[1], 6))


def _tiff(data: bytes) -> ClaimedSize | None:
    """Size of the first picture, or of a tile, which may be larger and is unpacked as a whole."""
    tags: dict[int, int] = {_SAMPLES: 1, _BITS: 1, _TILE_WIDTH: 0, _TILE_LENGTH: 0}
    for tag, value in _tiff_tags(data, TIFF[data[:4]], is_big=b"+" in data[:4]):
        tags[tag] = max(value, tags.get(tag, 0))  # of a repeated tag libtiff takes one: assume the larger
    pixel_bytes = tags[_SAMPLES] * math.ceil(tags[_BITS] / 8)
    picture = _size(tags[_WIDTH], tags[_LENGTH], pixel_bytes)
    tile = _size(tags[_TILE_WIDTH], tags[_TILE_LENGTH], pixel_bytes)
    return max(picture, tile, key=lambda size: size.unpacked_bytes)


def _tiff_tags(data: bytes, order: str, *, is_big: bool) -> Iterator[tuple[int, int]]:
    """Integer entries of the first directory: each tag and the largest of its values."""
    (first,) = struct.unpack_from(order + ("Q" if is_big else "I"), data, 8 if is_big else 4)
    counted, entry, inline_bytes = ("Q", "HHQ", 8) if is_big else ("H", "HHI", 4)
    (count,) = struct.unpack_from(order + counted, data, first)
    start, head = first + struct.calcsize(counted), struct.calcsize(order + entry)
    for number in range(min(count, _MOST_TAGS)):
        place = start + number * (head + inline_bytes)
        tag, kind, values = struct.unpack_from(order + entry, data, place)
        if kind not in _TIFF_TYPES or values == 0:
            continue
        letters = order + _TIFF_TYPES[kind] * min(values, _MOST_VALUES)
        place += head
        if struct.calcsize(letters) > inline_bytes:  # the values are stored elsewhere
            (place,) = struct.unpack_from(order + ("Q" if is_big else "I"), data, place)
            if tag not in (_WIDTH, _LENGTH, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_LENGTH):
                continue
        yield tag, max(struct.unpack_from(letters, data, place))


_READERS: tuple[tuple[bytes | tuple[bytes, ...], Callable[[bytes], ClaimedSize | None]], ...] = (
    (PNG, _png),
    (JPEG, _jpeg),
    (BMP, _bmp),
    (tuple(TIFF), _tiff),
    (tuple(b"P%d" % number for number in range(1, 7)), _pnm),
)
