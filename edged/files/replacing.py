"""Some files of a folder exchanged in one step, beside others that stay."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Collection, Mapping
from pathlib import Path

from edged.files.atomic import exchange, make_folders, sync, sync_folders, write_atomically
from edged.files.private import write_private


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
        draft.chmod(0o755)  # mkdtemp makes it private
        staying = _link_others(folder, draft, replaced) if folder.is_dir() else []
        for name, data in files.items():
            file = draft / name
            file.parent.mkdir(parents=True, exist_ok=True)
            if name in private:
                write_private(file, data, like=folder / name)
            else:
                write_atomically(file, data)
        sync_folders(draft)
        if not folder.is_dir():
            draft.replace(folder)
            sync(folder.parent)
            return False
        exchange(draft, folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    sync(folder.parent)  # before the former folder, whose name is the draft's now, is taken apart
    # the files that stay are in both
    for name in staying:
        (draft / name).unlink()
    if replaced:
        _remove_empty(draft)
        draft.rename(keep)
    else:
        shutil.rmtree(draft)
    sync(folder.parent)
    return bool(replaced)


def _link_others(folder: Path, draft: Path, replaced: Collection[str]) -> list[str]:
    """Give the draft every other file of the folder: the same file, not a copy. Returns their names."""
    staying = []
    _like(folder, draft)
    for place, folders, names in os.walk(folder):
        here = Path(place).relative_to(folder)
        for name in folders:
            if not (folder / here / name).is_symlink():
                (draft / here / name).mkdir()
                _like(folder / here / name, draft / here / name)
        links = [name for name in folders if (folder / here / name).is_symlink()]
        for relative in ((here / name).as_posix() for name in [*names, *links]):
            if relative in replaced:
                continue
            try:
                os.link(folder / relative, draft / relative, follow_symlinks=False)
            except OSError:  # a file system without links, or a file of somebody else's
                shutil.copy2(folder / relative, draft / relative, follow_symlinks=False)
                if not (draft / relative).is_symlink():
                    sync(draft / relative)
            staying.append(relative)
    _remove_empty(draft, than=folder)
    return staying


def _like(folder: Path, draft: Path) -> None:
    """Owner, group and mode of a folder, as far as one may give them."""
    found = folder.stat()
    if os.geteuid() == 0:
        os.chown(draft, found.st_uid, found.st_gid)
    draft.chmod(found.st_mode & 0o7777)


def _remove_empty(draft: Path, *, than: Path | None = None) -> None:
    """Remove folders that hold nothing; not those that are empty in the other folder, too."""
    for place, _, _ in os.walk(draft, topdown=False):
        inner = Path(place)
        if inner == draft or any(inner.iterdir()):
            continue
        if than is None or any((than / inner.relative_to(draft)).iterdir()):
            inner.rmdir()
