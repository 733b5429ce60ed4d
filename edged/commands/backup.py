"""`edged backup` and `edged restore`: all files of a cell in one archive, and back again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from edged.commands.saying import print_safe
from edged.errors import ConfigError, UserError
from edged.files.atomic import write_file
from edged.files.outputs import check_folder, check_outputs
from edged.setup.cellfiles import read_cell
from edged.setup.releases.archive import REGISTERS, Backup, fits_map, make, read
from edged.setup.releases.restoring import restore as put_back
from edged.setup.releases.rights import rights_at, rights_in
from edged.setup.releases.signing import signature_file, signature_of

MAX_LINES = 50
"""Limit of printed lines of one kind, as an archive may name very many."""


def backup(
    config: Path, output: Path, console: Console, *, force: bool = False, key: Path | None = None
) -> int:
    """Write the archive, proven by restoring it once. Raises `UserError`; no archive is left then.

    key : private, PEM; signs the archive, in a file beside it.
    """
    if not output.name.lower().endswith((".tar.gz", ".tgz")):
        raise UserError(f"{output}: an archive is a tar: expected a name that ends in .tar.gz")
    if output.exists() and not force:
        raise UserError(f"{output}: exists; choose another name, or --force to replace it")
    check_outputs({"--output": output}, {"CONFIG": config} | ({} if key is None else {"--sign": key}))
    made = make(config)
    taken, data = made.backup, made.archive
    signed = None if key is None else signature_of(data, key)
    write_file(output, data, mode=0o600)
    print_safe(
        f"{output}: cell {taken.cell}, fingerprint {taken.fingerprint}, {len(taken.files)} files, "
        f"{len(data) / 1024:.0f} KiB",
        console,
    )
    if signed is not None:
        signature, who = signed
        write_file(signature_file(output), signature)
        print_safe(f"signed with the key {who}: {signature_file(output)}", console)
    _print_left_out(taken, console)
    if made.holds_password:
        print_safe("it holds the hash of a password: only its owner may read it (mode 600)", console)
    return 0


def restore(
    archive: Path,
    output: Path | None,
    console: Console,
    *,
    force: bool = False,
    signed_by: Path | None = None,
) -> int:
    """Check an archive; with an output, put its files into that folder, all of them or none.

    force : existing files of this cell are moved aside and kept beside the folder; other files stay as they
    are. signed_by : a public key, PEM, whose signature the archive must have. Returns 0, or 1 if the daemon
    would not start with the restored files. Raises `UserError`; nothing has changed then.
    """
    taken = read(archive, signed_by)
    if output is not None:
        check_folder(output)
    print_safe(
        f"{archive}: cell {taken.cell}, fingerprint {taken.fingerprint}, written by edged {taken.version} at "
        f"{taken.created:%Y-%m-%d %H:%M} UTC; {len(taken.files)} files, every checksum is right",
        console,
    )
    if signed_by is not None:
        print_safe(f"{signature_file(archive).name}: signed with the key in {signed_by}", console)
    _print_left_out(taken, console)
    if not fits_map(taken):
        print_safe(
            f"the Modbus map of this version is another one: compare {REGISTERS} with `edged registers`",
            console,
        )
    rights = rights_in(taken.files, taken.config)
    former = None if output is None else rights_at(output / taken.config)
    if former is None:
        _print_lines("it sets", rights.lines(), console)
    if output is None:
        return 0
    try:
        kept = put_back(taken, output, force=force)
    except UserError as error:
        if error.code != "not_empty":
            raise
        raise UserError(f"{error} with --force") from None
    if kept is not None:
        print_safe(f"the cell's former files are in {kept} now", console)
    if former is not None:
        _print_lines("other than before", rights.changed_from(former), console)
    return _tell_verdict(taken, output, console)


def _tell_verdict(taken: Backup, output: Path, console: Console) -> int:
    """Print whether the daemon would start with the archive's fingerprint; 1 if it would not start."""
    config = output / taken.config
    try:
        fingerprint = read_cell(config).fingerprint
    except ConfigError as error:
        for line in f"restored, but it would not start here: {error}".split("\n"):
            print_safe(line, console)
        return 1
    is_stated = fingerprint == taken.fingerprint
    verdict = "as the archive says" if is_stated else "another one: the version reads it differently"
    print_safe(
        f"restored into {output}; fingerprint {fingerprint}, {verdict}. Next: edged doctor {config}", console
    )
    return 0


def _print_lines(beginning: str, lines: Sequence[str], console: Console) -> None:
    for line in lines[:MAX_LINES]:
        print_safe(f"{beginning}: {line}", console)
    if len(lines) > MAX_LINES:
        print_safe(f"{beginning}: {len(lines) - MAX_LINES} more", console)


def _print_left_out(taken: Backup, console: Console) -> None:
    _print_lines("not in a backup", [f"{place} = {file}" for place, file in taken.left_out.items()], console)
