"""Support bundles: a failed cycle with its setup, and a document of findings, in one ZIP.

    support.json        findings, versions, configuration, the audit's tail; SHA-256 of each other member
    cycles/NAME.zip     the recording, as the recorder wrote it
    setups/1a2b3c4d/    rig, jobs and configuration of that cycle, without secrets

`edged replay` measures the cycle again elsewhere. A bundle may come from anywhere: nothing is written before
all of it has been checked, and then only into a temporary folder.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import re
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from edged.domain.measurement import Status
from edged.domain.numerals import json_of
from edged.errors import FileFormatError, UserError
from edged.files import recording
from edged.files.atomic import MAX_DOCUMENT_BYTES, MAX_FILE_BYTES, read_bytes, write_atomically
from edged.files.secrettext import HASH, without_secrets
from edged.files.zipmembers import open_zip, read_member
from edged.identity.audit import AuditFile
from edged.payload import Json
from edged.setup.cellfiles import CellFiles, UnfinishedCell
from edged.setup.recordings.setups import CONFIG
from edged.setup.releases.archive import MAX_BYTES, wrong_name

FORMAT, VERSION = "edged-support", 2
DOCUMENT = "support.json"
AUDIT_TAIL = 200
"""Number of audit records included: some days of setup."""
_SETUP = re.compile(r"setups/[0-9a-f]{8}/(.+)")
_PRIVATE_KEY = re.compile(rb"-----BEGIN [A-Z ]*PRIVATE KEY-----")
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, NotImplementedError, RuntimeError, OSError
)  # fmt: skip


def failed_cycle(folder: Path | None, number: int | None = None) -> dict[str, bytes]:
    """The newest recording that was not good and has pictures, with its setup, as members of a bundle.

    folder : of the recorder; None if nothing is recorded. number : of a recording to take instead. Returns {}
    if there is none. Raises `UserError` for an unknown number, and `FileFormatError` if it cannot be read.
    """
    entries = [] if folder is None else recording.entries(folder)[::-1]
    if number is not None:
        wanted = [entry for entry in entries if entry.index == number]
        if not wanted:
            raise UserError(f"there is no recording {number}")
        return _members(wanted[0])
    for entry in entries:
        if entry.status in (Status.OK, Status.CAPTURE_FAULT):
            continue
        try:
            if recording.load_snapshot(entry.path)[1]:
                return _members(entry)
        except FileFormatError:  # removed meanwhile, or damaged: an older one will do
            continue
    return {}


def _members(entry: recording.Entry) -> dict[str, bytes]:
    """Members with a recording and its setup. Raises `FileFormatError`."""
    setup = recording.setup_folder(entry.path.parent.parent, entry.fingerprint)
    if not setup.is_dir():
        raise FileFormatError(f"{entry.path}: its rig and jobs are not there: expected {setup}")
    found = {f"cycles/{entry.path.name}": read_bytes(entry.path, "a recording")}
    for file in sorted(path for path in setup.rglob("*") if path.is_file()):
        name = file.relative_to(setup).as_posix()
        data = read_bytes(file, "a recording's setup")
        found[f"setups/{entry.fingerprint}/{name}"] = without_remarks(data) if name == CONFIG else data
    return found


def about(state: Path, cell: CellFiles | UnfinishedCell, now: datetime) -> Json:
    """Document fields about a cell in every bundle. state : folder of its page. Raises `FileFormatError`."""
    audit = AuditFile(state).verify(last=AUDIT_TAIL)
    return {
        "versions": recording.versions(),
        "system": platform.platform(),
        "created": now.isoformat(),
        "cell": cell.config.cell.name,
        "fingerprint": cell.fingerprint,
        "configuration": without_remarks(cell.contents[CONFIG]).decode(),
        "audit": {"problem": audit.problem or None, "count": audit.count, "records": audit.records},
    }


def without_remarks(text: bytes) -> bytes:
    """A configuration without secrets, and without comments, as people write passwords in them, too."""
    return without_secrets(text, comments=False)


def pack(document: Json, members: Mapping[str, bytes]) -> bytes:
    """Pack a bundle. Raises `UserError` if it contains a secret or is too large."""
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in members.items()}
    head = {"format": FORMAT, "version": VERSION, **document, "files": digests}
    whole = {DOCUMENT: json.dumps(head, indent=1, default=str).encode(), **members}
    for name, data in whole.items():
        if HASH.search(data.decode("latin-1")) or _PRIVATE_KEY.search(data):
            raise UserError(f"{name}: a password's hash or a private key is in it: no bundle is made")
    if sum(map(len, whole.values())) > MAX_BYTES:
        raise UserError(f"a bundle of more than {MAX_BYTES // 2**20} MiB")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in whole.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def is_bundle(path: Path) -> bool:
    """Whether a file looks like a support bundle; False if it cannot be read."""
    try:
        with path.open("rb") as file, open_zip(file) as archive:
            return DOCUMENT in archive.namelist()
    except _DAMAGE:
        return False


def unpack(data: bytes, place: str) -> tuple[Json, dict[str, bytes]]:
    """Check and read a bundle: document and other members. Raises `FileFormatError` that names the place."""
    found: dict[str, bytes] = {}
    left = MAX_BYTES
    try:
        with open_zip(io.BytesIO(data)) as archive:
            for member in archive.infolist():
                name = member.filename
                if name in found or not _is_ours(name):
                    raise FileFormatError(f"{place}: {name!r}: no member of a support bundle, or there twice")
                most = MAX_DOCUMENT_BYTES if name == DOCUMENT else MAX_FILE_BYTES
                found[name] = read_member(archive, member, min(most, left))
                left -= len(found[name])
        document = json_of(found.pop(DOCUMENT))
    except (*_DAMAGE, RecursionError) as error:
        raise FileFormatError(f"{place}: not a support bundle: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise FileFormatError(f'{place}: {DOCUMENT}: expected "format": "{FORMAT}"')
    if document.get("version") != VERSION:
        raise FileFormatError(f"{place}: version {document.get('version')!r}, this edged reads {VERSION}")
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in found.items()}
    if document.get("files") != digests:
        raise FileFormatError(f"{place}: its members are not those that {DOCUMENT} names: it is damaged")
    return document, found


def _is_ours(name: str) -> bool:
    folder, _, rest = name.partition("/")
    if folder == "cycles":
        return recording.NAME.fullmatch(rest) is not None
    inside = _SETUP.fullmatch(name)
    return name == DOCUMENT or (inside is not None and not wrong_name(inside[1]))


@contextmanager
def opened(path: Path) -> Iterator[Path]:
    """Context with a temporary folder of recordings if the path is a bundle; any other path as it is.

    Raises `FileFormatError`.
    """
    if not path.is_file() or not is_bundle(path):
        yield path
        return
    _, members = unpack(read_bytes(path, "a support bundle", MAX_BYTES), str(path))
    with tempfile.TemporaryDirectory(prefix="edged-support-") as place:
        for name, data in members.items():
            file = Path(place) / name
            file.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(file, data)
        yield Path(place)
