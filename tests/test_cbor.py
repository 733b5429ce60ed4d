"""CBOR: the vectors of RFC 8949, round trips, and hostile bytes."""

from __future__ import annotations

import json
import math
import tracemalloc
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from helpers.snapshots import make_snapshot
from hypothesis import given
from hypothesis import strategies as st

from edged.cbor import decode_cbor, encode_cbor
from edged.payload import encode, snapshot_to_json

# RFC 8949, appendix A (those with JSON values, in the form that we write)
VECTORS = {
    "00": 0,
    "17": 23,
    "1818": 24,
    "1903e8": 1000,
    "1a000f4240": 1_000_000,
    "1b000000e8d4a51000": 1_000_000_000_000,
    "1bffffffffffffffff": 2**64 - 1,
    "3bffffffffffffffff": -(2**64),
    "20": -1,
    "3903e7": -1000,
    "fb3ff199999999999a": 1.1,
    "fb7e37e43c8800759c": 1.0e300,
    "fbc010666666666666": -4.1,
    "f4": False,
    "f5": True,
    "f6": None,
    "60": "",
    "6449455446": "IETF",
    "62c3bc": "ü",
    "64f0908591": "𐅑",
    "80": [],
    "8301820203820405": [1, [2, 3], [4, 5]],
    "a0": {},
    "a26161016162820203": {"a": 1, "b": [2, 3]},
}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**64), 2**64 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@pytest.mark.parametrize("data", VECTORS)
def test_vectors_of_the_standard(data):
    """Encoding and decoding agree with RFC 8949."""
    assert data == encode_cbor(VECTORS[data]).hex()
    assert VECTORS[data] == decode_cbor(bytes.fromhex(data))


@pytest.mark.parametrize(("data", "value"), [("f93c00", 1.0), ("fa47c35000", 100000.0), ("f97c00", math.inf)])
def test_short_floats_of_other_writers_are_read(data, value):
    """Floats of 16 and 32 bits, as other libraries write them, are read."""
    assert value == decode_cbor(bytes.fromhex(data))


@pytest.mark.slow
@given(JSON)
def test_round_trip(value):
    """Any JSON value comes back equal and of the same type."""
    back = decode_cbor(encode_cbor(value))
    assert value == back
    assert repr(value) == repr(back)


@given(st.binary(max_size=60))
def test_hostile_bytes_are_a_value_error_or_a_value(data):
    """Any bytes give a value or a ValueError."""
    try:
        decode_cbor(data)
    except ValueError:
        return


@given(st.data())
def test_a_damaged_result_is_a_value_error_or_what_json_can_say(data):
    """A real message with bytes cut out or changed gives a ValueError or a JSON value."""
    whole = encode_cbor(snapshot_to_json(make_snapshot()))
    start = data.draw(st.integers(0, len(whole) - 1))
    length = data.draw(st.integers(0, 40))
    junk = data.draw(st.binary(max_size=20))
    try:
        value = decode_cbor(whole[:start] + junk + whole[start + length :])
    except ValueError:
        return
    json.dumps(value)


@pytest.mark.parametrize(
    "data", ["9b7fffffffffffffff", "7b7fffffffffffffff", "81" * 5000, "bf", "c000", "", "0000"]
)
def test_what_is_not_written_here_is_refused(data):
    """False lengths, deep nesting, indefinite lengths, tags, no bytes and extra bytes are refused."""
    with pytest.raises(ValueError):
        decode_cbor(bytes.fromhex(data))


# registered tags that cbor2 reads by itself, and an unregistered one
@pytest.mark.parametrize(
    "tag",
    [
        *(0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261),
        *(1004, 43000, 55799, 2**64 - 1),
    ],
)
@pytest.mark.parametrize("content", ["00", "6130", "4130", "80", "820000"])
def test_no_tag_is_read(tag, content):
    """Every tag is refused, whatever its content."""
    tagged = (b"\xdb" + tag.to_bytes(8, "big")) + bytes.fromhex(content)
    with pytest.raises(ValueError):
        decode_cbor(tagged)
    with pytest.raises(ValueError):
        decode_cbor(b"\xa1\x61a\x81" + tagged)


@pytest.mark.parametrize("data", ["41ff", "f7", "f820", "e0", "a1413000", "a10102", "a1800000", "8141ff"])
def test_what_cbor_can_say_and_json_cannot_is_refused(data):
    """Byte strings, undefined, simple values, and keys that are no text are refused."""
    with pytest.raises(ValueError):
        decode_cbor(bytes.fromhex(data))


def test_lying_lengths_take_no_memory():
    """Thirty nested lists that claim a million items each take less than a megabyte."""
    nested = bytes.fromhex("9a000fffff" * 30)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError):
            decode_cbor(nested)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_a_result_says_the_same_in_both_encodings():
    """A snapshot in CBOR equals its JSON, and is shorter."""
    document = snapshot_to_json(make_snapshot())
    assert json.loads(encode(document)) == decode_cbor(encode_cbor(document))
    assert len(encode_cbor(document)) < len(encode(document))


@pytest.mark.parametrize(
    "value",
    [
        {1},
        b"x",
        np.zeros(2),
        np.int64(1),
        Path("x"),
        datetime(2026, 1, 1, tzinfo=UTC),
        Decimal(1),
        {1: 2},
        1j,
    ],
)
def test_what_json_cannot_say_is_a_type_error(value):
    """A value that JSON cannot have, such as an array, is a TypeError."""
    with pytest.raises(TypeError, match="no place in JSON"):
        encode_cbor({"x": [value]})


@pytest.mark.parametrize("value", [2**64, -(2**64) - 1])
def test_an_integer_beyond_64_bits_is_a_value_error(value):
    """An integer beyond 64 bits is a ValueError."""
    with pytest.raises(ValueError, match="64 bits"):
        encode_cbor({"x": value})


def test_what_is_not_finite_stays_what_it_is():
    """NaN and infinities come back unchanged."""
    back = decode_cbor(encode_cbor([math.nan, math.inf, -math.inf, None]))
    assert math.isnan(back[0])
    assert [math.inf, -math.inf, None] == back[1:]


def test_a_broken_file_name_does_not_hold_up_a_message():
    """A file name that is no UTF-8 is encoded with a replaced character."""
    assert {"error": "job-?.toml"} == decode_cbor(encode_cbor({"error": "job-\udcff.toml"}))
