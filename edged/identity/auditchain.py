"""Hash chain of the audit: records as lines of JSON, each with the hash of the one before, and its check."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from edged.domain.numerals import json_of

START = "0" * 64
"""Previous hash of the first record."""


@dataclass(frozen=True, slots=True)
class AuditHead:
    """Head of the chain. number, hash : of the last record. first : number of the first record kept.

    previous : hash of the record before the first one.
    """

    number: int
    hash: str
    first: int = 1
    previous: str = START

    def to_bytes(self) -> bytes:
        """Encode the head as the content of its file."""
        return json.dumps({name: getattr(self, name) for name in self.__slots__}).encode()


def head_in(data: bytes) -> AuditHead | None:
    """Decode the content of a head file; None if it is not a valid head."""
    try:
        head = json_of(data)
        number, first, previous = head["number"], head.get("first", 1), str(head.get("previous", START))
        are_numbers = type(number) is type(first) is int and number >= 0 and first >= 1
        return AuditHead(number, str(head["hash"]), first, previous) if are_numbers else None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def line_of(body: dict[str, Any]) -> tuple[bytes, str]:
    """Line of a record, with its hash added, and the hash. body : the record without it."""
    digest = _hash(body)
    return _canonical({**body, "hash": digest}) + b"\n", digest


def end_of(line: bytes) -> tuple[int, str] | None:
    """Number and hash that a line states, unchecked; None if it is not a record."""
    return _stated(line, "hash")


def start_of(line: bytes) -> tuple[int, str] | None:
    """Number that a line states, and the hash that it follows, unchecked; None if it is not a record."""
    return _stated(line, "previous")


def _stated(line: bytes, name: str) -> tuple[int, str] | None:
    record = _record(line)
    if record is None or not isinstance(record.get("number"), int):
        return None
    return record["number"], str(record.get(name))


class AuditChain:
    """Checks lines in turn. number, digest : of the last valid record.  problem : of the first invalid."""

    def __init__(self, begins: AuditHead | None) -> None:
        self.first = 1 if begins is None else begins.first
        self.number = self.first - 1
        self.digest = START if begins is None else begins.previous
        self.problem = ""

    def follow(self, lines: Iterable[bytes]) -> Iterator[dict[str, Any]]:
        """Yield the records, up to the first that does not fit."""
        for line in lines:
            record = _record(line)
            self.problem = self._problem(line, record)
            if self.problem or record is None:
                return
            self.number, self.digest = self.number + 1, str(record["hash"])
            yield record

    def _problem(self, line: bytes, record: dict[str, Any] | None) -> str:
        number = self.number + 1
        if record is None:
            return f"record {number} cannot be read"
        found = record.get("number")
        if isinstance(found, int) and found > number:
            return f"records {number} to {found - 1} are missing"
        body = {name: value for name, value in record.items() if name != "hash"}
        if found != number or record.get("hash") != _hash(body) or _canonical(record) != line:
            return f"record {number} was changed: its hash does not fit"
        if record.get("previous") != self.digest:
            return f"record {number} does not follow the one before it"
        return ""


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
