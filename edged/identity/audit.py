"""Audit log of actions on the cell: lines of JSON, each with the hash of the one before.

When a file is full the chain continues in the next one; the oldest files are deleted when there are too many,
and a record says so. A changed, missing or inserted line breaks the chain, in any file. The head file holds
number and hash of the last record and the number of the first one kept, so that lines missing at either end
are noticed. An incomplete last line, left by a crash, is reported as such. A user who may write all files can
forge a history, but its hashes differ from those in the journal.
"""

from __future__ import annotations

import errno
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
from edged.files.atomic import copy_owner, make_folders, open_folder, write_atomically
from edged.identity.auditchain import START, AuditChain, AuditHead, end_of, head_in, line_of, start_of
from edged.owners import open_plain

LINES, HEAD = "audit.jsonl", "audit.head"
FULL = re.compile(r"audit\.([0-9]{9,})\.jsonl")
"""Name of a full file, with the number of its last record."""
FULL_BYTES = 4 * 1024 * 1024
KEPT = 15
"""Full files kept; with the current one 64 MiB, some 160,000 records of 400 bytes, verified in seconds."""
TAIL_BYTES = 64 * 1024
"""Upper bound of the length of a line."""
MAX_TEXT = 300


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """Action that was taken or attempted.

    before, after : hash of the changed object, where there is one. outcome : "ok", or the reason as a code.
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
class AuditVerdict:
    """Result of verifying a chain, with the requested records.

    first, count : numbers of the oldest record kept, and of the newest.  hash : of the newest.
    problem : "" for an intact chain.  torn_bytes : length of an incomplete last line, left by a crash.
    """

    records: tuple[dict[str, Any], ...]
    first: int = 1
    count: int = 0
    hash: str = START
    problem: str = ""
    torn_bytes: int = 0


Wanted = Callable[[dict[str, Any]], bool]


class AuditFile:
    """Audit chain of a cell, in a folder; several processes may add to it at the same time.

    called : name of the folder in messages. Files that are symbolic links are not opened.
    """

    def __init__(
        self, folder: Path, utc_s: Callable[[], float] = time.time, *, called: Path | None = None
    ) -> None:
        self._folder = folder
        self._called = called or folder
        self._utc_s = utc_s

    def add(self, deed: AuditEntry) -> dict[str, Any]:
        """Append an entry, on the disc when this returns; return its number and hash. Raises `OSError`."""
        make_folders(self._folder)
        while True:
            with open_folder(self._folder) as folder, _locked(folder) as file:
                head = self._head()
                number, digest, torn_bytes = _end(folder, file, head)
                if torn_bytes:
                    end = file.seek(0, os.SEEK_END) - torn_bytes
                    file.truncate(end)
                    torn = AuditEntry(
                        "", "", "", "mend", LINES, "ok", reason=f"a line of {torn_bytes} bytes was torn"
                    )
                    number, digest = self._write(file, torn, number, digest)
                if number > 1 and head is None:  # the first record is on the disc before the head
                    number, digest = self._mend_head(folder, file, number, digest)
                if file.seek(0, os.SEEK_END) >= FULL_BYTES:
                    self._note_end(number, digest)  # first: after a crash nothing else would know the end
                    turn_over(folder, number)
                    continue  # another process may have begun the next file by now
                number, digest = self._write(file, deed, number, digest)
                self._note_end(number, digest)
                self._prune(folder, file, number, digest)
                return {"number": number, "hash": digest}

    def _write(self, file: BinaryIO, deed: AuditEntry, number: int, digest: str) -> tuple[int, str]:
        """Write one line; return its number and hash."""
        body = {
            "number": number + 1,
            "time": datetime.fromtimestamp(self._utc_s(), UTC).isoformat(timespec="milliseconds"),
            **{name: _short(getattr(deed, name)) for name in AuditEntry.__slots__},
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
        return number + 1, digest

    def _mend_head(self, folder: int, file: BinaryIO, number: int, digest: str) -> tuple[int, str]:
        """Replace a lost head, and record that it was lost: nothing knows any more where the chain ended."""
        reason = "it was missing or damaged: the newest records before this one may be missing, too"
        lost = AuditEntry("", "", "", "mend", HEAD, "ok", reason=reason)
        first, previous = _start(folder, file)
        number, digest = self._write(file, lost, number, digest)
        self._put_head(AuditHead(number, digest, first, previous))
        return number, digest

    def _note_end(self, number: int, digest: str) -> None:
        """Note the end of the chain in its head."""
        before = self._head() or AuditHead(0, START)
        self._put_head(AuditHead(number, digest, before.first, before.previous))

    def _put_head(self, head: AuditHead) -> None:
        write_atomically(self._folder / HEAD, head.to_bytes(), mode=0o600, is_state=True)

    def _prune(self, folder: int, file: BinaryIO, number: int, digest: str) -> None:
        """Delete the oldest full files when there are too many, and those that a crash left behind."""
        head, full = self._head(), _full(folder)
        if head is None:
            return
        old = full[: max(len(full) - KEPT, 0)]
        if old and old[-1][0] >= head.first:
            last, name = old[-1]
            with _reading(folder, name) as oldest:
                found = _tail(oldest)[0]
            entry = AuditEntry(
                "",
                "",
                "",
                "let go",
                LINES,
                "ok",
                reason=f"records {head.first} to {last}: there is no room for all",
            )
            number, digest = self._write(file, entry, number, digest)
            # before deleting: files with records before the head's first are ignored from now on
            self._put_head(AuditHead(number, digest, last + 1, "" if found is None else found[1]))
        for _, name in old:
            with suppress(FileNotFoundError):
                os.unlink(name, dir_fd=folder)

    def _head(self) -> AuditHead | None:
        """Head of the chain; None if it is missing or damaged. Raises `OSError`."""
        with open_folder(self._folder) as folder:
            data = _read_head(folder)
        return None if data is None else head_in(data)

    def verify(self, wanted: Wanted = lambda _record: True, last: int | None = None) -> AuditVerdict:
        """Verify the whole chain. Raises `FileFormatError`.

        wanted : filter of the records to return. last : return only so many, the newest; None: all.
        """
        with ExitStack() as opened:
            try:
                data, full, head_data = self._opened(opened)
                head = None if head_data is None else head_in(head_data)
                chain = AuditChain(head)
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
                where = self._called / LINES
                raise FileFormatError(f"{where}: cannot read the audit: {error.strerror or error}") from error
        problem = chain.problem or _ends(chain, head, at_head, has_head=head_data is not None)
        if problem and data is None and not chain.problem and head is not None:
            problem = f"{LINES} is missing, with {head.number - chain.number} records"
        return AuditVerdict(tuple(kept), chain.first, chain.number, chain.digest, problem, len(torn))

    def _opened(self, opened: ExitStack) -> tuple[bytes | None, list[tuple[int, BinaryIO]], bytes | None]:
        """Consistent snapshot of all files: content of the current one (None without), full ones, and head.

        Full files are never written again, so that they can be read later. Writers wait only for this call.
        """
        with ExitStack() as held:
            try:
                folder = held.enter_context(open_folder(self._folder))
            except FileNotFoundError:
                return None, [], None
            try:
                data = _content(held.enter_context(_locked(folder, make=False)))
            except FileNotFoundError:
                data = None
            full: list[tuple[int, BinaryIO]] = []
            for number, name in _full(folder):
                full.append((number, opened.enter_context(_reading(folder, name))))
            return data, full, _read_head(folder)

    def _lines(
        self, full: list[tuple[int, BinaryIO]], first: int, data: bytes | None
    ) -> Iterator[list[bytes]]:
        """Lines of each file in turn; the last item of each is an unfinished line, or b""."""
        for number, file in full:
            if number >= first:  # an older file should be deleted, but a crash left it
                lines = _content(file).split(b"\n")
                yield lines if not lines[-1] else [*lines, b""]
        yield (data or b"").split(b"\n")


def _ends(chain: AuditChain, head: AuditHead | None, at_head: str, *, has_head: bool) -> str:
    """Reason why an intact chain does not end where the head says; "" when it does."""
    if head is None:
        if has_head:
            return f"{HEAD} cannot be read"
        # the first line is on the disc before the head file
        return f"{HEAD} is missing: lines at the end may be, too" if chain.number > 1 else ""
    if head.number > chain.number:
        return f"cut off: the last {head.number - chain.number} of {head.number} records are missing"
    if head.number < chain.first or at_head != head.hash:
        return f"record {head.number} is not the one that {HEAD} names"
    return ""


def _full(folder: int) -> list[tuple[int, str]]:
    """Full files of a folder as (number of the last record, name), in that order."""
    found = (FULL.fullmatch(name) for name in os.listdir(folder))
    return sorted((int(name[1]), name[0]) for name in found if name)


def turn_over(folder: int, number: int) -> None:
    """Rename the current file as full, so that the next one can begin."""
    os.rename(LINES, f"audit.{number:09}.jsonl", src_dir_fd=folder, dst_dir_fd=folder)
    os.fsync(folder)


def _reading(folder: int, name: str) -> BinaryIO:
    """Open a file of the folder for reading. Raises `OSError`."""
    return os.fdopen(open_plain(name, os.O_RDONLY, folder), "rb")


def _read_head(folder: int) -> bytes | None:
    """Content of the head file; None if there is none. Raises `OSError`."""
    try:
        with _reading(folder, HEAD) as file:
            return _content(file)
    except FileNotFoundError:
        return None


def _content(file: BinaryIO) -> bytes:
    """Content of a file of an audit. Raises `OSError`, also for a file that is too large to be one."""
    most = FULL_BYTES + TAIL_BYTES
    data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than {most} bytes: no file of an audit is as large")
    return data


def _tail(file: BinaryIO) -> tuple[tuple[int, str] | None, int]:
    """Number and hash of the last whole line, and the length of a torn line after it."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - TAIL_BYTES))
    whole, newline, torn = file.read().rpartition(b"\n")
    return end_of(whole.rpartition(b"\n")[2]) if newline else None, len(torn)


def _end(folder: int, file: BinaryIO, head: AuditHead | None) -> tuple[int, str, int]:
    """Number and hash that the next line follows, and length of a torn line; file : the current one.

    Taken from the last line or the head, whichever is later: verifying then shows if lines are missing.
    """
    last, torn_bytes = _tail(file)
    if last is None and (full := _full(folder)):
        with _reading(folder, full[-1][1]) as newest:
            last = _tail(newest)[0]
    ends = [(0, START) if last is None else last]
    if head is not None:
        ends.append((head.number, head.hash))
    number, digest = max(ends, key=lambda end: end[0])
    return number, digest, torn_bytes


def _start(folder: int, file: BinaryIO) -> tuple[int, str]:
    """Number of the oldest record kept, and the hash that it follows; file : the current one."""
    full = _full(folder)
    if full:
        with _reading(folder, full[0][1]) as oldest:
            line = oldest.readline(TAIL_BYTES)
    else:
        file.seek(0)
        line = file.readline(TAIL_BYTES)
    return start_of(line) or (1, START)


def _short(text: str | None) -> str | None:
    """Shorten a text to the limit for a field."""
    return None if text is None else text[:MAX_TEXT]


@contextmanager
def _locked(folder: int, *, make: bool = True) -> Iterator[BinaryIO]:
    """Open and lock the current file: exclusively with make, else shared for reading. Raises `OSError`."""
    while True:
        with os.fdopen(_open_lines(folder, make=make), "r+b" if make else "rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX if make else fcntl.LOCK_SH)
            if _is_at(file, folder):
                yield file
                return


def _open_lines(folder: int, *, make: bool) -> int:
    """Open the current file; with make, create it if missing, with the folder's owner. Raises `OSError`."""
    while True:
        try:
            return open_plain(LINES, os.O_RDWR if make else os.O_RDONLY, folder)
        except FileNotFoundError:
            if not make:
                raise
        with suppress(FileExistsError):  # another process was quicker
            handle = open_plain(LINES, os.O_RDWR | os.O_CREAT | os.O_EXCL, folder)
            copy_owner(handle, folder)
            return handle


def _is_at(file: BinaryIO, folder: int) -> bool:
    """Whether an open file still has its name: another process may have renamed it as full meanwhile."""
    try:
        there = os.stat(LINES, dir_fd=folder, follow_symlinks=False)
        return os.path.samestat(os.fstat(file.fileno()), there)
    except FileNotFoundError:
        return False
