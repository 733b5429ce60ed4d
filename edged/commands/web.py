"""`edged web invite`: makes a one-time code for a new engineer; `edged password`: hashes a password."""

from __future__ import annotations

import getpass
import sys
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from edged.config.reading import load
from edged.errors import UserError, translated
from edged.files.statefolder import page_folder
from edged.identity.audit import AuditEntry, AuditFile
from edged.identity.invite import VALID_S, Invite
from edged.identity.passwords import MIN_LENGTH, hash_password, why_weak
from edged.identity.users import UserName
from edged.owners import as_owner


def invite(config: Path, name: str) -> int:
    """Print a code for a person, valid at once. Raises `UserError` if it would be of no use."""
    web = load(config).web
    if web is None or not web.commissioning:
        raise UserError(f"{config}: web.commissioning is off: this cell cannot be set up on the page")
    try:
        TypeAdapter(UserName).validate_python(name)
    except ValidationError as error:
        raise UserError(f"{name!r} cannot be a name: expected 1 to 64 printable characters") from error
    folder, who = page_folder(config), getpass.getuser()
    with translated(UserError, f"{folder}: the code cannot be saved"), as_owner(folder) as place:
        code = Invite(place).make(name)
        _note(AuditFile(place), AuditEntry(who, "", "", "make", f"invitation of {name}", "ok"), folder)
    scheme, host = "https" if web.certificate else "http", f"[{web.host}]" if ":" in web.host else web.host
    address, hours = f"{scheme}://{host}:{web.port}/invite", round(VALID_S / 3600)
    print(f"{code}   for {name} at {address}, once, within {hours} hours")
    return 0


def password() -> int:
    """Ask twice on a terminal, or read one line from a pipe; print the hash."""
    if sys.stdin.isatty():
        first = getpass.getpass("password: ", stream=sys.stderr)
        if first != getpass.getpass("again: ", stream=sys.stderr):
            raise UserError("the two passwords differ")
    else:
        first = sys.stdin.readline().rstrip("\n")
    if len(first) < MIN_LENGTH:
        raise UserError(f"a password of at least {MIN_LENGTH} characters is expected")
    if why := why_weak(first):
        raise UserError(why)
    print(hash_password(first))
    sys.stderr.write(
        "edged: for web.password_hash or opcua.password_hash; "
        "edged check says whether others may read the file\n"
    )
    return 0


def _note(audit: AuditFile, deed: AuditEntry, folder: Path) -> None:
    """Add an entry to the audit chain; a failure is only reported, as the code has already been made."""
    try:
        audit.add(deed)
    except OSError as error:
        sys.stderr.write(f"edged: {folder}: this is not in the audit: {error.strerror or error}\n")
