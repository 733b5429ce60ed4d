"""CBOR for what JSON can say: null, booleans, integers, floats, texts, lists, objects with text keys.

Floats are written as 64 bits, so that they survive exactly; everything has a definite length.
Source: RFC 8949.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

MAX_DEPTH = 32
UNSIGNED, NEGATIVE, TEXT, LIST, OBJECT, SIMPLE = 0, 1, 3, 4, 5, 7
SIMPLE_VALUES = {20: False, 21: True, 22: None}
FLOATS = {25: ">e", 26: ">f", 27: ">d"}
SIZES = {24: 1, 25: 2, 26: 4, 27: 8}


def encode_cbor(value: object) -> bytes:
    """A value as CBOR. Raises `TypeError` for what JSON cannot say, `ValueError` beyond 64 bits."""
    if value is None or isinstance(value, bool):
        return bytes([SIMPLE << 5 | {False: 20, True: 21, None: 22}[value]])
    if isinstance(value, int):
        return _head(UNSIGNED, value) if value >= 0 else _head(NEGATIVE, -1 - value)
    if isinstance(value, float):
        return bytes([SIMPLE << 5 | 27]) + struct.pack(">d", value)
    if isinstance(value, str):
        text = value.encode(errors="replace")
        return _head(TEXT, len(text)) + text
    if isinstance(value, list | tuple):
        return _head(LIST, len(value)) + b"".join(encode_cbor(item) for item in value)
    if isinstance(value, Mapping):
        items = (encode_cbor(str(key)) + encode_cbor(item) for key, item in value.items())
        return _head(OBJECT, len(value)) + b"".join(items)
    raise TypeError(f"{type(value).__name__} has no place in JSON or CBOR")


def decode_cbor(data: bytes) -> Any:
    """The value of a CBOR item. Raises `ValueError` for anything that `encode_cbor` would not write."""
    value, end = _item(data, 0, 0)
    if end != len(data):
        raise ValueError(f"{len(data) - end} bytes behind the end")
    return value


def _head(major: int, argument: int) -> bytes:
    if argument < 24:
        return bytes([major << 5 | argument])
    for code, size in SIZES.items():
        if argument < 1 << 8 * size:
            return bytes([major << 5 | code]) + argument.to_bytes(size, "big")
    raise ValueError(f"{argument} needs more than 64 bits")


def _item(data: bytes, start: int, depth: int) -> tuple[Any, int]:
    """The item at `start`, and where the next one begins."""
    if depth > MAX_DEPTH:
        raise ValueError(f"nested deeper than {MAX_DEPTH}")
    initial, at = _take(data, start, 1)
    major, code = initial[0] >> 5, initial[0] & 31
    raw, at = _take(data, at, SIZES.get(code, 0))
    if code > 27:
        raise ValueError("indefinite lengths and reserved codes are not used here")
    if major == SIMPLE:
        if code in FLOATS:
            return struct.unpack(FLOATS[code], raw)[0], at
        if code in SIMPLE_VALUES:
            return SIMPLE_VALUES[code], at
        raise ValueError(f"simple value {code} is not used here")
    argument = int.from_bytes(raw, "big") if raw else code
    if major == UNSIGNED:
        return argument, at
    if major == NEGATIVE:
        return -1 - argument, at
    if major == TEXT:
        text, at = _take(data, at, argument)
        return text.decode(), at
    if major == LIST:
        return _list(data, at, argument, depth)
    if major == OBJECT:
        flat, at = _list(data, at, 2 * argument, depth)
        if not all(isinstance(key, str) for key in flat[::2]):
            raise ValueError("a key that is no text")
        return dict(zip(flat[::2], flat[1::2], strict=True)), at
    raise ValueError(f"major type {major} is not used here")


def _list(data: bytes, at: int, count: int, depth: int) -> tuple[list[Any], int]:
    if count > len(data) - at:  # each item has at least one byte
        raise ValueError(f"{count} items in {len(data) - at} bytes")
    items = []
    for _ in range(count):
        item, at = _item(data, at, depth + 1)
        items.append(item)
    return items, at


def _take(data: bytes, start: int, size: int) -> tuple[bytes, int]:
    if start + size > len(data):
        raise ValueError(f"ends at byte {len(data)}, in the middle of an item")
    return data[start : start + size], start + size
