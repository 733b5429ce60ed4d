"""Registers as text for people: the exact value, and the meaning of bits, codes and times."""

from __future__ import annotations

import enum
import math
import re
import struct
from collections.abc import Mapping
from datetime import UTC, datetime

from edged.domain.cell import SetupSource
from edged.domain.measurement import Reject
from edged.domain.registration import Method
from edged.plc.registers.schema import (
    INT32_MIN,
    Flag,
    Kind,
    Number,
    Option,
    Register,
    ResultCode,
    StatusBit,
    Warn,
)

BITS: Mapping[str, type[enum.IntFlag]] = {
    "STATUS_BITS": StatusBit,
    "FLAGS": Flag,
    "OPTIONS": Option,
    "WARNING": Warn,
    "REJECT": Reject,
}
CODES: Mapping[str, type[enum.IntEnum]] = {
    **dict.fromkeys(("RESULT", "UR_RESULT", "F_RESULT"), ResultCode),
    "SETUP_SOURCE": SetupSource,
    "H_METHOD": Method,
}
MAX_NS = 253_402_300_799 * 10**9
"""End of the year 9999, the last that `datetime` can hold."""


def text_of(register: Register, value: Number) -> str:
    """Format the exact value, "–" if not finite; for an F32 the shortest decimal that reads back the same."""
    if isinstance(value, float) and not math.isfinite(value):
        return "–"
    if register.kind is not Kind.F32:
        return str(int(value))
    bits = struct.pack(">f", float(value))
    return next(text for digits in range(1, 10) if _bits(text := f"{value:.{digits}g}") == bits)


def _bits(text: str) -> bytes:
    """Bytes of a float given as text; b"" when it rounds beyond the largest float32."""
    try:
        return struct.pack(">f", float(text))
    except OverflowError:
        return b""


def meaning_of(register: Register, value: Number) -> str:
    """Explain a value in words, names and usual units; "" when the number needs no explanation."""
    if isinstance(value, float) and not math.isfinite(value):
        return "no value"
    number = int(value)
    if register.kind is Kind.I32 and number == INT32_MIN:
        return "no value"
    if (bits := BITS.get(register.name)) is not None:
        return ", ".join(str(bit.name) for bit in bits if number & bit) or "none"
    if (codes := CODES.get(register.name)) is not None:
        known = {int(code): code.name for code in codes}
        return known.get(number, "unknown")
    if register.kind is Kind.U64 and register.unit == "ns" and 0 < number < MAX_NS:
        return f"{datetime.fromtimestamp(number / 1e9, UTC):%Y-%m-%d %H:%M:%S.%f} UTC"
    if register.unit == "µm":
        return f"{number / 1000:.3f} mm"
    if register.unit == "0.001°":
        return f"{number / 1000:.3f}°"
    listed = re.search(rf"(?:^|, ){number}:? ([A-Za-z_][A-Za-z_ -]*)", register.help)
    return listed[1] if listed and not register.unit else ""
