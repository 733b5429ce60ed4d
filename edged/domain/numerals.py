"""Strict parsing of numbers from other machines and people: ASCII digits only.

`int` and `float` also accept underscores, digits of any alphabet, `nan` and `inf`: truncated or mistyped
input would become another number, and a robot would move by it.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

_WHOLE = re.compile(r"[0-9]+")
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
LONGEST = 100
"""Limit of characters in a number; no genuine one has more."""


def whole(text: str) -> int:
    """Parse a number of digits only, without a sign. Raises ValueError.

    >>> whole("0042")
    42
    """
    if not is_whole(text):
        raise ValueError(f"expected a whole number, got {text[:LONGEST]!r}")
    return int(text)


def is_whole(text: str) -> bool:
    """Whether a text consists of ASCII digits only, as `whole` accepts them."""
    return len(text) <= LONGEST and _WHOLE.fullmatch(text) is not None


def decimal(text: str) -> float:
    """Parse a finite number with or without a decimal point. Raises ValueError.

    >>> decimal("-5123456E-4")
    -512.3456
    """
    if len(text) > LONGEST or not _DECIMAL.fullmatch(text) or not math.isfinite(value := float(text)):
        raise ValueError(f"expected a finite number, got {text[:LONGEST]!r}")
    return value


def json_of(text: str | bytes) -> Any:
    """Parse JSON (RFC 8259) with finite numbers only. Raises ValueError, RecursionError.

    >>> json_of("[1, 2.5]")
    [1, 2.5]
    """
    return json.loads(text, parse_constant=decimal, parse_float=decimal)


def number_in(value: object) -> float | None:
    """Return a document's value if it is a number; None for anything else.

    >>> number_in(2), number_in(True), number_in("2")
    (2.0, None, None)
    """
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def known(value: float | None, digits: int | None = None) -> float | None:
    """Return a number for JSON, rounded to `digits` decimals if given; None for NaN and infinity.

    >>> known(1.26, 1), known(math.nan)
    (1.3, None)
    """
    if value is None or not math.isfinite(value):
        return None
    return float(value) if digits is None else round(float(value), digits)
