"""CBOR for what JSON can say: null, booleans, integers, floats, texts, lists, objects with text keys.

cbor2 reads and writes; here it is held to that subset, so that both encodings of a message say the same and
nobody's bytes become a date, a regular expression or a structure that contains itself. Floats are written as
64 bits, so that they survive exactly; everything has a definite length.
Source: RFC 8949.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import cbor2

MAX_DEPTH = 32


def encode_cbor(value: object) -> bytes:
    """A value as CBOR. Raises `TypeError` for what JSON cannot say, `ValueError` beyond 64 bits."""
    _check(value)
    return cbor2.dumps(value, encoders={str: _encode_text})


def decode_cbor(data: bytes) -> Any:
    """The value of a CBOR item. Raises `ValueError` for anything that `encode_cbor` would not write.

    What it needs is bounded by the length of the data, whatever the data claims.
    """
    try:
        value = decode_item(data, MAX_DEPTH, strict_hashable_types=True)
        _check(value)
    except (cbor2.CBORDecodeError, TypeError) as error:
        raise ValueError(f"not used here: {error}") from error
    return value


def decode_item(data: bytes, max_depth: int, *, strict_hashable_types: bool = False) -> Any:
    """The one item that data is, of any kind, without tags: dates, expressions, what contains itself.

    Raises `cbor2.CBORDecodeError` and what cbor2 raises besides, `ValueError` for bytes behind it.
    """
    stream = io.BytesIO(data)
    decoder = cbor2.CBORDecoder(
        stream,
        semantic_decoders=_NoTags(),
        max_depth=max_depth,
        allow_indefinite=False,
        strict_hashable_types=strict_hashable_types,
    )
    value = decoder.decode()
    if stream.tell() != len(data):
        raise ValueError(f"{len(data) - stream.tell()} bytes behind the end")
    return value


class _NoTags(dict[int, Any]):
    """Says of every tag, known to cbor2 or not, how it is read: not at all."""

    def __missing__(self, tag: int) -> Any:
        def refuse(_content: object, _immutable: bool) -> object:
            raise ValueError(f"tag {tag}")

        return refuse


def _encode_text(encoder: cbor2.CBOREncoder, text: str) -> None:
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
