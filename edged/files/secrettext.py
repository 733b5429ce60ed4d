"""A configuration's text without its secrets, for recordings and whatever else leaves the machine."""

from __future__ import annotations

import re
import tomllib

from edged.config.fields import HASH_LEFT_OUT
from edged.config.tomltext import toml_of

HASH = re.compile(r"\$argon2[a-z]*\$[\w=,.+/$-]*", re.ASCII)
_STRING_OR_COMMENT = re.compile(
    r"""(\"{3}(?:\\.|[^\\])*?\"{3,5}|'{3}.*?'{3,5}|"(?:\\.|[^"\\\n])*"|'[^'\n]*')|[ \t]*#[^\n]*""", re.DOTALL
)
"""A text in TOML's four kinds of quotes (TOML 1.0), or a comment."""


def without_secrets(text: bytes, *, comments: bool = True) -> bytes:
    """The text with every Argon2 hash replaced, also in comments; b"" where one is hidden in escapes.

    comments : whether they stay: people write passwords in them, too.
    """
    plain = HASH.sub(HASH_LEFT_OUT, text.decode("utf-8", "replace"))
    try:
        document = toml_of(plain)
        if not comments:
            plain = _STRING_OR_COMMENT.sub(lambda found: found[1] or "", plain)
            if toml_of(plain) != document:
                return b""
    except tomllib.TOMLDecodeError:
        return b""
    sections = [section for section in document.values() if isinstance(section, dict)]
    hashes = [
        value for section in sections for name, value in section.items() if name.endswith("password_hash")
    ]
    return plain.encode() if all(hashed in ("", HASH_LEFT_OUT) for hashed in hashes) else b""
