"""Check of an audit against the journal: a daemon writes each record to both, and cannot change the journal.

A user who may write all files of an audit can forge a history with an intact chain, or delete it, but
journald keeps number and hash of the original records. So the chain is authentic up to the newest record
found in both. After that, a compromised daemon may have written anything, to both.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from edged.identity.audit import AuditFile

NUMBER, HASH = "EDGED_AUDIT", "EDGED_AUDIT_HASH"
FIELDS = (NUMBER, HASH, "EDGED_CELL", "_UID", "_SYSTEMD_UNIT")
"""Fields of an entry. Those with an underscore are set by journald itself, and no client can forge them
(systemd.journal-fields(7))."""
MAX_LINE_BYTES = 1 << 20
"""The longest entry, as JSON; a longer line is not the audit's."""
MOST_OTHERS = 1000
"""Maximum number of differing entries to check again: fewer are written while the journal is read."""


@dataclass(frozen=True, slots=True)
class JournalWriter:
    """Writer whose entries count. stem : of the configuration file, part of the service's name.

    cell, user : name of the cell and owner of the audit's files, for a daemon that is not a service.
    """

    stem: str
    cell: str
    user: int

    def wrote(self, entry: dict[str, Any]) -> bool:
        """Whether the service of this configuration wrote an entry, or that user as this cell."""
        instance = "" if self.stem == "cell" else f"@{re.escape(self.stem)}"
        if re.fullmatch(rf"edged(-[a-z]+)?{instance}\.service", str(entry.get("_SYSTEMD_UNIT"))):
            return True
        return entry.get("_UID") == str(self.user) and entry.get("EDGED_CELL") == self.cell


@dataclass(frozen=True, slots=True)
class JournalVerdict:
    """Result of comparing an audit with the journal.

    newest : number of the newest record that both have; 0: none. let_go : newest record that the journal has
    but that was deleted with the old files. lost : number of actions that could not be written to the audit.
    problem : "" if nothing differs.
    """

    newest: int = 0
    let_go: int = 0
    lost: int = 0
    problem: str = ""


def compare(file: AuditFile, entries: Iterable[bytes], writer: JournalWriter) -> JournalVerdict:
    """Compare an audit with entries of the journal, as `journalctl --output=json` prints them, a line each.

    Raises `FileFormatError` when the audit cannot be read.
    """
    first, hashes = _hashes(file)
    newest = let_go = lost = 0
    others: dict[int, str] = {}
    for line in entries:
        number, digest = _record(line, writer)
        if number == 0:
            lost += 1
        elif number is None or hashes.get(number) == digest:
            newest = max(newest, number or 0)
        elif number < first:
            let_go = max(let_go, number)
        else:
            others[number] = digest
            if len(others) > MOST_OTHERS:
                del others[max(others)]
    if others:  # perhaps written, or deleted with an old file, since the files were read
        first, hashes = _hashes(file)
        others = {n: digest for n, digest in others.items() if n >= first and hashes.get(n) != digest}
    return JournalVerdict(newest, let_go, lost, _problem(others, hashes))


def _hashes(file: AuditFile) -> tuple[int, dict[int, str]]:
    """Number of the first record, and the hash of each."""
    hashes: dict[int, str] = {}

    def noted(record: dict[str, Any]) -> bool:
        hashes[record["number"]] = record["hash"]
        return False

    return file.verify(noted).first, hashes


def _record(line: bytes, writer: JournalWriter) -> tuple[int | None, str]:
    """Number and hash in an entry; None for an entry by another writer, or about something else."""
    if len(line) > MAX_LINE_BYTES or NUMBER.encode() not in line:
        return None, ""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return None, ""
    number = entry.get(NUMBER) if isinstance(entry, dict) else None
    if not isinstance(number, str) or not re.fullmatch("[0-9]{1,15}", number) or not writer.wrote(entry):
        return None, ""
    return int(number), str(entry.get(HASH))


def _problem(others: dict[int, str], hashes: dict[int, str]) -> str:
    if not others:
        return ""
    missing = sorted(number for number in others if number not in hashes)
    changed = sorted(number for number in others if number in hashes)
    differences = [f"record {number} is not the one in the journal" for number in changed[:1]]
    differences += [f"record {number}, which the journal has, is missing" for number in missing[:1]]
    return "; ".join(differences)
