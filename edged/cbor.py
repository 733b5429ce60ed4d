"""CBOR restricted to what JSON has: null, booleans, integers, floats, strings, lists, objects with text keys.

cbor2 encodes and decodes; this module restricts it to that subset, so that both encodings of a message are
equivalent and no foreign bytes become a date, a regular expression or a structure that contains itself.
Floats are written with 64 bits, so that they are preserved exactly; everything has a definite length.
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
"""CBOR major types, section 3.1."""


@dataclass(frozen=True, slots=True)
class CborBounds:
    """Bounds for decoding. size : of the whole, in bytes; items : in all lists and maps, with keys."""

    size: int
    items: int
    depth: int


UNTRUSTED_BOUNDS = CborBounds(1 << 20, 20_000, MAX_DEPTH)
"""Bounds for results and requests of other programs: each has a few hundred items."""


def encode_cbor(value: object) -> bytes:
    """Encode a value. Raises `TypeError` for a type that JSON lacks, `ValueError` beyond 64 bits."""
    _check(value)
    return cbor2.dumps(value, encoders={str: encode_text})


def decode_cbor(data: bytes, bounds: CborBounds = UNTRUSTED_BOUNDS) -> Any:
    """Decode a CBOR item. Raises `ValueError` for anything that `encode_cbor` would not write.

    Memory and time are bounded by the length of the data, whatever lengths the data claims.
    """
    try:
        value = decode_item(data, bounds, strict_hashable_types=True)
        _check(value)
    except (cbor2.CBORDecodeError, TypeError) as error:
        raise ValueError(f"not used here: {error}") from error
    return value


def decode_item(data: bytes, bounds: CborBounds, *, strict_hashable_types: bool = False) -> Any:
    """Decode the single item in data, of any type but tags (dates, expressions, recursive structures).

    Raises `cbor2.CBORDecodeError` and other exceptions of cbor2, `ValueError` beyond the bounds and for bytes
    after the item.
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
    """Count the items in data from their heads alone, before anything is constructed.

    An empty list takes one byte here, and 64 in memory. Raises `ValueError` for more than the bounds allow,
    for tags and indefinite lengths, and if data does not end with the item.
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
    """Tag decoders that refuse every tag, whether known to cbor2 or not."""

    def __missing__(self, tag: int) -> Any:
        def refuse(_content: object, _immutable: bool) -> object:
            raise ValueError(f"tag {tag}")

        return refuse


def encode_text(encoder: cbor2.CBOREncoder, text: str) -> None:
    """Encode text as UTF-8; a lone surrogate, from a file name that is not UTF-8, becomes a question mark."""
    encoder.encode_string(text.encode(errors="replace").decode())


def _check(value: object) -> None:
    """Raise `TypeError` for a type that JSON lacks, `ValueError` for integers over 64 bits, at any depth."""
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
