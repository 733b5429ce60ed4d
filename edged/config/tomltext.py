"""Parsing of untrusted TOML, with limits on length and keys so that it takes little time."""

from __future__ import annotations

import re
import tomllib
from typing import Any

MAX_TOML_BYTES = 1024 * 1024
"""Maximum length; a configuration has kilobytes, a job with 256 features of each kind 700 kB."""
MAX_KEY_PARTS = 16
"""Maximum parts of a dotted key; ours have four. tomllib keeps a tuple for each prefix of a key: 2.8 s and
1.5 GB for 20,000 parts (CPython 3.11). Dotted words in strings and comments count, too."""
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}")


def toml_of(content: bytes | str) -> dict[str, Any]:
    """Parse a TOML file, with or without a byte order mark.

    Raises `UnicodeDecodeError`, `tomllib.TOMLDecodeError` with the line, and RecursionError.
    """
    text = content if isinstance(content, str) else content.decode("utf-8-sig")
    if len(text) > MAX_TOML_BYTES:
        raise tomllib.TOMLDecodeError(f"{len(text)} letters, expected at most {MAX_TOML_BYTES}")
    if found := _LONG_KEY.search(text):
        line = text.count("\n", 0, found.start()) + 1
        column = found.start() - text.rfind("\n", 0, found.start())
        raise tomllib.TOMLDecodeError(
            f"A key of more than {MAX_KEY_PARTS} parts (at line {line}, column {column})"
        )
    return tomllib.loads(text)
