"""Who did what to the cell: lines of JSON, each with the hash of the one before.

A changed, missing or inserted line breaks the chain. That lines are missing at the end is told by a second
file, which holds the number and hash of the last one; a line that a crash tore is neither, and is said so.
Whoever may write both files can write another history: its hashes are not those that the journal has.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from edged.errors import FileFormatError
from edged.files.atomic import make_folders, write_atomically
from edged.files.statefolder import hand_over

LINES, HEAD = "audit.jsonl", "audit.head"
TAIL_BYTES = 64 * 1024
"""A line is shorter."""
MAX_TEXT = 300
START = "0" * 64
"""What the first line has as the hash before it."""


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
    """Of a chain. problem : "" for one that holds. torn_bytes : of a line that a crash tore, at the end."""

    records: tuple[dict[str, Any], ...]
    problem: str = ""
    torn_bytes: int = 0


class AuditFile:
    """The chain of a cell; processes may add to it at the same time."""

    def __init__(self, folder: Path, utc_s: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._utc_s = utc_s

    def add(self, deed: Deed) -> dict[str, Any]:
        """Keep a deed, on the disc when this returns; its number and hash. Raises `OSError`."""
        make_folders(self._folder)
        with _locked(self._folder / LINES) as file:
            number, digest, torn_bytes = self._end(file)
            if torn_bytes:
                end = file.seek(0, os.SEEK_END) - torn_bytes
                file.truncate(end)
                torn = Deed("", "", "", "mend", LINES, "ok", reason=f"a line of {torn_bytes} bytes was torn")
                number, digest = self._write(file, torn, number, digest)
            number, digest = self._write(file, deed, number, digest)
            head = {"number": number, "hash": digest}
            write_atomically(self._folder / HEAD, json.dumps(head).encode(), mode=0o600)
        for name in (LINES, HEAD):
            hand_over(self._folder / name)
        return {"number": number, "hash": digest}

    def _write(self, file: BinaryIO, deed: Deed, number: int, digest: str) -> tuple[int, str]:
        """One line; returns its number and hash."""
        record = {
            "number": number + 1,
            "time": datetime.fromtimestamp(self._utc_s(), UTC).isoformat(timespec="milliseconds"),
            **{name: _short(getattr(deed, name)) for name in Deed.__slots__},
            "previous": digest,
        }
        record["hash"] = _hash(record)
        start = file.seek(0, os.SEEK_END)
        try:
            file.write(_canonical(record) + b"\n")
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            with suppress(OSError):
                file.truncate(start)
            raise
        return number + 1, str(record["hash"])

    def _end(self, file: BinaryIO) -> tuple[int, str, int]:
        """Number and hash that the next line follows, and bytes of a line that was torn.

        Of the line or of the head, whichever is later: where lines are missing, who verifies sees the gap.
        """
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - TAIL_BYTES))
        tail = file.read()
        whole, newline, torn = tail.rpartition(b"\n")
        head = _head(self._folder) or (0, START)
        last = (0, START)
        if newline:
            record = _record(whole.rpartition(b"\n")[2])
            if record is not None and isinstance(record.get("number"), int):
                last = (record["number"], str(record.get("hash")))
        number, digest = last if last[0] >= head[0] else head
        return number, digest, len(torn)

    def verify(self) -> Verdict:
        """Read all of it. Raises `FileFormatError` when that cannot be."""
        lines = self._folder / LINES
        try:
            with _locked(lines, make=False) as file:
                data, head = file.read(), _head(self._folder)
                has_head = (self._folder / HEAD).exists()
        except FileNotFoundError:
            gone = _head(self._folder)
            return Verdict((), "" if gone is None else f"{LINES} is missing, with {gone[0]} records")
        except OSError as error:
            raise FileFormatError(f"{lines}: cannot read the audit: {error.strerror or error}") from error
        whole, newline, torn = data.rpartition(b"\n")
        records, problem = _chain(whole.split(b"\n") if newline else [])
        return Verdict(tuple(records), problem or _ends(records, head, has_head=has_head), len(torn))


def shown(text: str) -> str:
    """A text that a stranger chose, a wrong name for example, as it may be printed."""
    return "".join(letter if letter.isprintable() else "�" for letter in text)


def _chain(lines: list[bytes]) -> tuple[list[dict[str, Any]], str]:
    """Records up to the first that does not fit, and why it does not."""
    records: list[dict[str, Any]] = []
    digest = START
    for number, line in enumerate(lines, 1):
        record = _record(line)
        if record is None:
            return records, f"record {number} cannot be read"
        found = record.get("number")
        if isinstance(found, int) and found > number:
            return records, f"records {number} to {found - 1} are missing"
        given = record.get("hash")
        body = {name: value for name, value in record.items() if name != "hash"}
        if found != number or given != _hash(body) or _canonical(record) != line:
            return records, f"record {number} was changed: its hash does not fit"
        if record.get("previous") != digest:
            return records, f"record {number} does not follow the one before it"
        records.append(record)
        digest = str(given)
    return records, ""


def _ends(records: list[dict[str, Any]], head: tuple[int, str] | None, *, has_head: bool) -> str:
    """Why a chain that holds does not end where it should; "" when it does."""
    if head is None:
        if has_head:
            return f"{HEAD} cannot be read"
        # the first line is on the disc before the head is
        return f"{HEAD} is missing: lines at the end may be, too" if len(records) > 1 else ""
    number, digest = head
    if number > len(records):
        return f"cut off: the last {number - len(records)} of {number} records are missing"
    if number < 1 or records[number - 1]["hash"] != digest:
        return f"record {number} is not the one that {HEAD} names"
    return ""


def _head(folder: Path) -> tuple[int, str] | None:
    try:
        head = json.loads((folder / HEAD).read_bytes())
        return int(head["number"]), str(head["hash"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None


def _record(line: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def _canonical(record: dict[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":"), ensure_ascii=True).encode()


def _hash(body: dict[str, Any]) -> str:
    return hashlib.sha256(_canonical(body)).hexdigest()


def _short(text: str | None) -> str | None:
    """Lines are short, whatever somebody gave as a reason."""
    return None if text is None else text[:MAX_TEXT]


@contextmanager
def _locked(path: Path, *, make: bool = True) -> Iterator[BinaryIO]:
    """A file that no other process reads or writes meanwhile. Raises `OSError`."""
    flags = os.O_RDWR | os.O_CREAT if make else os.O_RDONLY
    handle = os.open(path, flags | os.O_CLOEXEC, 0o600)
    with os.fdopen(handle, "r+b" if make else "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX if make else fcntl.LOCK_SH)
        yield file
