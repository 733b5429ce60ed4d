"""Files and folders that are whole or not there, also after a power cut."""

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

MAX_FILE_BYTES = 64 * 1024 * 1024  # a model is megabytes: more is a wrong file
MAX_DOCUMENT_BYTES = 4 * 1024 * 1024
"""Size of a JSON file: in memory it takes up to 25 times as much (`[{},{},...`, CPython 3.11), and a rig with
the figures of a hundred views is a tenth of it."""
TEMPORARY_NAMES = 100
"""How many are tried before all count as taken: of 2^32 two hardly ever are, unless somebody guesses them."""


def write_atomically(
    path: Path, data: bytes, *, mode: int = 0o644, group: int = -1, is_state: bool = False
) -> None:
    """Write a file so that after a power cut either the old or the new content is there.

    mode : other users read rigs; for a secret see `private.write_private`.  group : -1 for one's own.
    is_state : a file that root writes gets the folder's owner: the daemon.
    """
    path = Path(path)
    with open_folder(path.parent) as folder:
        handle, temporary = _new_file(f".{path.name}.", folder)
        try:
            with os.fdopen(handle, "wb") as file:
                if is_state:
                    give_like(handle, folder)
                if group != -1:
                    os.fchown(handle, -1, group)
                os.fchmod(handle, mode)  # it was made private
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
    """A file that was not there, nor a link of its name; and its name. Raises `OSError`."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    for _ in range(TEMPORARY_NAMES):
        name = f"{beginning}{token_hex(4)}"
        with suppress(FileExistsError):
            return os.open(name, flags, 0o600, dir_fd=folder), name
    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), beginning)


def give_like(handle: int, folder: int) -> None:
    """Give a new file of root's the owner of the open folder that it is in. Raises `OSError`."""
    if os.geteuid() == 0:
        owner = os.fstat(folder)
        os.fchown(handle, owner.st_uid, owner.st_gid)


@contextmanager
def open_folder(folder: Path) -> Iterator[int]:
    """A folder by its descriptor: it stays the same one, whatever its name means next. Raises `OSError`."""
    opened = open_to_read(folder, os.O_DIRECTORY)
    try:
        yield opened
    finally:
        os.close(opened)


def write_file(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """`write_atomically` for what a person asked for. Raises `FileFormatError` where the disc refuses."""
    with translated(FileFormatError, f"{path}: cannot be written"):
        write_atomically(path, data, mode=mode)


def generations(first: Path) -> dict[int, Path]:
    """What is there of x.old, x.2.old, x.3.old, ... by its number; first : x.old. Raises `OSError`."""
    later = re.compile(rf"{re.escape(first.stem)}\.([1-9][0-9]{{0,5}}){re.escape(first.suffix)}")
    found = {1: first} if os.path.lexists(first) else {}
    for place in first.parent.iterdir():
        if numbered := later.fullmatch(place.name):
            found[int(numbered[1])] = place
    return found


def next_generation(first: Path) -> Path:
    """Where what is replaced next is kept: later than each that is there. Raises `OSError`."""
    number = max(generations(first), default=0) + 1
    return first if number == 1 else first.with_name(f"{first.stem}.{number}{first.suffix}")


def replace_folder(folder: Path, files: Mapping[str, bytes], keep: Path | None = None) -> Path | None:
    """Let a folder hold these files, by name, and no others; after a crash it is the former or the new one.

    keep : beside it, where the first former folder that was not empty remains; the next ones are later
    generations. Returns where the former one is now; None where none is kept, or none had to be replaced.
    Raises `OSError`; then nothing has changed.
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
        return keep
    if in_use:
        shutil.rmtree(draft, ignore_errors=True)
    return None


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Whether a folder holds just these files already; False where that cannot be told."""
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


def exchange(first: Path, second: Path) -> None:
    """Swap what two names mean, in one step: at no moment is either missing. Raises `OSError`.

    renameat2(2) with RENAME_EXCHANGE, which is Linux only. Network file systems may lack it: there it takes
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


def read_bytes(path: Path, what: str, most: int = MAX_FILE_BYTES) -> bytes:
    """Read a file of sane size, or raise `FileFormatError` that names it. most : bytes of it."""
    return _read(path, what, None, most)


def read_folder(folder: Path, names: Sequence[str], what: str) -> dict[str, bytes]:
    """Files of a folder by their name, all of them as they were before a `replace_folder`, or all after it.

    The folder is opened once: a replacement exchanges its name, and leaves alone what is open. Raises
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
            # replaced, and what it was has been removed meanwhile: read what is there now
        finally:
            os.close(opened)


def _is_named(folder: Path, opened: int) -> bool:
    """Whether a folder's name still means the one that is open."""
    try:
        return os.path.samestat(os.stat(folder), os.fstat(opened))  # noqa: PTH116  (fstat has no path)
    except OSError:
        return True  # it is gone altogether


def _read(path: Path, what: str, folder: int | None, most: int = MAX_FILE_BYTES) -> bytes:
    """A file; of an open folder the one of that name in it."""
    with translated(FileFormatError, f"{path}: cannot read {what}"):
        handle = open_to_read(path if folder is None else Path(path.name), folder=folder)
        with os.fdopen(handle, "rb") as file:
            size = os.fstat(handle).st_size
            data = b"" if size > most else file.read(most + 1)  # a device has no size, and no end
            if max(size, len(data)) > most:
                raise FileFormatError(
                    f"{path}: {max(size, len(data))} bytes are too many for {what}: expected at most {most}"
                )
            return data


def put_back(path: Path, former: bytes | None) -> None:
    """Have a file as it was; None: there was none. Raises `FileFormatError`."""
    if former is None:
        path.unlink(missing_ok=True)
    else:
        write_file(path, former)
