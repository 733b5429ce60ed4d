"""`edged password`: the hash that protects the status page."""

from __future__ import annotations

import getpass
import sys

from edged.errors import UserError
from edged.identity.passwords import MIN_LENGTH, hash_password, why_weak


def password() -> int:
    """Ask twice on a terminal, or read one line from a pipe; print the hash."""
    if sys.stdin.isatty():
        first = getpass.getpass("password: ", stream=sys.stderr)
        if first != getpass.getpass("again: ", stream=sys.stderr):
            raise UserError("the two passwords differ")
    else:
        first = sys.stdin.readline().rstrip("\n")
    if len(first) < MIN_LENGTH:
        raise UserError(f"a password of at least {MIN_LENGTH} characters is expected")
    if why := why_weak(first):
        raise UserError(why)
    print(hash_password(first))
    sys.stderr.write(
        "edged: for web.password_hash or opcua.password_hash; "
        "edged check says whether others may read the file\n"
    )
    return 0
