"""One-time engineer invitation: a code for one name, read from the journal or made by root."""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
import time
from collections.abc import Callable
from pathlib import Path

from edged.domain.numerals import json_of
from edged.errors import FileFormatError
from edged.files.atomic import make_folders, read_bytes, sync, write_atomically
from edged.identity.users import key_of

LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
"""Letters and digits that cannot be confused with each other."""
GROUPS, GROUP = 3, 4
"""Groups in a code, and letters in a group: 59 bits, not to be guessed within a day."""
VALID_S = 24 * 3600.0


class Invite:
    """The only valid code, if any, stored as a digest in a file. A new code replaces it."""

    def __init__(self, folder: Path, utc_s: Callable[[], float] = time.time) -> None:
        self._path = folder / "invite.json"
        self._utc_s = utc_s

    def make(self, name: str = "") -> str:
        """Create a code that is valid for a day, or until it is used. Raises `OSError`.

        name : of the user that it is for; "" : a new user, with a name that no user has.
        """
        code = "-".join("".join(secrets.choice(LETTERS) for _ in range(GROUP)) for _ in range(GROUPS))
        document = {"digest": _digest(code), "until_s": self._utc_s() + VALID_S, "name": name}
        make_folders(self._path.parent)
        write_atomically(self._path, json.dumps(document).encode(), mode=0o600, is_state=True)
        return code

    def is_valid(self, code: str, name: str, *, is_new: bool) -> bool:
        """Whether this code is now valid for this name; False if the file cannot be used.

        is_new : no user has the name, nor one that looks like it.
        """
        try:
            document = json_of(read_bytes(self._path, "an invitation"))
            digest, until_s, wanted = document["digest"], document["until_s"], document["name"]
            is_ours = hmac.compare_digest(str(digest).encode(), _digest(code).encode())
            is_theirs = key_of(wanted) == key_of(name) if wanted else is_new
            return is_ours and is_theirs and self._utc_s() < float(until_s)
        except (FileFormatError, ValueError, TypeError, KeyError, RecursionError):
            return False

    def take(self, code: str, name: str, *, is_new: bool) -> bool:
        """Use up the code; return whether it was valid, as `is_valid`. Raises `OSError`."""
        if not self.is_valid(code, name, is_new=is_new):
            return False
        try:
            self._path.unlink()
        except FileNotFoundError:  # another request was quicker
            return False
        sync(self._path.parent)
        return True


def _digest(code: str) -> str:
    """Digest of a code; as codes are typed by hand, case, blanks and dashes do not count."""
    letters = "".join(letter for letter in code.lower() if letter.isalnum())
    return hashlib.sha256(letters.encode("utf-8", "surrogateescape")).hexdigest()
