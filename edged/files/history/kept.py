"""Recordings that outlive the recorder's own: cycles that were not good, and every n-th good one.

    plant=PLANT/recordings/cell=CELL/cycles/, setups/   as the recorder has them: `edged replay` reads them
                                     .seen, .sent       what was looked at, and what a bucket has

A recording never changes, so on one file system it is a second link to the same content. Whatever is killed
is repeated by the next run.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from edged.domain.measurement import Status
from edged.errors import UserError
from edged.files import recording
from edged.files.atomic import make_folders, read_bytes, write_atomically
from edged.files.history.bucket import bucket_of

SEEN, SENT = ".seen", ".sent"
MIB = 1024 * 1024


def kept_folder(folder: Path, plant: str, cell: str) -> Path:
    """Where a cell's recordings are kept in a history."""
    return folder / f"plant={plant}" / "recordings" / f"cell={cell}"


def keep_recordings(recorder: Path, kept: Path, every_good: int, most_mib: int, bucket: str = "") -> int:
    """Keep new recordings of a recorder's folder; returns how many.

    every_good : which good ones by their number. most_mib : beyond it the oldest are removed. bucket : s3://...
    that gets them, too, or "". Raises `OSError`, and `UserError` if the upload fails.
    """
    make_folders(kept / "cycles")
    recording.sweep(kept)
    there, seen = recording.entries(recorder), _lines(kept / SEEN)
    new = [
        entry
        for entry in there
        if entry.path.name not in seen and (entry.status != Status.OK or entry.index % every_good == 0)
    ]
    count = sum(_keep(entry, recorder, kept) for entry in new)
    _write(kept / SEEN, (entry.path.name for entry in there))
    try:
        if bucket:
            _send(kept, kept.relative_to(kept.parents[2]), bucket)
    finally:
        _bound(kept, most_mib, bucket)
    return count


def _keep(entry: recording.Entry, recorder: Path, kept: Path) -> bool:
    """Keep a recording and its setup; False if the recorder has removed one of them meanwhile."""
    target = kept / "cycles" / entry.path.name
    setup = recording.setup_folder(recorder, entry.fingerprint)
    try:
        if not recording.setup_folder(kept, entry.fingerprint).is_dir() and setup.is_dir():
            files = [file for file in setup.rglob("*") if file.is_file()]
            contents = {str(file.relative_to(setup)): file.read_bytes() for file in files}
            recording.save_setup(kept, entry.fingerprint, contents)
        if target.exists():
            return False
        try:
            target.hardlink_to(entry.path)
        except OSError:  # another file system, or one without links
            write_atomically(target, entry.path.read_bytes())
    except FileNotFoundError:
        return False
    return True


def _send(kept: Path, place: Path, address: str) -> None:
    """Upload what the bucket was not sent. place : of these recordings in a history. Raises `UserError`."""
    files = [
        file for part in ("setups", "cycles") for file in sorted((kept / part).rglob("*")) if file.is_file()
    ]
    names = {str(file.relative_to(kept)) for file in files}
    sent = _sent(kept, address) & names
    if names <= sent:
        return
    client, base = bucket_of(address)
    try:
        for name in sorted(names - sent, reverse=True):  # setups come before what refers to them
            with client.open_output_stream(f"{base}/{place}/{name}") as there:
                there.write((kept / name).read_bytes())
            sent.add(name)
    except (pa.ArrowException, OSError) as error:
        raise UserError(f"{address}: {error}") from error
    finally:
        _write(kept / SENT, [address, *sent])


def _bound(kept: Path, most_mib: int, bucket: str) -> None:
    """Remove the oldest recordings beyond the limit, and setups that none refers to."""
    # by time, as their numbers begin again with another disc
    entries = sorted(recording.entries(kept), key=lambda entry: entry.recorded)
    sizes = [entry.path.stat().st_size for entry in entries]
    sent = _sent(kept, bucket) if bucket else None
    while entries and sum(sizes) > most_mib * MIB:
        oldest = entries.pop(0)
        sizes.pop(0)
        if sent is not None and f"cycles/{oldest.path.name}" not in sent:
            sys.stderr.write(f"history: {oldest.path} is removed unsent: there is no room for it\n")
        oldest.path.unlink()
    used = {entry.fingerprint for entry in entries}
    recording.forget_setups(kept, recording.setups(kept) - used)


def _sent(kept: Path, address: str) -> set[str]:
    """Names that this bucket was sent."""
    lines = _lines(kept / SENT)
    return lines - {address} if address in lines else set()


def _lines(file: Path) -> set[str]:
    return set(read_bytes(file, "a list").decode().splitlines()) if file.is_file() else set()


def _write(file: Path, lines: Iterable[str]) -> None:
    write_atomically(file, "\n".join(lines).encode(), is_state=True)
