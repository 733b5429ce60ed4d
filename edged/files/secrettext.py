"""A configuration's text without its secrets, for recordings and whatever else leaves the machine."""

from __future__ import annotations

import re
import tomllib

LEFT_OUT = "$argon2-left-out"
"""In place of a password's hash: a configuration that can be read, and a password that nothing fits."""
HASH = re.compile(r"\$argon2[a-z]*\$[\w=,.+/$-]*", re.ASCII)


def without_secrets(text: bytes) -> bytes:
    """The text with every Argon2 hash replaced, also in comments; b"" where one is hidden in escapes."""
    plain = HASH.sub(LEFT_OUT, text.decode("utf-8", "replace"))
    try:
        web = tomllib.loads(plain).get("web")
    except tomllib.TOMLDecodeError:
        return b""
    hashed = web.get("password_hash", "") if isinstance(web, dict) else ""
    return plain.encode() if hashed in ("", LEFT_OUT) else b""
