"""Places where somebody else than root decides what a name means: what root does there, it does as that user.

Whoever owns a folder may put a link in place of any name in it, at any moment. So root becomes the first user
on the way to a place who is not root, before it writes there; and a link of such a user leads it to files of
that user only.
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
"""On the way to a file, as the kernel has it: path_resolution(7)."""
NO_GROUP = 65534
"""For a user without a name, whose folder may have any group: /proc/sys/kernel/overflowgid, proc(5)."""


@contextmanager
def as_owner(place: Path) -> Iterator[Path]:
    """Let root be, meanwhile, the first user on the way to a file or folder who is not root.

    Yields the place by a descriptor of that user's folder: it may lie where only root gets, as what is in
    /var/lib/private. The whole process changes its user, so that this is for commands, not for a daemon. For
    who is not root, and where all is root's, nothing changes. Raises `FileFormatError` where root cannot.
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
    """The first user on the way to a file or folder who is not root; None where all is root's."""
    with ExitStack() as opened:
        found = _first_of_another(place, opened)
        return None if found is None else found[0]


def by_name(folder: Path) -> Path:
    """A folder by a path that ends with its name, or with a link's: "." and ".." are none."""
    return folder.resolve() if folder.name in ("", "..") else folder


def unlinked(folder: Path) -> Path:
    """What a path that may be a link's means; the owner of the link must be asked first, by `as_owner`."""
    return folder.resolve() if folder.is_symlink() else folder


def open_plain(name: str | Path, flags: int, folder: int | None = None) -> int:
    """Open a file, of an open folder the one of that name; no link, pipe or device. Raises `OSError`."""
    # O_NONBLOCK: a pipe at which nobody writes is opened at once, and refused
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
    """Open a file, or the one in an open folder. Raises `OSError`.

    Root opens by another user's link only what belongs to that user, too, and no other user's pipe or device,
    at which it would wait for ever; but a pipe that it was given open, as /dev/stdin, it does.
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
    """A file, opened as `open_to_read` does. Raises `OSError`."""
    return os.fdopen(open_to_read(path), "rb")


def _first_of_another(place: Path, opened: ExitStack) -> tuple[int, Path] | None:
    """User, and the place by a descriptor; None where all that is there is root's."""
    with suppress(FileNotFoundError):  # what is missing is made in a folder of root's
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
    """A folder, link or file on a way, opened as such; the folder that it is in; names that are to come."""

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
        """Or of who owns the root folder: in a user's own namespace that is not 0."""
        return self.about.st_uid in (0, Path("/").stat().st_uid)


def _steps(path: Path, opened: ExitStack) -> Iterator[_Step]:
    """Every step of the way to a path, as the kernel goes it; each name is opened once. Raises `OSError`."""
    todo = [*reversed((Path.cwd() / path).parts)]
    folder, links = None, 0
    while todo:
        name = todo.pop()
        step = _Step(folder, name, _opened(name, os.O_NOFOLLOW, folder, opened), tuple(reversed(todo)))
        yield step
        if not step.is_link:
            folder = step.handle
        elif step.about.st_dev == Path("/proc").stat().st_dev:
            # to what is open in a process, which may have no name
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
