"""Files that hold a secret: their permissions, and how they are written."""

from __future__ import annotations

import grp
import os
import shlex
from pathlib import Path

from edged.errors import FileFormatError
from edged.files.atomic import read_bytes, write_atomically

CONFIG_GROUP = "edged-config"
"""Group of the daemons' users only; tools/install creates it (systemd/edged-sysusers.conf)."""
OTHERS = 0o007
MIN_KEY_BYTES, MAX_KEY_BYTES = 32, 4096
"""Length of a key for HMAC-SHA256: at least that of the hash output (RFC 2104, section 3)."""


def write_private(path: Path, data: bytes, like: Path | None = None) -> None:
    """Write a file that others must not read. Raises `OSError`.

    like : the file that it replaces. If others have no access to that, its group and mode are kept.
    Otherwise a file of root's is readable by the daemons, too, and any other file by its owner alone. But if
    root replaces a file and there is no group of daemons, mode and group stay: the daemon may be one of the
    others.
    """
    is_root, daemons = os.geteuid() == 0, _config_group()
    found = like.stat() if like is not None and like.exists() else None
    mode, group = 0o600, -1
    if found is not None and (not found.st_mode & OTHERS or (is_root and daemons is None)):
        mode, group = found.st_mode & 0o777, found.st_gid
    elif is_root and daemons is not None:
        mode, group = 0o640, daemons
    write_atomically(path, data, mode=mode, group=group)


def read_shared_key(path: Path) -> bytes:
    """Read the key shared by a cell and those who verify its messages.

    Surrounding white space is ignored. Raises `FileFormatError` if others may read the file, or it is short.
    """
    key = read_bytes(path, "a shared key", MAX_KEY_BYTES).strip()
    if len(key) < MIN_KEY_BYTES:
        expected = f"expected a shared key of {MIN_KEY_BYTES} at least, as of openssl rand -hex 32"
        raise FileFormatError(f"{path}: {len(key)} bytes: {expected}")
    if is_exposed(path):
        raise FileFormatError(f"{path}: every user of this machine may read it: {chmod_command(path)}")
    return key


def is_exposed(path: Path) -> bool:
    """Whether every user of this machine may read the file; False if it cannot be examined."""
    try:
        return bool(path.stat().st_mode & 0o004)
    except OSError:
        return False


def chmod_command(path: Path) -> str:
    """Shell command that makes the file unreadable for other users, but not for the daemon."""
    file = shlex.quote(str(path.resolve()))
    if _config_group() is None:
        return f"chmod 600 {file}"
    return f"sudo chown root:{CONFIG_GROUP} {file}; sudo chmod 640 {file}"


def can_close(path: Path) -> bool:
    """Whether this process owns the file, and there is no group of daemons that it should belong to."""
    try:
        return path.stat().st_uid == os.geteuid() and _config_group() is None
    except OSError:
        return False


def close_to_others(path: Path) -> None:
    """Remove all permissions of others; those of owner and group stay. Raises `OSError`."""
    path.chmod(path.stat().st_mode & 0o777 & ~OTHERS)


def _config_group() -> int | None:
    try:
        return grp.getgrnam(CONFIG_GROUP).gr_gid
    except KeyError:
        return None
