"""`edged backup` and `edged restore`: all that a cell stands on in one file, and back again."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from edged.errors import ConfigError, UserError
from edged.files.atomic import write_file
from edged.files.outputs import check_outputs
from edged.setup.cellfiles import read_cell
from edged.setup.releases.archive import REGISTERS, Backup, fits_map, make, read
from edged.setup.releases.archive import restore as put_back


def backup(config: Path, output: Path, console: Console, *, force: bool = False) -> int:
    """Write the archive, proven by restoring it once. Raises `UserError`; then no archive is left."""
    if output.exists() and not force:
        raise UserError(f"{output}: exists; choose another name, or --force to replace it")
    check_outputs({"--output": output}, {"CONFIG": config})
    made = make(config)
    taken, data = made.backup, made.archive
    write_file(output, data, mode=0o600)
    console.print(
        f"{output}: cell {taken.cell}, fingerprint {taken.fingerprint}, {len(taken.files)} files, "
        f"{len(data) / 1024:.0f} KiB",
        markup=False,
        highlight=False,
    )
    _print_left_out(taken, console)
    if made.holds_password:
        console.print(
            "it holds the hash of a password: only its owner may read it (mode 600)",
            markup=False,
            highlight=False,
        )
    return 0


def restore(archive: Path, output: Path | None, console: Console, *, force: bool = False) -> int:
    """Check an archive; with an output put its files into that folder, all of them or none.

    force : files of this cell that are there make room and are kept beside the folder; others stay as they
    are. Returns 0, or 1 when the daemon would not start with what was restored. Raises `UserError`; then
    nothing has changed.
    """
    taken = read(archive)
    console.print(
        f"{archive}: cell {taken.cell}, fingerprint {taken.fingerprint}, written by edged {taken.version} at "
        f"{taken.created:%Y-%m-%d %H:%M} UTC; {len(taken.files)} files, every checksum is right",
        markup=False,
        highlight=False,
    )
    _print_left_out(taken, console)
    if not fits_map(taken):
        console.print(
            f"the Modbus map of this version is another one: compare {REGISTERS} with `edged registers`"
        )
    if output is None:
        return 0
    try:
        kept = put_back(taken, output, force=force)
    except UserError as error:
        if error.code != "not_empty":
            raise
        raise UserError(f"{error} with --force") from None
    if kept is not None:
        console.print(f"the cell's former files are in {kept} now", markup=False, highlight=False)
    return _tell_verdict(taken, output, console)


def _tell_verdict(taken: Backup, output: Path, console: Console) -> int:
    """Whether the daemon would start with the restored cell, and as the same one."""
    config = output / taken.config
    try:
        fingerprint = read_cell(config).fingerprint
    except ConfigError as error:
        console.print(f"restored, but it would not start here: {error}", markup=False, highlight=False)
        return 1
    same = "the same" if fingerprint == taken.fingerprint else "another one: the version reads it differently"
    console.print(
        f"restored into {output}; fingerprint {fingerprint}, {same}. Next: edged doctor {config}",
        markup=False,
        highlight=False,
    )
    return 0


def _print_left_out(taken: Backup, console: Console) -> None:
    for place, file in taken.left_out.items():
        console.print(f"not in a backup: {place} = {file}", markup=False, highlight=False)
