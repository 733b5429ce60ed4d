"""Named arrays in one checksummed file, read without pickle."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edged.errors import FileFormatError
from edged.files.atomic import MAX_FILE_BYTES
from edged.files.zipmembers import open_zip, read_member


def pack_arrays(kind: str, version: int, arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Pack named arrays into one checksummed .npz (a zip of .npy; no pickle)."""
    buffer = io.BytesIO()
    header = json.dumps({"kind": kind, "version": version, "sha256": _digest(arrays)})
    # an array named allow_pickle would be taken for numpy's option: there is none of that name
    np.savez_compressed(buffer, __header__=np.array(header), **dict(arrays))  # type: ignore[arg-type]
    return buffer.getvalue()


def unpack_arrays(data: bytes, path: Path, kind: str, version: int) -> dict[str, npt.NDArray[Any]]:
    """Unpack the arrays of `pack_arrays`; damage, another kind or version is a `FileFormatError`.

    path : where the data came from, for messages.
    """
    try:
        with open_zip(io.BytesIO(data)) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > MAX_FILE_BYTES:
                raise FileFormatError(
                    f"{path}: unpacks to {unpacked} bytes, too many for a {kind}: at most {MAX_FILE_BYTES}"
                )
            arrays = {
                member.filename.removesuffix(".npy"): _array(
                    read_member(archive, member, MAX_FILE_BYTES), member.filename
                )
                for member in archive.infolist()
            }
        header = json.loads(str(arrays.pop("__header__")[()]))
        found = (header["kind"], header["version"], header["sha256"])
    except FileFormatError:
        raise
    except Exception as error:
        article = "an" if kind[0] in "aeiou" else "a"
        raise FileFormatError(f"{path}: not {article} {kind} file, or damaged: {error}") from error
    if found[0] != kind:
        raise FileFormatError(f"{path}: a {found[0]!r} file, expected {kind!r}")
    if found[1] != version:
        raise FileFormatError(f"{path}: {kind} version {found[1]!r}, this edged reads {version}")
    if found[2] != _digest(arrays):
        raise FileFormatError(f"{path}: checksum does not match: the file is damaged")
    return arrays


def _array(data: bytes, name: str) -> npt.NDArray[Any]:
    """Read one .npy array, after checking that its header claims exactly the bytes that are there.

    numpy allocates what the header claims before it reads.
    """
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{name}: unknown version of the .npy format {version}")
    read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    # Python integers: a huge claimed shape cannot overflow
    if math.prod(shape, start=dtype.itemsize) != len(data) - file.tell():
        raise ValueError(f"{name}: claims {shape} {dtype}, which is not what the file holds")
    file.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _digest(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}:{array.dtype.str}:{array.shape};".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
