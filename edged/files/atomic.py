"""Files and folders that are whole or not there, also after a power cut."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from edged.errors import FileFormatError

MAX_FILE_BYTES = 64 * 1024 * 1024  # a rig is kilobytes, a model is megabytes: more is a wrong file


def write_atomically(path: Path, data: bytes, *, mode: int = 0o644, group: int = -1) -> None:
    """Write a file so that after a power cut either the old or the new content is there.

    mode : other users read rigs; for a secret see `private.write_private`.  group : -1 for one's own.
    """
    path = Path(path)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            if group != -1:
                os.fchown(file.fileno(), -1, group)
            os.fchmod(file.fileno(), mode)  # mkstemp makes it private
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    sync(path.parent)


def write_file(path: Path, data: bytes) -> None:
    """`write_atomically` for what a person asked for. Raises `FileFormatError` where the disc refuses."""
    try:
        write_atomically(path, data)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written: {error.strerror or error}") from error


def replace_folder(folder: Path, files: Mapping[str, bytes], keep: Path | None = None) -> bool:
    """Let a folder hold these files, by name, and no others; after a crash it is the former or the new one.

    keep : beside it, where a former folder that was not empty remains; what was there before is removed.
    Returns whether there was one. Raises `OSError`; then nothing has changed.
    """
    make_folders(folder.parent)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        for name, data in files.items():
            file = draft / name
            file.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(file, data)
        draft.chmod(0o755)  # mkdtemp makes it private
        sync_folders(draft)
        in_use = folder.exists() and any(folder.iterdir())
        if in_use:
            if keep is not None and keep.exists():
                shutil.rmtree(keep)
            exchange(draft, folder)
        else:
            draft.replace(folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    sync(folder.parent)  # before what was there is touched: a disc may keep the later change alone
    if in_use and keep is not None:
        draft.rename(keep)
        sync(folder.parent)
    elif in_use:
        shutil.rmtree(draft, ignore_errors=True)
    return in_use


def exchange(one: Path, other: Path) -> None:
    """Swap what two names mean, in one step: at no moment is either missing. Raises `OSError`.

    renameat2(2) with RENAME_EXCHANGE, of Linux. File systems of networks may not know it: there it is
    three steps, and a crash between them leaves `other` beside its name, as `one` with a dash.
    """
    at_fdcwd, rename_exchange = -100, 2
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(at_fdcwd, os.fsencode(one), at_fdcwd, os.fsencode(other), rename_exchange) == 0:
        return
    number = ctypes.get_errno()
    if number not in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
        raise OSError(number, os.strerror(number), str(one))
    aside = other.rename(one.with_name(f"{one.name}-"))
    try:
        one.rename(other)
    except BaseException:
        aside.rename(other)
        raise
    aside.rename(one)


def make_folders(folder: Path) -> None:
    """Make a folder, and those that it is in, where they are missing; they last. Raises `OSError`."""
    missing = [place for place in (folder, *folder.parents) if not place.is_dir()]
    for place in reversed(missing):
        place.mkdir(exist_ok=True)
        sync(place.parent)


def sync(folder: Path) -> None:
    """Bring the names in a folder, or the content of a file, to the disc."""
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def sync_folders(folder: Path) -> None:
    """Bring the names in a folder and in all folders inside it to the disc."""
    for place, _, _ in os.walk(folder):
        sync(Path(place))


def read_bytes(path: Path, what: str) -> bytes:
    """Read a file of sane size, or raise `FileFormatError` that names it."""
    return _read(path, what, None)


def read_folder(folder: Path, names: Sequence[str], what: str) -> dict[str, bytes]:
    """Files of a folder by their name, all of them as they were before a `replace_folder`, or all after it.

    The folder is opened once: a replacement exchanges its name, and leaves alone what is open. Raises
    `FileFormatError` that names the file.
    """
    while True:
        try:
            opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise FileFormatError(f"{folder}: cannot read {what}: {error.strerror or error}") from error
        try:
            return {name: _read(folder / name, what, opened) for name in names}
        except FileFormatError:
            if _is_named(folder, opened):
                raise
            # replaced, and what it was has been removed meanwhile: read what is there now
        finally:
            os.close(opened)


def _is_named(folder: Path, opened: int) -> bool:
    """Whether a folder's name still means the one that is open."""
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))  # noqa: PTH116  (fstat has no path)
    except OSError:
        return True  # it is gone altogether


def _read(path: Path, what: str, folder: int | None) -> bytes:
    """A file; of an open folder the one of that name in it."""
    try:
        handle = os.open(path if folder is None else path.name, os.O_RDONLY | os.O_CLOEXEC, dir_fd=folder)
        with os.fdopen(handle, "rb") as file:
            size = os.fstat(handle).st_size
            if size > MAX_FILE_BYTES:
                raise FileFormatError(f"{path}: {size} bytes are too many for {what}")
            return file.read()
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read {what}: {error.strerror or error}") from error
