"""`edged audit`: who did what to the cell, and whether that is all of it."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console

from edged.errors import FileFormatError
from edged.files.owners import as_owner
from edged.files.statefolder import state_folder
from edged.identity.audit import LINES, AuditFile, shown


def audit(config: Path, console: Console, *, as_json: bool, last: int) -> int:
    """Verify the chain, and print the last records. 0: it holds; 1: it does not.

    Raises `FileFormatError` when it cannot be read.
    """
    folder = state_folder(config)
    try:
        with as_owner(folder) as place:
            verdict = AuditFile(place, called=folder).verify(last=last)
    except OSError as error:
        raise FileFormatError(f"{folder}: cannot read the audit: {error.strerror or error}") from error
    records = verdict.records
    if as_json:
        document = {
            "records": list(records),
            "first": verdict.first,
            "count": verdict.count,
            "problem": verdict.problem or None,
            "torn_bytes": verdict.torn_bytes,
        }
        print(json.dumps(document))
        return 1 if verdict.problem else 0
    for record in records:
        why = f" ({record['reason']})" if record["reason"] else ""
        who = f"{record['user'] or 'nobody'} {record['role']}".strip()
        said = f"{record['verb']} {record['object']}: {record['outcome']}{why}"
        console.print(
            shown(f"{record['number']:6}  {record['time']}  {who} at {record['address'] or 'here'}  {said}"),
            markup=False,
            highlight=False,
        )
    if verdict.torn_bytes:
        console.print(f"a crash tore the last line, {verdict.torn_bytes} bytes: it was never finished")
    if verdict.problem:
        console.print(f"{folder / LINES}: {verdict.problem}", markup=False, highlight=False)
        return 1
    kept = f"records {verdict.first} to {verdict.count}" if verdict.first > 1 else f"{verdict.count} records"
    digest = verdict.hash if verdict.count else "none"
    console.print(f"{kept}, the chain holds; last hash {digest}", highlight=False)
    return 0
