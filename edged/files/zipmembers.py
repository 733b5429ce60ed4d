"""Read members of an untrusted ZIP; never unpacks more than the limit, whatever the file claims."""

from __future__ import annotations

import os
import zipfile
from typing import BinaryIO

MAX_DIRECTORY_BYTES = 64 * 1024
"""Largest central directory: room for several hundred members; edged's files have thirty. In memory it
takes ten times as much."""
_END, _END_BYTES = b"PK\5\6", 22
_END64, _END64_BYTES = b"PK\6\7", 20
"""End record of a ZIP without comment, and the ZIP64 locator before it in large ones (APPNOTE.TXT,
4.3.15)."""


def open_zip(file: BinaryIO) -> zipfile.ZipFile:
    """Open a ZIP after checking the size of its directory. Raises `zipfile.BadZipFile`."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _END_BYTES - _END64_BYTES))
    tail = file.read(_END_BYTES + _END64_BYTES)
    end = tail[-_END_BYTES:]
    if len(end) < _END_BYTES or not end.startswith(_END) or not end.endswith(b"\0\0"):  # zeros: no comment
        raise zipfile.BadZipFile("File is not a zip file")
    directory_bytes = int.from_bytes(end[12:16], "little")
    if tail.startswith(_END64) or directory_bytes > MAX_DIRECTORY_BYTES:
        raise zipfile.BadZipFile(f"its directory: expected at most {MAX_DIRECTORY_BYTES} bytes")
    file.seek(0)
    return zipfile.ZipFile(file)


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most_bytes: int) -> bytes:
    """Unpack a member. Raises `zipfile.BadZipFile` that names it, also if it is longer than stated.

    Only stored and deflated members: of these zipfile unpacks no more than requested, of other methods
    everything, whatever the size stated (CPython's `ZipExtFile._read1`).
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise zipfile.BadZipFile(f"{member.filename}: expected it stored or deflated")
    if member.file_size > most_bytes:
        raise zipfile.BadZipFile(
            f"{member.filename}: {member.file_size} bytes: expected at most {most_bytes}"
        )
    with archive.open(member) as file:
        return file.read(member.file_size + 1)
