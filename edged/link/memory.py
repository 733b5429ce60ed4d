"""Bytes that one process passes to another as sealed memory, which nobody can change any more.

The pages count as memory of the process that created them, also for the limits of its service; the receiver
pays only for what it copies.
"""

from __future__ import annotations

import fcntl
import os

SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SEAL


def sealed(data: bytes) -> int:
    """Descriptor of sealed memory with these bytes; the caller closes it. Raises `OSError`."""
    handle = os.memfd_create("edged-handed-over", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(handle, view) :]
        fcntl.fcntl(handle, fcntl.F_ADD_SEALS, SEALS)
    except BaseException:
        os.close(handle)
        raise
    return handle


def is_sealed(handle: int) -> bool:
    """Whether a descriptor is of sealed memory; any other kind of file has no seals, and is not touched."""
    try:
        return fcntl.fcntl(handle, fcntl.F_GET_SEALS) & SEALS == SEALS
    except OSError:
        return False


def sealed_bytes(handle: int, most: int) -> bytes:
    """All bytes, whatever the file offset. Raises `ValueError` for memory not sealed, or too large."""
    if not is_sealed(handle):
        raise ValueError("expected sealed memory")
    size = os.fstat(handle).st_size
    if size > most:
        raise ValueError(f"{size} bytes are too many: expected at most {most}")
    data = bytearray()
    while len(data) < size and (part := os.pread(handle, size - len(data), len(data))):
        data += part
    return bytes(data)
