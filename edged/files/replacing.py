"""Replace some files of a folder in one atomic step and keep the others."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path

from edged.files.atomic import make_folders, open_folder, swap_paths, sync, sync_folders, write_atomically
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
    """Put these files, by name, into a folder in place of those replaced; the others stay as they are.

    After a crash it is either the former folder or the new one. keep : a free path beside the folder, for the
    files replaced. private : those of the files that others must not read. Returns whether anything is kept.
    Raises `OSError`; nothing has changed then.
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
        swap_paths(draft, folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    sync(folder.parent)  # before the former folder, which now has the draft's name, is taken apart
    if replaced:
        _take_out(staying, draft)
        draft.rename(keep)
    else:
        shutil.rmtree(draft)
    sync(folder.parent)
    return bool(replaced)


def _link_others(folder: Path, draft: Path, replaced: Collection[str]) -> set[str]:
    """Hard-link every other file of the folder into the draft. Returns their names.

    The folder is walked by descriptors, as the owner of a subfolder may swap it for a link meanwhile.
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
    """Hard-link a file of an open folder to a second path; if that fails, copy it and sync the copy."""
    try:
        os.link(name, target, src_dir_fd=folder, follow_symlinks=False)
    except OSError:  # a file system without hard links, or a file of another owner
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
    """Give each folder the owner, group and mode of the former one, as far as permitted.

    Deepest first, and only once all is written: the owner of a folder may replace its entries by links.
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
    """Unlink the files that stay and the folders that are then empty; again by descriptors."""
    for place, folders, names, opened in os.fwalk(former, topdown=False):
        here = Path(place).relative_to(former)
        for name in [*names, *folders]:
            if (here / name).as_posix() in staying:
                os.unlink(name, dir_fd=opened)
            elif name in folders:
                with suppress(OSError):  # not empty
                    os.rmdir(name, dir_fd=opened)


def _remove_empty(draft: Path, folder: Path) -> None:
    """Remove empty folders of a draft, except those that are empty in the original folder, too."""
    for place, _, _ in os.walk(draft, topdown=False):
        inner = Path(place)
        if inner == draft or any(inner.iterdir()):
            continue
        if any((folder / inner.relative_to(draft)).iterdir()):
            inner.rmdir()
