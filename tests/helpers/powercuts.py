"""Power cuts: a writer's calls on a folder are recorded, and a possible remaining disk is drawn at random.

A disk may keep operations in any order, except for what POSIX promises and every journal guarantees:
- names are kept once an fsync of their folder followed, as are content and mode once their own fsync has;
- each call is kept as a whole or not at all (a rename, an exchange of two names);
- of two calls that touch the same name the later is kept only with the earlier one.
Everything else may be lost: names, modes, and content from any byte on.
"""

from __future__ import annotations

import contextlib
import os
import random
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from edged.files import atomic, replacing

ROOT = 0

Key = tuple[int, str]
"""A folder and a name in it."""


@dataclass(frozen=True, slots=True)
class Named:
    """Names reassigned by one call; None: the name no longer exists."""

    names: dict[Key, int | None]


@dataclass(frozen=True, slots=True)
class Changed:
    """New content or mode of a file or folder, whichever is not None."""

    thing: int
    content: bytes | None = None
    mode: int | None = None


@dataclass(frozen=True, slots=True)
class Synced:
    """The fsync of a file or folder has returned."""

    thing: int


Call = Named | Changed | Synced


@dataclass
class Disk:
    """Names, contents and modes; a folder is a thing without content."""

    names: dict[Key, int] = field(default_factory=dict)
    contents: dict[int, bytes] = field(default_factory=dict)
    modes: dict[int, int] = field(default_factory=dict)

    def do(self, call: Call) -> None:
        """Apply a call that is kept."""
        match call:
            case Named(names):
                for key, thing in names.items():
                    self.names.pop(key, None)
                    if thing is not None:
                        self.names[key] = thing
            case Changed(thing, content, mode):
                if content is not None:
                    self.contents[thing] = content
                if mode is not None:
                    self.modes[thing] = mode
            case Synced():
                pass

    def find(self, path: Path) -> int | None:
        """File or folder at a relative path, or None."""
        thing = ROOT
        for part in path.parts:
            found = self.names.get((thing, part))
            if found is None:
                return None
            thing = found
        return thing

    def write(self, folder: Path) -> None:
        """Write this disk into a new folder."""
        todo = [(ROOT, folder)]
        inside: dict[int, list[tuple[str, int]]] = {}
        for (parent, name), thing in self.names.items():
            inside.setdefault(parent, []).append((name, thing))
        while todo:
            thing, path = todo.pop()
            if thing in self.contents:
                path.write_bytes(self.contents[thing])
            else:
                path.mkdir()
                todo += [(child, path / name) for name, child in inside.get(thing, ())]
            if thing in self.modes:
                path.chmod(self.modes[thing] | 0o700)  # the test may have to remove it

    def tree(self) -> dict[str, tuple[int, bytes | None]]:
        """Mode and content of each file or folder by relative path; content None for folders."""
        paths = {ROOT: ""}
        found: dict[str, tuple[int, bytes | None]] = {}
        todo = [ROOT]
        while todo:
            parent = todo.pop()
            for (folder, name), thing in self.names.items():
                if folder == parent:
                    path = f"{paths[parent]}{name}"
                    found[path] = (self.modes.get(thing, 0), self.contents.get(thing))
                    if thing not in self.contents:
                        paths[thing] = f"{path}/"
                        todo.append(thing)
        return found


def read_disk(folder: Path) -> dict[str, tuple[int, bytes | None]]:
    """Mode and content of everything in a real folder, as `Disk.tree`."""
    return {
        path.relative_to(folder).as_posix(): (
            path.stat().st_mode & 0o777,
            None if path.is_dir() else path.read_bytes(),
        )
        for path in folder.rglob("*")
    }


class Record:
    """Every change below a folder that starts empty."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.calls: list[Call] = []
        self.now = Disk()
        self._things = ROOT
        self._unsynced: dict[int, int] = {}  # files whose content may change, and how we read them
        self._lock = threading.RLock()
        self._is_inside = False

    def place(self, path: Any, dir_fd: int | None = None) -> Path | None:
        """Path relative to the folder; None if it lies elsewhere."""
        if isinstance(path, int):
            path = Path(f"/proc/self/fd/{path}").readlink()
        path = Path(os.fsdecode(path))
        if dir_fd is not None:
            path = Path(f"/proc/self/fd/{dir_fd}").readlink() / path
        path = Path(os.path.abspath(path))  # noqa: PTH100  (a link keeps its own name)
        return path.relative_to(self.root) if path.is_relative_to(self.root) else None

    def key(self, path: Path) -> Key:
        """Folder and name of a path."""
        folder = self.now.find(path.parent)
        assert folder is not None, f"{path.parent} was made by a call that is not watched"
        return folder, path.name

    def note(self, *calls: Call) -> None:
        """Append calls, after any content written before them."""
        for call in [*self._look(), *calls]:
            self.calls.append(call)
            self.now.do(call)

    def _look(self) -> list[Call]:
        """Content changes since the last call."""
        news: list[Call] = []
        for thing, handle in self._unsynced.items():
            content = os.pread(handle, os.fstat(handle).st_size, 0)
            if content != self.now.contents.get(thing):
                news.append(Changed(thing, content))
        return news

    # --- the calls -------------------------------------------------------------------------------

    def made(self, path: Path, mode: int, *, is_file: bool) -> None:
        """Note a new file or folder."""
        self._things += 1
        thing = self._things
        if is_file:
            self._unsynced[thing] = os.open(self.root / path, os.O_RDONLY)
            self.note(Changed(thing, b"", mode), Synced(thing))
        else:
            self.note(Changed(thing, None, mode), Synced(thing))
        self.note(Named({self.key(path): thing}))

    def moved(self, source: Path, target: Path) -> None:
        """Note a rename."""
        thing = self.now.find(source)
        self.note(Named({self.key(source): None, self.key(target): thing}))

    def exchanged(self, one: Path, other: Path) -> None:
        """Note that two names were exchanged."""
        first, second = self.now.find(one), self.now.find(other)
        self.note(Named({self.key(one): second, self.key(other): first}))

    def linked(self, source: Path, target: Path) -> None:
        """Note a second name."""
        self.note(Named({self.key(target): self.now.find(source)}))

    def removed(self, path: Path) -> None:
        """Note a removed name."""
        self.note(Named({self.key(path): None}))

    def changed_mode(self, path: Path, mode: int) -> None:
        """Note a changed mode."""
        thing = self.now.find(path)
        assert thing is not None
        self.note(Changed(thing, None, mode))

    def synced(self, path: Path) -> None:
        """Note that an fsync has returned."""
        thing = self.now.find(path)
        assert thing is not None
        self.note(Synced(thing))
        self._forget(thing)

    def _forget(self, thing: int) -> None:
        if (handle := self._unsynced.pop(thing, None)) is not None:
            os.close(handle)

    # --- watching --------------------------------------------------------------------------------

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Record what this process does until the end of the context."""
        with pytest.MonkeyPatch.context() as patch:
            for name, watch in (
                ("open", self._on_open),
                ("mkdir", self._on_mkdir),
                ("rename", self._on_rename),
                ("replace", self._on_rename),
                ("link", self._on_link),
                ("unlink", self._on_remove),
                ("remove", self._on_remove),
                ("rmdir", self._on_remove),
                ("chmod", self._on_chmod),
                ("fchmod", self._on_chmod),
                ("fsync", self._on_fsync),
            ):
                patch.setattr(os, name, self._watched(getattr(os, name), watch))
            exchange = self._watched(atomic.swap_paths, self._on_exchange)
            patch.setattr(atomic, "swap_paths", exchange)
            patch.setattr(replacing, "swap_paths", exchange)
            yield
        self.note()
        for thing in list(self._unsynced):
            self._forget(thing)

    def _watched(self, real: Callable[..., Any], watch: Callable[..., None]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            with self._lock:
                if self._is_inside:
                    return real(*args, **kwargs)
                self._is_inside = True
                try:
                    self.note()
                    result = real(*args, **kwargs)
                    watch(*args, **kwargs)
                    return result
                finally:
                    self._is_inside = False

        return call

    def _on_open(self, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        place = self.place(path, dir_fd)
        if place is not None and flags & os.O_CREAT and self.now.find(place) is None:
            self.made(place, (self.root / place).stat().st_mode & 0o777, is_file=True)

    def _on_mkdir(self, path: Any, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        if (place := self.place(path, dir_fd)) is not None:
            self.made(place, (self.root / place).stat().st_mode & 0o777, is_file=False)

    def _on_rename(
        self, source: Any, target: Any, *, src_dir_fd: int | None = None, dst_dir_fd: int | None = None
    ) -> None:
        place, to = self.place(source, src_dir_fd), self.place(target, dst_dir_fd)
        if place is not None and to is not None:
            self.moved(place, to)

    def _on_link(self, source: Any, target: Any, *, src_dir_fd: int | None = None, **_: Any) -> None:
        if (place := self.place(source, src_dir_fd)) is not None and (to := self.place(target)) is not None:
            self.linked(place, to)

    def _on_remove(self, path: Any, *, dir_fd: int | None = None) -> None:
        if (place := self.place(path, dir_fd)) is not None:
            self.removed(place)

    def _on_chmod(self, path: Any, mode: int, **_: Any) -> None:
        if (place := self.place(path)) is not None:
            self.changed_mode(place, mode)

    def _on_fsync(self, handle: int) -> None:
        if (place := self.place(handle)) is not None:
            self.synced(place)

    def _on_exchange(self, one: Path, other: Path) -> None:
        if (place := self.place(one)) is not None and (to := self.place(other)) is not None:
            self.exchanged(place, to)


# --- the cut --------------------------------------------------------------------------------------


def cut(calls: Sequence[Call], dice: random.Random) -> Disk:
    """A disk that may remain when the power is cut after these calls."""
    earlier = _earlier(calls)
    sure = _sure(calls, earlier)
    order = dice.choice(("in order", "any", "any", "nothing", "all"))
    end, share = dice.randrange(len(calls) + 1), dice.random()
    kept = set(sure)
    for number in range(len(calls)):
        wanted = {"in order": number < end, "any": dice.random() < share}.get(order, order == "all")
        if wanted:
            _keep(number, earlier, kept)
    disk = Disk()
    for number in sorted(kept):
        call = calls[number]
        if isinstance(call, Changed) and call.content is not None and number not in sure:
            length = dice.choice((0, len(call.content), dice.randrange(len(call.content) + 1)))
            call = Changed(call.thing, call.content[:length])
        disk.do(call)
    return disk


def _earlier(calls: Sequence[Call]) -> list[set[int]]:
    """For each call, the indices of the last earlier calls that touch the same names."""
    last: dict[Key, int] = {}
    found: list[set[int]] = []
    for number, call in enumerate(calls):
        names = call.names if isinstance(call, Named) else {}
        found.append({last[key] for key in names if key in last})
        last |= dict.fromkeys(names, number)
    return found


def _sure(calls: Sequence[Call], earlier: list[set[int]]) -> set[int]:
    """Indices of calls that no power cut can undo."""
    sure: set[int] = set()
    pending: dict[int, list[int]] = {}
    for number, call in enumerate(calls):
        match call:
            case Named(names):
                for folder in {folder for folder, _ in names}:
                    pending.setdefault(folder, []).append(number)
            case Changed(thing):
                pending.setdefault(thing, []).append(number)
            case Synced(thing):
                for done in pending.pop(thing, ()):
                    _keep(done, earlier, sure)
    return sure


def _keep(number: int, earlier: list[set[int]], kept: set[int]) -> None:
    """Add a call, and the earlier ones that it depends on."""
    todo = [number]
    while todo:
        number = todo.pop()
        if number not in kept:
            kept.add(number)
            todo += earlier[number]
