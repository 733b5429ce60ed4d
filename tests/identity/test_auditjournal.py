"""An audit compared with entries of the journal: which entries count, and what they show."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edged.errors import FileFormatError
from edged.identity.audit import AuditEntry, AuditFile
from edged.identity.auditjournal import MOST_OTHERS, JournalVerdict, JournalWriter, compare

WRITER = JournalWriter("left", "c", 1000)
SERVICE = {"_UID": "61234", "_SYSTEMD_UNIT": "edged@left.service", "EDGED_CELL": "c"}


@pytest.fixture
def audit(tmp_path: Path) -> AuditFile:
    """An audit with three records."""
    audit = AuditFile(tmp_path)
    for number in range(1, 4):
        audit.add(AuditEntry("Anna", "engineer", "", "POST", f"setup {number}", "ok"))
    return audit


def hashes(audit: AuditFile) -> list[str]:
    """The hashes of its records."""
    return [record["hash"] for record in audit.verify().records]


def line(number: object, digest: str, **other: Any) -> bytes:
    """A journal entry."""
    return (
        json.dumps({**SERVICE, "EDGED_AUDIT": number, "EDGED_AUDIT_HASH": digest, **other}).encode() + b"\n"
    )


@pytest.mark.parametrize(
    ("source", "counts"),
    [
        (SERVICE, True),
        ({**SERVICE, "_SYSTEMD_UNIT": "edged-page@left.service"}, True),
        ({**SERVICE, "_SYSTEMD_UNIT": "edged@right.service"}, False),
        ({**SERVICE, "_SYSTEMD_UNIT": "edged.service"}, False),
        ({**SERVICE, "_SYSTEMD_UNIT": "xedged@left.service"}, False),
        ({"_UID": "1000", "_SYSTEMD_UNIT": "session-1.scope", "EDGED_CELL": "c"}, True),
        ({"_UID": "1000", "EDGED_CELL": "d"}, False),
        ({"_UID": "1001", "EDGED_CELL": "c"}, False),
        ({"EDGED_CELL": "c"}, False),
    ],
)
def test_only_what_journald_says_is_the_daemons_counts(
    audit: AuditFile, source: dict[str, str], counts: bool
) -> None:
    """Only entries of the daemon's service, or of the files' owner, count, because other fields can be
    forged."""
    entry = {**dict.fromkeys(SERVICE), **source}
    assert (3 if counts else 0) == compare(audit, [line("3", hashes(audit)[2], **entry)], WRITER).newest
    assert counts == bool(compare(audit, [line("3", "0" * 64, **entry)], WRITER).problem)


def test_each_difference_is_named(audit: AuditFile) -> None:
    """The first difference of each kind is named, and records that could not be kept are counted."""
    second = hashes(audit)[1]
    entries = [line("2", second), line("3", "other"), line("9", "a"), line("7", "b"), line("0", "")]
    problem = "record 3 is not the one in the journal; record 7, which the journal has, is missing"
    assert JournalVerdict(2, 0, 1, problem) == compare(audit, entries, WRITER)


@pytest.mark.parametrize(
    "damaged",
    [
        b'{"EDGED_AUDIT"', b"[]", b'"EDGED_AUDIT"', b"[" * 100_000 + b"EDGED_AUDIT", b"EDGED_AUDIT\xff",
        line(["1", "2"], "x"), line(None, "x"), line([49], "x"), line("1_0", "x"), line("\u0661", "x"),
        line("-1", "x"), line("9" * 99, "x"), line("1" + " " * (1 << 20), "x"),
    ],
)  # fmt: skip
def test_what_is_no_entry_of_an_audit_is_none(audit: AuditFile, damaged: bytes) -> None:
    """A damaged line, or an entry of something else, does not count."""
    assert JournalVerdict() == compare(audit, [damaged], WRITER)


def test_records_that_come_while_the_journal_is_read_are_not_missing(audit: AuditFile) -> None:
    """Records that are added while the journal is read are not reported as missing."""

    def entries() -> Iterator[bytes]:
        record = audit.add(AuditEntry("Anna", "engineer", "", "POST", "late", "ok"))
        yield line(str(record["number"]), record["hash"])

    assert "" == compare(audit, entries(), WRITER).problem
    many = (line(str(number), "x") for number in range(10 * MOST_OTHERS, 4, -1))
    assert "record 5, which the journal has, is missing" == compare(audit, many, WRITER).problem


def test_a_file_that_grew_beyond_all_measure_is_not_read(audit: AuditFile, tmp_path: Path) -> None:
    """A file that is larger than any audit's is refused."""
    for name in ("audit.jsonl", "audit.head"):
        with (tmp_path / name).open("r+b") as file:
            size = file.seek(0, 2)
            file.truncate(1 << 40)
            with pytest.raises(FileFormatError, match="no file of an audit is as large"):
                audit.verify()
            file.truncate(size)
    assert "" == audit.verify().problem
