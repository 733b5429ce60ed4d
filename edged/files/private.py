"""Files that hold a secret: who may read them, and how they are written."""

from __future__ import annotations

import grp
import os
import shlex
from pathlib import Path

from edged.errors import FileFormatError
from edged.files.atomic import read_bytes, write_atomically

CONFIG_GROUP = "edged-config"
"""The daemons' users are in it, and nobody else; tools/install makes it (systemd/edged-sysusers.conf)."""
OTHERS = 0o007
MIN_KEY_BYTES, MAX_KEY_BYTES = 32, 4096
"""Length of a key for HMAC-SHA256: at least that of its output (RFC 2104, section 3)."""


def write_private(path: Path, data: bytes, like: Path | None = None) -> None:
    """Write a file that others must not read. Raises `OSError`.

    like : the file that it replaces. Where others cannot read that, its group keeps what it may do.
    Otherwise, a file of root's is for the daemons too, and any other one for its owner alone; but where root
    replaces one and there is no group of daemons, it stays readable: the daemon may be one of the others.
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
    """The key that a cell and those who check what it says have in common: what stands in the file.

    White space around it does not count. Raises `FileFormatError` where others may read it, or it is short.
    """
    key = read_bytes(path, "a shared key", MAX_KEY_BYTES).strip()
    if len(key) < MIN_KEY_BYTES:
        expected = f"expected a shared key of {MIN_KEY_BYTES} at least, as of openssl rand -hex 32"
        raise FileFormatError(f"{path}: {len(key)} bytes: {expected}")
    if is_exposed(path):
        raise FileFormatError(f"{path}: every user of this machine may read it: {closing(path)}")
    return key


def is_exposed(path: Path) -> bool:
    """Whether every user of this machine may read the file; False for one that cannot be looked at."""
    try:
        return bool(path.stat().st_mode & 0o004)
    except OSError:
        return False


def closing(path: Path) -> str:
    """The command that keeps other users from reading it, but not the daemon."""
    file = shlex.quote(str(path.resolve()))
    if _config_group() is None:
        return f"chmod 600 {file}"
    return f"sudo chown root:{CONFIG_GROUP} {file}; sudo chmod 640 {file}"


def can_close(path: Path) -> bool:
    """Whether this process may take a file from other users, and no group of daemons is to have it."""
    try:
        return path.stat().st_uid == os.geteuid() and _config_group() is None
    except OSError:
        return False


def close_to_others(path: Path) -> None:
    """Let owner and group do what they may, and others nothing. Raises `OSError`."""
    path.chmod(path.stat().st_mode & 0o777 & ~OTHERS)


def _config_group() -> int | None:
    try:
        return grp.getgrnam(CONFIG_GROUP).gr_gid
    except KeyError:
        return None
