"""CBOR for what JSON can say: null, booleans, integers, floats, texts, lists, objects with text keys.

cbor2 reads and writes; here it is held to that subset, so that both encodings of a message say the same and
nobody's bytes become a date, a regular expression or a structure that contains itself. Floats are written as
64 bits, so that they survive exactly; everything has a definite length.
Source: RFC 8949.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cbor2

MAX_DEPTH = 32
BYTES, TEXT, LIST, MAP, TAG = 2, 3, 4, 5, 6
"""Major types, section 3.1."""


@dataclass(frozen=True, slots=True)
class CborBounds:
    """Bounds for what is read. size : of the whole, in bytes; items : of all lists and maps, with keys."""

    size: int
    items: int
    depth: int


ANYBODYS = CborBounds(1 << 20, 20_000, MAX_DEPTH)
"""For results and questions of other programs: each has a few hundred items."""


def encode_cbor(value: object) -> bytes:
    """A value as CBOR. Raises `TypeError` for what JSON cannot say, `ValueError` beyond 64 bits."""
    _check(value)
    return cbor2.dumps(value, encoders={str: encode_text})


def decode_cbor(data: bytes, bounds: CborBounds = ANYBODYS) -> Any:
    """The value of a CBOR item. Raises `ValueError` for anything that `encode_cbor` would not write.

    What it needs is bounded by the length of the data, whatever the data claims.
    """
    try:
        value = decode_item(data, bounds, strict_hashable_types=True)
        _check(value)
    except (cbor2.CBORDecodeError, TypeError) as error:
        raise ValueError(f"not used here: {error}") from error
    return value


def decode_item(data: bytes, bounds: CborBounds, *, strict_hashable_types: bool = False) -> Any:
    """The one item that data is, of any kind, without tags: dates, expressions, what contains itself.

    Raises `cbor2.CBORDecodeError` and what cbor2 raises besides, `ValueError` for what is beyond bounds, and
    for bytes behind it.
    """
    count_items(data, bounds)
    stream = io.BytesIO(data)
    decoder = cbor2.CBORDecoder(
        stream,
        semantic_decoders=_NoTags(),
        max_depth=bounds.depth,
        allow_indefinite=False,
        strict_hashable_types=strict_hashable_types,
    )
    value = decoder.decode()
    if stream.tell() != len(data):
        raise ValueError(f"{len(data) - stream.tell()} bytes behind the end")
    return value


def count_items(data: bytes, bounds: CborBounds) -> int:
    """How many items data has, read by their heads alone, before anything is made of them.

    An empty list is one byte, and 64 in memory. Raises `ValueError` where there are more than may be, for
    tags and what has no definite length, and where data does not end with the item.
    """
    size = len(data)
    if size > bounds.size:
        raise ValueError(f"{size} bytes: at most {bounds.size} are read")
    at, items, most = 0, 0, bounds.items
    missing = [1]  # items of each list and map that is open
    while missing:
        if not missing[-1]:
            missing.pop()
            continue
        missing[-1] -= 1
        items += 1
        if items > most:
            raise ValueError(f"more than {most} items")
        if at >= size:
            raise ValueError("cut off")
        kind, short = data[at] >> 5, data[at] & 31
        at += 1
        if short < 24:
            number = short
        elif short < 28:
            number = int.from_bytes(data[at : at + (1 << short - 24)], "big")
            at += 1 << short - 24
        else:
            raise ValueError("a length that is not definite, or no head of an item")
        if kind in (BYTES, TEXT):
            at += number
        elif kind in (LIST, MAP):
            missing.append(number * (kind - LIST + 1))
            if missing[-1] > size - at:
                raise ValueError(f"a list of {number} in {size - at} bytes")
            if len(missing) > bounds.depth + 1:
                raise ValueError(f"lists in lists, more than {bounds.depth} deep")
        elif kind == TAG:
            raise ValueError(f"tag {number}")
    if at != size:
        raise ValueError(f"{size - at} bytes behind the end" if at < size else "cut off")
    return items


class _NoTags(dict[int, Any]):
    """Says of every tag, known to cbor2 or not, how it is read: not at all."""

    def __missing__(self, tag: int) -> Any:
        def refuse(_content: object, _immutable: bool) -> object:
            raise ValueError(f"tag {tag}")

        return refuse


def encode_text(encoder: cbor2.CBOREncoder, text: str) -> None:
    """Text as UTF-8; half of a surrogate pair, from a file name that is no UTF-8, becomes a question mark."""
    encoder.encode_string(text.encode(errors="replace").decode())


def _check(value: object) -> None:
    """Raises `TypeError` for what JSON cannot say, `ValueError` for integers beyond 64 bits, however deep."""
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a key that is no text has no place in JSON or CBOR")
        for item in value.values():
            _check(item)
    elif isinstance(value, list | tuple):
        for item in value:
            _check(item)
    elif isinstance(value, int):
        if not -(2**64) <= value < 2**64:
            raise ValueError(f"{value:#x} needs more than 64 bits")
    elif not (value is None or isinstance(value, str | float)):
        raise TypeError(f"{type(value).__name__} has no place in JSON or CBOR")
