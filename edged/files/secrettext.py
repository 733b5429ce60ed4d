"""Remove secrets from a configuration's text, for recordings and anything else that leaves the machine."""

from __future__ import annotations

import re
import tomllib

from edged.config.fields import HASH_LEFT_OUT
from edged.config.tomltext import toml_of

HASH = re.compile(r"\$argon2[a-z]*\$[\w=,.+/$-]*", re.ASCII)
_STRING_OR_COMMENT = re.compile(
    r"""(\"{3}(?:\\.|[^\\])*?\"{3,5}|'{3}.*?'{3,5}|"(?:\\.|[^"\\\n])*"|'[^'\n]*')|[ \t]*#[^\n]*""", re.DOTALL
)
"""A TOML 1.0 string in any of its four kinds of quotes, or a comment."""


def without_secrets(text: bytes, *, comments: bool = True) -> bytes:
    """Replace every Argon2 hash, also in comments; returns b"" if a hash is hidden by escapes.

    comments : whether to keep them: people write passwords in comments, too.
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
