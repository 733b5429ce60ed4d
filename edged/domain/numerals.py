"""Numbers as machines and strangers write them: digits of ASCII, and nothing that only Python takes for one.

`int` and `float` also read underscores, digits of any alphabet, `nan` and `inf`: what was torn or mistyped
would be another number, and a robot would move by it.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

_WHOLE = re.compile(r"[0-9]+")
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
LONGEST = 100
"""Characters of a number; none that is meant has more."""


def whole(text: str) -> int:
    """A number of digits alone, without a sign. Raises ValueError.

    >>> whole("0042")
    42
    """
    if not is_whole(text):
        raise ValueError(f"expected a whole number, got {text[:LONGEST]!r}")
    return int(text)


def is_whole(text: str) -> bool:
    """Whether a text is digits of ASCII alone, as `whole` reads them."""
    return len(text) <= LONGEST and _WHOLE.fullmatch(text) is not None


def decimal(text: str) -> float:
    """A finite number with a decimal point, or without one. Raises ValueError.

    >>> decimal("-5123456E-4")
    -512.3456
    """
    if len(text) > LONGEST or not _DECIMAL.fullmatch(text) or not math.isfinite(value := float(text)):
        raise ValueError(f"expected a finite number, got {text[:LONGEST]!r}")
    return value


def json_of(text: str | bytes) -> Any:
    """A document of JSON (RFC 8259), whose numbers are finite. Raises ValueError, RecursionError.

    >>> json_of("[1, 2.5]")
    [1, 2.5]
    """
    return json.loads(text, parse_constant=decimal, parse_float=decimal)


def number_in(value: object) -> float | None:
    """What stands in a document, if it is a number; None for anything else.

    >>> number_in(2), number_in(True), number_in("2")
    (2.0, None, None)
    """
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def known(value: float | None, digits: int | None = None) -> float | None:
    """A number as JSON has it, rounded to so many digits; None for NaN and infinity.

    >>> known(1.26, 1), known(math.nan)
    (1.3, None)
    """
    if value is None or not math.isfinite(value):
        return None
    return float(value) if digits is None else round(float(value), digits)
