"""Some files of a folder exchanged in one step, beside others that stay."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path

from edged.files.atomic import exchange, make_folders, open_folder, sync, sync_folders, write_atomically
from edged.files.private import write_private
from edged.owners import open_plain


def replace_files(
    folder: Path,
    files: Mapping[str, bytes],
    replaced: Collection[str],
    keep: Path,
    *,
    private: Collection[str] = (),
) -> bool:
    """Let a folder hold these files, by name, instead of those replaced; the others stay as they are.

    After a crash it is the former folder or the new one. keep : a free name beside the folder, for the files
    replaced. private : of the files, those that others must not read. Returns whether anything is kept.
    Raises `OSError`; then nothing has changed.
    """
    make_folders(folder.parent)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        staying = _link_others(folder, draft, replaced) if folder.is_dir() else set()
        for name, data in files.items():
            file = draft / name
            file.parent.mkdir(parents=True, exist_ok=True)
            if name in private:
                write_private(file, data, like=folder / name)
            else:
                write_atomically(file, data)
        sync_folders(draft)
        if not folder.is_dir():
            draft.chmod(0o755)  # mkdtemp made it private
            sync(draft)
            draft.replace(folder)
            sync(folder.parent)
            return False
        _like_former(draft, folder)
        exchange(draft, folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    sync(folder.parent)  # before the former folder, whose name is the draft's now, is taken apart
    if replaced:
        _take_out(staying, draft)
        draft.rename(keep)
    else:
        shutil.rmtree(draft)
    sync(folder.parent)
    return bool(replaced)


def _link_others(folder: Path, draft: Path, replaced: Collection[str]) -> set[str]:
    """Give the draft every other file of the folder: the same file, not a copy. Returns their names.

    The folder is walked by descriptors: who owns one in it may exchange its name for a link meanwhile.
    """
    staying = set[str]()
    for place, folders, names, opened in os.fwalk(folder):
        here = Path(place).relative_to(folder)
        links = [name for name in folders if _is_link(name, opened)]
        for name in folders:
            if name not in links:
                (draft / here / name).mkdir()
        for name in [*names, *links]:
            relative = (here / name).as_posix()
            if relative not in replaced:
                _link(name, opened, draft / relative)
                staying.add(relative)
    _remove_empty(draft, folder)
    return staying


def _is_link(name: str, folder: int) -> bool:
    return stat.S_ISLNK(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)


def _link(name: str, folder: int, target: Path) -> None:
    """Give a file of an open folder a second name; or copy it, on the disc when this returns."""
    try:
        os.link(name, target, src_dir_fd=folder, follow_symlinks=False)
    except OSError:  # a file system without links, or a file of somebody else's
        if _is_link(name, folder):
            target.symlink_to(os.readlink(name, dir_fd=folder))
        else:
            _copy(name, folder, target)


def _copy(name: str, folder: int, target: Path) -> None:
    handle = open_plain(name, os.O_RDONLY, folder)
    with os.fdopen(handle, "rb") as source, target.open("xb") as copy:
        shutil.copyfileobj(source, copy)
        about = os.fstat(handle)
        os.fchmod(copy.fileno(), about.st_mode & 0o7777)
        os.utime(copy.fileno(), ns=(about.st_atime_ns, about.st_mtime_ns))
        copy.flush()
        os.fsync(copy.fileno())


def _like_former(draft: Path, folder: Path) -> None:
    """Give each folder owner, group and mode of the former one, as far as one may.

    The deepest first, and when all is written: who gets a folder may put a link in place of what is in it.
    """
    for place, _, _, opened in os.fwalk(folder, topdown=False):
        inner = draft / Path(place).relative_to(folder)
        if inner.is_dir():
            found = os.fstat(opened)
            with open_folder(inner) as handle:
                if os.geteuid() == 0:
                    os.fchown(handle, found.st_uid, found.st_gid)
                os.fchmod(handle, found.st_mode & 0o7777)
                os.fsync(handle)


def _take_out(staying: Collection[str], former: Path) -> None:
    """Remove the names of files that stay, and folders that hold nothing then; again by descriptors."""
    for place, folders, names, opened in os.fwalk(former, topdown=False):
        here = Path(place).relative_to(former)
        for name in [*names, *folders]:
            if (here / name).as_posix() in staying:
                os.unlink(name, dir_fd=opened)
            elif name in folders:
                with suppress(OSError):  # it holds something
                    os.rmdir(name, dir_fd=opened)


def _remove_empty(draft: Path, folder: Path) -> None:
    """Remove folders of a draft that hold nothing; not those that are empty in the other folder, too."""
    for place, _, _ in os.walk(draft, topdown=False):
        inner = Path(place)
        if inner == draft or any(inner.iterdir()):
            continue
        if any((folder / inner.relative_to(draft)).iterdir()):
            inner.rmdir()
