"""Members of a ZIP from anywhere: no more is unpacked than was asked for, whatever the file says."""

from __future__ import annotations

import os
import zipfile
from typing import BinaryIO

MAX_DIRECTORY_BYTES = 64 * 1024
"""Size of the directory of all members: room for some hundreds, and files of edged have thirty. In memory it
takes ten times as much."""
_END, _END_BYTES = b"PK\5\6", 22
_END64, _END64_BYTES = b"PK\6\7", 20
"""What ends a ZIP, without a comment, and what stands before that in large ones (APPNOTE.TXT, 4.3.15)."""


def open_zip(file: BinaryIO) -> zipfile.ZipFile:
    """A ZIP of which so far nothing but its directory was read. Raises `zipfile.BadZipFile`."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _END_BYTES - _END64_BYTES))
    tail = file.read(_END_BYTES + _END64_BYTES)
    end = tail[-_END_BYTES:]
    if len(end) < _END_BYTES or not end.startswith(_END) or not end.endswith(b"\0\0"):  # the last: no comment
        raise zipfile.BadZipFile("File is not a zip file")
    directory_bytes = int.from_bytes(end[12:16], "little")
    if tail.startswith(_END64) or directory_bytes > MAX_DIRECTORY_BYTES:
        raise zipfile.BadZipFile(f"its directory: expected at most {MAX_DIRECTORY_BYTES} bytes")
    file.seek(0)
    return zipfile.ZipFile(file)


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most_bytes: int) -> bytes:
    """A member unpacked. Raises `zipfile.BadZipFile` that names it, also where it is longer than it says.

    Stored and deflated ones alone: of these zipfile unpacks as much as is asked for, of the others all that
    there is, whatever they said (CPython's `ZipExtFile._read1`).
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise zipfile.BadZipFile(f"{member.filename}: expected it stored or deflated")
    if member.file_size > most_bytes:
        raise zipfile.BadZipFile(
            f"{member.filename}: {member.file_size} bytes: expected at most {most_bytes}"
        )
    with archive.open(member) as file:
        return file.read(member.file_size + 1)
