"""Who did what to the cell: lines of JSON, each with the hash of the one before; the newest in one file.

A file that is full makes room for the next, in which the chain goes on; the oldest is let go when there are
many, and a record says so. A changed, missing or inserted line breaks the chain, in whichever file. That
lines are missing at the end is told by the head, which holds number and hash of the last one; and at the
beginning, for it knows the first that is kept. A line that a crash tore is neither, and is said so. Whoever
may write all files can write another history: its hashes are not those that the journal has.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from edged.errors import FileFormatError
from edged.files.atomic import make_folders, sync, write_atomically
from edged.files.auditchain import START, Chain, Head, end_of, head_in, line_of
from edged.files.statefolder import hand_over

LINES, HEAD = "audit.jsonl", "audit.head"
FULL = re.compile(r"audit\.([0-9]{9,})\.jsonl")
"""An older file, by the number of its last record."""
FULL_BYTES = 4 * 1024 * 1024
KEPT = 15
"""Full files, with the newest 64 MiB: at 400 bytes each some 160,000 deeds, which are verified in seconds."""
TAIL_BYTES = 64 * 1024
"""A line is shorter."""
MAX_TEXT = 300


@dataclass(frozen=True, slots=True)
class Deed:
    """What somebody did, or tried to.

    before, after : hash of what was changed, where there is one. outcome : "ok", or why not, as a code.
    """

    user: str
    role: str
    address: str
    verb: str
    object: str
    outcome: str
    before: str | None = None
    after: str | None = None
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """Of a chain. records : that were wanted.  first, count : numbers of the oldest kept, and of the newest.

    hash : of the last. problem : "" for one that holds. torn_bytes : of a line that a crash tore, at the end.
    """

    records: tuple[dict[str, Any], ...]
    first: int = 1
    count: int = 0
    hash: str = START
    problem: str = ""
    torn_bytes: int = 0


Wanted = Callable[[dict[str, Any]], bool]


class AuditFile:
    """The chain of a cell; processes may add to it at the same time."""

    def __init__(self, folder: Path, utc_s: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._utc_s = utc_s

    def add(self, deed: Deed) -> dict[str, Any]:
        """Keep a deed, on the disc when this returns; its number and hash. Raises `OSError`."""
        make_folders(self._folder)
        while True:
            with _locked(self._folder / LINES) as file:
                number, digest, torn_bytes = self._end(file)
                if torn_bytes:
                    end = file.seek(0, os.SEEK_END) - torn_bytes
                    file.truncate(end)
                    torn = Deed(
                        "", "", "", "mend", LINES, "ok", reason=f"a line of {torn_bytes} bytes was torn"
                    )
                    number, digest = self._write(file, torn, number, digest)
                if file.seek(0, os.SEEK_END) >= FULL_BYTES:
                    self._turn_over(number, digest)
                    continue  # another process may have begun the next file by now
                number, digest = self._write(file, deed, number, digest)
                self._note_end(number, digest)
                self._let_go(file, number, digest)
                return {"number": number, "hash": digest}

    def _write(self, file: BinaryIO, deed: Deed, number: int, digest: str) -> tuple[int, str]:
        """One line; returns its number and hash."""
        body = {
            "number": number + 1,
            "time": datetime.fromtimestamp(self._utc_s(), UTC).isoformat(timespec="milliseconds"),
            **{name: _short(getattr(deed, name)) for name in Deed.__slots__},
            "previous": digest,
        }
        line, digest = line_of(body)
        start = file.seek(0, os.SEEK_END)
        try:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            with suppress(OSError):
                file.truncate(start)
            raise
        hand_over(self._folder / LINES)
        return number + 1, digest

    def _note_end(self, number: int, digest: str) -> None:
        """In the head, which keeps where the chain begins."""
        before = self._head() or Head(0, START)
        self._put_head(Head(number, digest, before.first, before.previous))

    def _put_head(self, head: Head) -> None:
        write_atomically(self._folder / HEAD, head.to_bytes(), mode=0o600)
        hand_over(self._folder / HEAD)

    def _turn_over(self, number: int, digest: str) -> None:
        """Make room for the next file."""
        self._note_end(number, digest)  # first: a crash leaves nothing else that knows the end
        (self._folder / LINES).rename(self._folder / f"audit.{number:09}.jsonl")
        sync(self._folder)

    def _let_go(self, file: BinaryIO, number: int, digest: str) -> None:
        """Of full files, those that are too many; and those of which a crash left the name."""
        head, full = self._head(), self._full()
        if head is None:
            return
        old = full[: max(len(full) - KEPT, 0)]
        if old and old[-1][0] >= head.first:
            last, path = old[-1]
            found = _last_in(path)
            told = Deed(
                "",
                "",
                "",
                "let go",
                LINES,
                "ok",
                reason=f"records {head.first} to {last}: there is no room for all",
            )
            number, digest = self._write(file, told, number, digest)
            # first: a file whose records are before the first one counts no more
            self._put_head(Head(number, digest, last + 1, "" if found is None else found[1]))
        for _, path in old:
            path.unlink(missing_ok=True)

    def _full(self) -> list[tuple[int, Path]]:
        """The older files, by their last number."""
        found = ((FULL.fullmatch(path.name), path) for path in self._folder.iterdir())
        return sorted((int(name[1]), path) for name, path in found if name)

    def _head(self) -> Head | None:
        try:
            return head_in((self._folder / HEAD).read_bytes())
        except OSError:
            return None

    def _end(self, file: BinaryIO) -> tuple[int, str, int]:
        """Number and hash that the next line follows, and bytes of a line that was torn.

        Of the line or of the head, whichever is later: where lines are missing, who verifies sees the gap.
        """
        last, torn_bytes = _tail(file)
        head = self._head()
        ends = [(0, START) if last is None else last]
        if head is not None:
            ends.append((head.number, head.hash))
        number, digest = max(ends, key=lambda end: end[0])
        return number, digest, torn_bytes

    def verify(self, wanted: Wanted = lambda _record: True, last: int | None = None) -> Verdict:
        """Read all of it. wanted : of the records, and of those the last ones. Raises `FileFormatError`."""
        with ExitStack() as opened:
            try:
                data, full, head_data = self._opened(opened)
                head = None if head_data is None else head_in(head_data)
                chain = Chain(head)
                kept = deque[dict[str, Any]](maxlen=last)
                at_head = ""
                torn = b""
                for lines in self._lines(full, chain.first, data):
                    *whole, torn = lines
                    for record in chain.follow(whole):
                        if head is not None and chain.number == head.number:
                            at_head = chain.digest
                        if wanted(record):
                            kept.append(record)
                    if chain.problem:
                        break
            except OSError as error:
                where = self._folder / LINES
                raise FileFormatError(f"{where}: cannot read the audit: {error.strerror or error}") from error
        problem = chain.problem or _ends(chain, head, at_head, has_head=head_data is not None)
        if problem and data is None and not chain.problem and head is not None:
            problem = f"{LINES} is missing, with {head.number - chain.number} records"
        return Verdict(tuple(kept), chain.first, chain.number, chain.digest, problem, len(torn))

    def _opened(self, opened: ExitStack) -> tuple[bytes | None, list[tuple[int, BinaryIO]], bytes | None]:
        """All files of one moment: the newest, None for none; the full ones, which nobody writes; the head.

        Who wants to add waits no longer than this.
        """
        with ExitStack() as held:
            try:
                file = held.enter_context(_locked(self._folder / LINES, make=False))
            except FileNotFoundError:
                data = None
            else:
                data = file.read()
            paths = self._full() if self._folder.is_dir() else []
            full: list[tuple[int, BinaryIO]] = []
            for number, path in paths:
                full.append((number, opened.enter_context(path.open("rb"))))
            head = self._folder / HEAD
            return data, full, head.read_bytes() if head.exists() else None

    def _lines(
        self, full: list[tuple[int, BinaryIO]], first: int, data: bytes | None
    ) -> Iterator[list[bytes]]:
        """Of each file in its turn, and behind them what has no end: of a full one it is a line, too."""
        for number, file in full:
            if number >= first:  # else it was let go, and a crash left it
                lines = file.read().split(b"\n")
                yield lines if not lines[-1] else [*lines, b""]
        yield (data or b"").split(b"\n")


def shown(text: str) -> str:
    """A text that a stranger chose, a wrong name for example, as it may be printed."""
    return "".join(letter if letter.isprintable() else "�" for letter in text)


def _ends(chain: Chain, head: Head | None, at_head: str, *, has_head: bool) -> str:
    """Why a chain that holds does not end where it should; "" when it does."""
    if head is None:
        if has_head:
            return f"{HEAD} cannot be read"
        # the first line is on the disc before the head is
        return f"{HEAD} is missing: lines at the end may be, too" if chain.number > 1 else ""
    if head.number > chain.number:
        return f"cut off: the last {head.number - chain.number} of {head.number} records are missing"
    if head.number < chain.first or at_head != head.hash:
        return f"record {head.number} is not the one that {HEAD} names"
    return ""


def _last_in(path: Path) -> tuple[int, str] | None:
    """Number and hash of the last record of a file."""
    with path.open("rb") as file:
        return _tail(file)[0]


def _tail(file: BinaryIO) -> tuple[tuple[int, str] | None, int]:
    """Number and hash of the last whole line, and bytes of one that was torn behind it."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - TAIL_BYTES))
    whole, newline, torn = file.read().rpartition(b"\n")
    return end_of(whole.rpartition(b"\n")[2]) if newline else None, len(torn)


def _short(text: str | None) -> str | None:
    """Lines are short, whatever somebody gave as a reason."""
    return None if text is None else text[:MAX_TEXT]


@contextmanager
def _locked(path: Path, *, make: bool = True) -> Iterator[BinaryIO]:
    """A file that no other process reads or writes meanwhile. Raises `OSError`."""
    flags = os.O_RDWR | os.O_CREAT if make else os.O_RDONLY
    while True:
        handle = os.open(path, flags | os.O_CLOEXEC, 0o600)
        with os.fdopen(handle, "r+b" if make else "rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX if make else fcntl.LOCK_SH)
            if _is_at(file, path):
                yield file
                return


def _is_at(file: BinaryIO, path: Path) -> bool:
    """Whether an open file still has its name: another process may have turned it over meanwhile."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
