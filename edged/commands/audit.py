"""`edged audit`: who did what to the cell, and the evidence that the record is complete."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import IO

from rich.console import Console

from edged.commands.saying import print_safe
from edged.config.reading import load, read
from edged.errors import FileFormatError, UserError, translated
from edged.files.statefolder import page_folder
from edged.identity.audit import LINES, AuditFile, AuditVerdict
from edged.identity.auditjournal import FIELDS, MAX_LINE_BYTES, JournalVerdict, JournalWriter, compare
from edged.owners import as_owner, file_to_read

JOURNAL = "journal"
JOURNALCTL = (
    "journalctl", "--quiet", "--no-pager", "--output=json", f"--output-fields={','.join(FIELDS)}",
    "SYSLOG_IDENTIFIER=edged",
)  # fmt: skip


def audit(config: Path, console: Console, *, as_json: bool, last: int, against: str | None = None) -> int:
    """Verify the chain and print the last records. 0: it holds; 1: it does not, or the journal differs.

    against : "journal": this machine's journal; else a file of `journalctl --output=json`; None: no
    comparison.
    Raises `UserError` when one of them cannot be read, `ConfigError` when nothing was kept and there is no
    configuration: its name is mistyped.
    """
    folder = page_folder(config)
    if not folder.exists():
        read(config)
    with translated(FileFormatError, f"{folder}: cannot read the audit"), as_owner(folder) as place:
        verdict = AuditFile(place, called=folder).verify(last=last)
    witness = None if against is None else _against(against, config, folder)
    if as_json:
        document = {
            "records": list(verdict.records),
            "first": verdict.first,
            "count": verdict.count,
            "problem": verdict.problem or None,
            "torn_bytes": verdict.torn_bytes,
            "journal": None if witness is None else {**asdict(witness), "problem": witness.problem or None},
        }
        print(json.dumps(document))
    else:
        _print(verdict, witness, folder, console)
    is_shown = witness is None or (not witness.problem and (witness.newest > 0 or not verdict.count))
    return 0 if not verdict.problem and is_shown else 1


def _against(source: str, config: Path, folder: Path) -> JournalVerdict:
    """Compare the audit of a configuration with the journal. Raises `UserError`."""
    try:
        user = folder.stat().st_uid
    except FileNotFoundError:  # nothing was kept, or all was deleted
        user = os.getuid()
    writer = JournalWriter(config.stem, load(config).cell.name, user)
    with (
        translated(UserError, f"{source}: the journal cannot be read"),
        _entries(source) as stream,
        as_owner(folder) as place,
    ):
        lines = iter(lambda: stream.readline(MAX_LINE_BYTES), b"")
        return compare(AuditFile(place, called=folder), lines, writer)


@contextmanager
def _entries(source: str) -> Iterator[IO[bytes]]:
    """Open the entries of the journal, or a file of them. Raises `UserError`, `OSError`."""
    if source != JOURNAL:
        with file_to_read(Path(source)) as file:
            yield file
        return
    with subprocess.Popen(JOURNALCTL, stdout=subprocess.PIPE) as process:
        if process.stdout is not None:
            yield process.stdout
    if process.returncode:
        raise UserError(f"{JOURNALCTL[0]} failed ({process.returncode}): the journal cannot be read")


def _print(verdict: AuditVerdict, witness: JournalVerdict | None, folder: Path, console: Console) -> None:
    for record in verdict.records:
        why = f" ({record['reason']})" if record["reason"] else ""
        who = f"{record['user'] or 'nobody'} {record['role']}".strip()
        deed = f"{record['verb']} {record['object']}: {record['outcome']}{why}"
        print_safe(
            f"{record['number']:6}  {record['time']}  {who} at {record['address'] or 'here'}  {deed}", console
        )
    if verdict.torn_bytes:
        print_safe(f"a crash tore the last line, {verdict.torn_bytes} bytes: it was never finished", console)
    if verdict.problem:
        print_safe(f"{folder / LINES}: {verdict.problem}", console)
    elif not verdict.count:
        print_safe(f"{folder}: no record is kept here", console)
    else:
        some = f"records {verdict.first} to {verdict.count}"
        kept = some if verdict.first > 1 else f"{verdict.count} records"
        print_safe(f"{kept}, the chain holds; last hash {verdict.hash}", console)
    if witness is None:
        print_safe("who may write these files can replace all of them: --against journal compares", console)
    else:
        _print_witness(verdict, witness, console)


def _print_witness(verdict: AuditVerdict, witness: JournalVerdict, console: Console) -> None:
    if witness.problem:
        print_safe(f"the journal: {witness.problem}", console)
    elif witness.newest:
        after = verdict.count - witness.newest
        print_safe(
            f"the journal has record {witness.newest}, and none that is another one here"
            + (f"; the {after} after it are in the files alone" if after else ""),
            console,
        )
    else:
        print_safe("the journal has none of these records, or may not be read: it shows nothing", console)
    if witness.let_go:
        print_safe(
            f"the journal still has records up to {witness.let_go} that the files have let go", console
        )
    if witness.lost:
        print_safe(f"the journal has {witness.lost} actions that the files could not take", console)
