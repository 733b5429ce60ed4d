"""CBOR: the vectors of RFC 8949, a round trip of anything, and no surprise from hostile bytes."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from snapshots import make_snapshot

from edged.adapters.zenoh.cbor import decode_cbor, encode_cbor
from edged.payload import encode, snapshot_to_json

# RFC 8949, appendix A (those that use what JSON can say, in the form that we write)
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
    """Both directions agree with RFC 8949."""
    assert data == encode_cbor(VECTORS[data]).hex()
    assert VECTORS[data] == decode_cbor(bytes.fromhex(data))


@pytest.mark.parametrize(("data", "value"), [("f93c00", 1.0), ("fa47c35000", 100000.0), ("f97c00", math.inf)])
def test_short_floats_of_other_writers_are_read(data, value):
    """Other libraries write floats in 16 or 32 bits where that is exact."""
    assert value == decode_cbor(bytes.fromhex(data))


@given(JSON)
def test_round_trip(value):
    """Whatever JSON can say comes back equal and of the same type."""
    back = decode_cbor(encode_cbor(value))
    assert value == back
    assert repr(value) == repr(back)


@given(st.binary(max_size=60))
def test_hostile_bytes_are_a_value_error_or_a_value(data):
    """No other exception, no hang, no allocation by a length that lies."""
    try:
        decode_cbor(data)
    except ValueError:
        return


@pytest.mark.parametrize(
    "data", ["9b7fffffffffffffff", "7b7fffffffffffffff", "81" * 5000, "bf", "c000", "", "0000"]
)
def test_what_is_not_written_here_is_refused(data):
    """Lying lengths, deep nesting, indefinite lengths, tags, nothing at all, and too much."""
    with pytest.raises(ValueError):
        decode_cbor(bytes.fromhex(data))


def test_a_result_says_the_same_in_both_encodings():
    """A snapshot in CBOR is its JSON, number by number, and shorter."""
    document = snapshot_to_json(make_snapshot())
    assert json.loads(encode(document)) == decode_cbor(encode_cbor(document))
    assert len(encode_cbor(document)) < len(encode(document))


def test_what_json_cannot_say_is_a_type_error():
    """An array that was not turned into lists is a bug, not a message."""
    with pytest.raises(TypeError, match="set"):
        encode_cbor({"x": {1}})
