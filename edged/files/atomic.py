"""Atomic writes: a file or folder is either complete or absent, even after a power cut."""

from __future__ import annotations

import ctypes
import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

from edged.errors import FileFormatError, translated
from edged.owners import open_to_read

MAX_FILE_BYTES = 64 * 1024 * 1024  # a model takes a few megabytes: anything larger is the wrong file
MAX_DOCUMENT_BYTES = 4 * 1024 * 1024
"""Largest JSON file: parsed, it takes up to 25 times as much memory (`[{},{},...`, CPython 3.11). A rig with
the figures of a hundred views is a tenth of this size."""
TEMPORARY_NAMES = 100
"""Names tried before giving up: two of 2^32 random names hardly ever collide unless someone guesses them."""


def write_atomically(
    path: Path, data: bytes, *, mode: int = 0o644, group: int = -1, is_state: bool = False
) -> None:
    """Write a file so that after a power cut it has either the old or the new content, complete.

    mode : readable by other users by default, as rigs are; for a secret see `private.write_private`.
    group : -1 for the process's own.  is_state : when root writes it, give the file the folder's owner,
    which is the daemon.
    """
    path = Path(path)
    with open_folder(path.parent) as folder:
        handle, temporary = _new_file(f".{path.name}.", folder)
        try:
            with os.fdopen(handle, "wb") as file:
                if is_state:
                    copy_owner(handle, folder)
                if group != -1:
                    os.fchown(handle, -1, group)
                os.fchmod(handle, mode)  # it was created private
                file.write(data)
                file.flush()
                os.fsync(handle)
            os.replace(temporary, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with suppress(FileNotFoundError):
                os.unlink(temporary, dir_fd=folder)
            raise
        os.fsync(folder)


def _new_file(beginning: str, folder: int) -> tuple[int, str]:
    """Create a file under a random name, not following links; its descriptor and name. Raises `OSError`."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    for _ in range(TEMPORARY_NAMES):
        name = f"{beginning}{token_hex(4)}"
        with suppress(FileExistsError):
            return os.open(name, flags, 0o600, dir_fd=folder), name
    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), beginning)


def copy_owner(handle: int, folder: int) -> None:
    """When running as root, give a new file the owner of its (open) folder. Raises `OSError`."""
    if os.geteuid() == 0:
        owner = os.fstat(folder)
        os.fchown(handle, owner.st_uid, owner.st_gid)


@contextmanager
def open_folder(folder: Path) -> Iterator[int]:
    """Open a folder as a descriptor, which stays valid even if its path is replaced. Raises `OSError`."""
    opened = open_to_read(folder, os.O_DIRECTORY)
    try:
        yield opened
    finally:
        os.close(opened)


def write_file(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """`write_atomically` for files a user asked for. Raises `FileFormatError` if it cannot be written."""
    with translated(FileFormatError, f"{path}: cannot be written"):
        write_atomically(path, data, mode=mode)


def generations(first: Path) -> dict[int, Path]:
    """Existing paths of x.old, x.2.old, x.3.old, ... by their number; first : x.old. Raises `OSError`."""
    later = re.compile(rf"{re.escape(first.stem)}\.([1-9][0-9]{{0,5}}){re.escape(first.suffix)}")
    found = {1: first} if os.path.lexists(first) else {}
    for place in first.parent.iterdir():
        if numbered := later.fullmatch(place.name):
            found[int(numbered[1])] = place
    return found


def next_generation(first: Path) -> Path:
    """Path for the next generation, numbered after all existing ones. Raises `OSError`."""
    number = max(generations(first), default=0) + 1
    return first if number == 1 else first.with_name(f"{first.stem}.{number}{first.suffix}")


def replace_folder(folder: Path, files: Mapping[str, bytes], keep: Path | None = None) -> Path | None:
    """Replace the content of a folder by exactly these files; after a crash it is either the old or the new.

    keep : path beside it under which the former folder is kept unless it was empty; later ones are kept as
    later generations. Returns the path of the kept folder; None if none is kept or nothing had to be
    replaced. Raises `OSError`; nothing has changed then.
    """
    make_folders(folder.parent)
    if _holds(folder, files):
        return None
    if keep is not None:
        keep = next_generation(keep)
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
            swap_paths(draft, folder)
        else:
            draft.replace(folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    sync(folder.parent)  # before the former folder is touched: a disc may persist only the later change
    if in_use and keep is not None:
        draft.rename(keep)
        sync(folder.parent)
        return keep
    if in_use:
        shutil.rmtree(draft, ignore_errors=True)
    return None


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Whether a folder already holds exactly these files; False if it cannot be read."""
    try:
        there = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if not path.is_dir()}
        return (
            bool(files)
            and there.keys() == files.keys()
            and all(
                path.is_file() and path.stat().st_size == len(files[name]) for name, path in there.items()
            )
            and all(path.read_bytes() == files[name] for name, path in there.items())
        )
    except OSError:
        return False


def swap_paths(first: Path, second: Path) -> None:
    """Swap two paths atomically, so that neither is ever missing. Raises `OSError`.

    Uses renameat2(2) with RENAME_EXCHANGE (Linux only). Network file systems may lack it: there it takes
    three steps, and a crash between them leaves `second` under the name of `first` with a dash.
    """
    at_fdcwd, rename_exchange = -100, 2
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(at_fdcwd, os.fsencode(first), at_fdcwd, os.fsencode(second), rename_exchange) == 0:
        return
    number = ctypes.get_errno()
    if number not in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
        raise OSError(number, os.strerror(number), str(first))
    aside = second.rename(first.with_name(f"{first.name}-"))
    try:
        first.rename(second)
    except BaseException:
        aside.rename(second)
        raise
    aside.rename(first)


def make_folders(folder: Path) -> None:
    """Make a folder and its missing parents, synced to disc. Raises `OSError`."""
    missing = [place for place in (folder, *folder.parents) if not place.is_dir()]
    for place in reversed(missing):
        place.mkdir(exist_ok=True)
        sync(place.parent)


def sync(folder: Path) -> None:
    """fsync the entries of a folder, or the content of a file."""
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def sync_folders(folder: Path) -> None:
    """fsync the entries of a folder and of all folders inside it."""
    for place, _, _ in os.walk(folder):
        sync(Path(place))


def read_bytes(path: Path, what: str, most: int = MAX_FILE_BYTES) -> bytes:
    """Read a file of limited size, or raise `FileFormatError` that names it. most : largest size, bytes."""
    return _read(path, what, None, most)


def read_folder(folder: Path, names: Sequence[str], what: str) -> dict[str, bytes]:
    """Read files of a folder by name, consistently: all from before a `replace_folder` or all from after.

    The folder is opened once: a replacement exchanges names and does not affect the open folder. Raises
    `FileFormatError` that names the file.
    """
    while True:
        with translated(FileFormatError, f"{folder}: cannot read {what}"):
            opened = open_to_read(folder, os.O_DIRECTORY)
        try:
            return {name: _read(folder / name, what, opened) for name in names}
        except FileFormatError:
            if _is_named(folder, opened):
                raise
            # the folder was replaced and the former one removed meanwhile: read the new one
        finally:
            os.close(opened)


def _is_named(folder: Path, opened: int) -> bool:
    """Whether a folder's path still refers to the open descriptor."""
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))  # noqa: PTH116  (fstat has no path)
    except OSError:
        return True  # it is gone altogether


def _read(path: Path, what: str, folder: int | None, most: int = MAX_FILE_BYTES) -> bytes:
    """Read a file by path, or by its name within an open folder."""
    with translated(FileFormatError, f"{path}: cannot read {what}"):
        handle = open_to_read(path if folder is None else Path(path.name), folder=folder)
        with os.fdopen(handle, "rb") as file:
            size = os.fstat(handle).st_size
            data = b"" if size > most else file.read(most + 1)  # a device reports no size and has no end
            if max(size, len(data)) > most:
                raise FileFormatError(
                    f"{path}: {max(size, len(data))} bytes are too many for {what}: expected at most {most}"
                )
            return data


def restore_file(path: Path, former: bytes | None) -> None:
    """Restore a file's former content; None: remove the file. Raises `FileFormatError`."""
    if former is None:
        path.unlink(missing_ok=True)
    else:
        write_file(path, former)
