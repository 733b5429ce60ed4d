"""Registers as text: no digit is lost, and bits, codes and times have names."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edged.plc.registers import BLOCKS, Kind, Register
from edged.plc.registers.readings import meaning_of, text_of
from edged.plc.registers.schema import INT32_MIN

REGISTERS = {register.name: register for block in BLOCKS for register in block.registers}


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        (Kind.U32, 3327703185, "3327703185"),
        (Kind.I32, INT32_MIN, "-2147483648"),
        (Kind.U64, 1_700_000_000_123_456_789, "1700000000123456789"),
        (Kind.F32, struct.unpack(">f", struct.pack(">f", 0.1))[0], "0.1"),
        (Kind.F32, math.nan, "–"),
    ],
)
def test_a_value_is_shown_with_every_digit(kind: Kind, value: float, expected: str) -> None:
    """Large integers are not rounded, and a float has as few digits as needed."""
    assert expected == text_of(Register("X", 0, kind, "", ""), value)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_text_of_a_float_is_that_float(value: float) -> None:
    """Parsing the text gives the same bits."""
    text = text_of(Register("X", 0, Kind.F32, "", ""), value)
    assert struct.pack(">f", value) == struct.pack(">f", float(text))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("RESULT", 2, "NO_TARGET"),
        ("STATUS_BITS", 0b100001, "READY, RESULT_VALID"),
        ("REJECT", 0, "none"),
        ("STATE", 1, "READY"),
        ("COMMAND", 2, "CHANGE_JOB"),
        ("X", 434285, "434.285 mm"),
        ("X", INT32_MIN, "no value"),
        ("EXPOSURE_NS", 1_700_000_000_000_000_000, "2023-11-14 22:13:20.000000 UTC"),
        ("SEQ_HEAD", 7, ""),
    ],
)
def test_a_value_has_its_meaning(name: str, value: int, expected: str) -> None:
    """Codes and bits are shown by name, lengths in mm, times as dates."""
    assert expected == meaning_of(REGISTERS[name], value)
