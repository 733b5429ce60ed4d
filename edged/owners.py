"""File access by root in folders of other users: root acts as that user there.

The owner of a folder may replace any name in it by a link, at any moment. So before it writes to a path, root
becomes the first user on the path who is not root; and it follows such a user's link only to files of that
user.
"""

from __future__ import annotations

import errno
import os
import pwd
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from edged.errors import FileFormatError

MAX_LINKS = 40
"""Maximum number of links on a path, as in the kernel: path_resolution(7)."""
NO_GROUP = 65534
"""Group for a user without a name, whose folder may have any group: /proc/sys/kernel/overflowgid, proc(5)."""


@contextmanager
def as_owner(place: Path) -> Iterator[Path]:
    """Let root act as the first user on the path to a file or folder who is not root.

    Yields the place as a path through a descriptor of that user's folder: it may lie where only root can go,
    like /var/lib/private. The whole process changes its user, so this is for commands, not for a daemon.
    Nothing changes for other users than root, or where root owns everything. Raises `FileFormatError` if root
    cannot act as that user.
    """
    with ExitStack() as opened:
        found = _first_of_another(place, opened) if os.geteuid() == 0 else None
        if found is None:
            yield place
            return
        user, inside = found
        group, groups = os.getegid(), os.getgroups()
        try:
            try:
                os.setgroups([])
                os.setegid(_group_of(user))
                os.seteuid(user)
            except OSError as error:
                raise FileFormatError(
                    f"{place}: belongs to user {user}, whom root cannot act for here ({error.strerror}): "
                    "run this as that user"
                ) from error
            yield inside
        finally:
            os.seteuid(0)
            os.setegid(group)
            os.setgroups(groups)


def other_owner(place: Path) -> int | None:
    """First user on the path to a file or folder who is not root; None if root owns all of it."""
    with ExitStack() as opened:
        found = _first_of_another(place, opened)
        return None if found is None else found[0]


def named_path(folder: Path) -> Path:
    """Path of a folder that ends with its own name, or that of a link to it, but not with "." or ".."."""
    return folder.resolve() if folder.name in ("", "..") else folder


def resolved(folder: Path) -> Path:
    """Resolve a path that may be a link; call it inside `as_owner`, for the owner of the link."""
    return folder.resolve() if folder.is_symlink() else folder


def open_plain(name: str | Path, flags: int, folder: int | None = None) -> int:
    """Open a plain file, in an open folder if given; no link, pipe or device. Raises `OSError`."""
    # O_NONBLOCK: a pipe without a writer is opened at once, and refused
    flags |= os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        handle = os.open(name, flags, 0o600, dir_fd=folder)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(errno.ELOOP, "is a link, expected a plain file", str(name)) from error
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "expected a plain file", str(name))
    return handle


def open_to_read(path: Path, flags: int = 0, folder: int | None = None) -> int:
    """Open a file for reading, in an open folder if given. Raises `OSError`.

    Through another user's link, root opens only what belongs to that user, too, and it opens no other user's
    pipe or device, on which it could wait for ever, except a pipe that it was given open, like /dev/stdin.
    """
    flags |= os.O_RDONLY | os.O_CLOEXEC
    if os.geteuid() != 0:
        return os.open(path, flags, dir_fd=folder)
    with ExitStack() as opened:
        path = path if folder is None else Path(f"/proc/self/fd/{folder}") / path
        steps = [*_steps(path, opened)]
        users = {step.about.st_uid for step in steps if step.is_link and not step.is_roots}
        if users and users != {steps[-1].about.st_uid}:
            raise PermissionError(errno.EPERM, "a link of another user leads there: root does not follow it")
        last = steps[-1]
        is_named = last.folder != last.handle
        if (
            is_named
            and not last.is_roots
            and not (stat.S_ISREG(last.about.st_mode) or stat.S_ISDIR(last.about.st_mode))
        ):
            raise PermissionError(errno.EPERM, "another user's, and no plain file: root does not open it")
        # by its descriptor: the name may mean another file by now
        return os.open(f"/proc/self/fd/{last.handle}", flags)


def file_to_read(path: Path) -> BinaryIO:
    """Open a file as `open_to_read` does. Raises `OSError`."""
    return os.fdopen(open_to_read(path), "rb")


def _first_of_another(place: Path, opened: ExitStack) -> tuple[int, Path] | None:
    """First user who is not root, and the place through a descriptor; None if root owns all of the path."""
    with suppress(FileNotFoundError):  # a missing rest will be created in a folder of root
        for step in _steps(place, opened):
            if step.is_roots:
                continue
            if step.is_link and step.folder is not None:
                return step.about.st_uid, Path(f"/proc/self/fd/{step.folder}", step.name, *step.rest)
            if stat.S_ISDIR(step.about.st_mode):
                return step.about.st_uid, Path(f"/proc/self/fd/{step.handle}", *step.rest)
    return None


@dataclass(frozen=True, slots=True)
class _Step:
    """Step of a path: a folder, link or file, opened as such.

    folder : open folder that contains it. rest : names that follow.
    """

    folder: int | None
    name: str
    handle: int
    rest: tuple[str, ...]

    @property
    def about(self) -> os.stat_result:
        return os.fstat(self.handle)

    @property
    def is_link(self) -> bool:
        return stat.S_ISLNK(self.about.st_mode)

    @property
    def is_roots(self) -> bool:
        """Whether root owns it, or the owner of the root folder, which in a user namespace is not 0."""
        return self.about.st_uid in (0, Path("/").stat().st_uid)


def _steps(path: Path, opened: ExitStack) -> Iterator[_Step]:
    """Walk a path step by step, as the kernel does; each name is opened once. Raises `OSError`."""
    todo = [*reversed((Path.cwd() / path).parts)]
    folder, links = None, 0
    while todo:
        name = todo.pop()
        step = _Step(folder, name, _opened(name, os.O_NOFOLLOW, folder, opened), tuple(reversed(todo)))
        yield step
        if not step.is_link:
            folder = step.handle
        elif step.about.st_dev == Path("/proc").stat().st_dev:
            # a link to a file that is open in a process, which may have no name
            folder = _opened(name, 0, folder, opened)
            yield _Step(folder, name, folder, tuple(reversed(todo)))
        else:
            links += 1
            if links > MAX_LINKS:
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
            todo += reversed(Path(os.readlink("", dir_fd=step.handle)).parts)


def _opened(name: str, flags: int, folder: int | None, opened: ExitStack) -> int:
    handle = os.open(name, os.O_PATH | os.O_CLOEXEC | flags, dir_fd=folder)
    opened.callback(os.close, handle)
    return handle


def _group_of(user: int) -> int:
    try:
        return pwd.getpwuid(user).pw_gid
    except KeyError:
        return NO_GROUP
