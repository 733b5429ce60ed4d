"""Backup archive: packs all files of a cell into one file, and unpacks them again.

    manifest.json     format and version of the archive, and size and SHA-256 of every other member
    cell.toml         the configuration under its own name; paths in it lead to the members
    rig.json, jobs/   calibration and jobs; Zenoh's own file if there is one
    registers.csv     Modbus map of the version that wrote it, which the PLC's program was made for

Certificates and keys belong to a machine and are not in it, nor are recordings. It contains the hash of the
status page's password, so that a restored cell works, and perhaps secrets in Zenoh's own file: only the owner
may read an archive (mode 0600).

Each new backup is first restored into a temporary folder: the cell in it must load, and have the fingerprint
that its results carry. An archive may come from anywhere: nothing is written before all of it has been
checked.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import re
import tarfile
import tempfile
import tomllib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edged import __version__
from edged.config.chosencameras import chosen_file, read_chosen
from edged.config.chosenconnections import connections_file, read_connections
from edged.config.configuration import Config
from edged.config.tomltext import toml_of
from edged.domain.numerals import json_of
from edged.errors import FileFormatError, UserError
from edged.files.acceptance import acceptance_file
from edged.files.atomic import read_bytes, replace_folder
from edged.files.golden import golden_file
from edged.files.marks import marks_file
from edged.files.rig import read_rig
from edged.setup.cellfiles import CellFiles, UnfinishedCell, read_any_cell, read_cell
from edged.setup.releases.jobsfolder import Jobs, jobs_in, without_pictures
from edged.setup.releases.signing import check_signature

FORMAT = "edged-backup"
VERSION = 1
MANIFEST, REGISTERS = "manifest.json", "registers.csv"
MAX_BYTES = 256 * 1024 * 1024
"""Limit when unpacked. A cell of a hundred jobs has a tenth of it; more is a wrong or malicious file."""
MAX_MEMBERS = 10_000
PART = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_. +@=-]{0,127}")
"""One part of a member's path: excludes names that lead out of the folder, and hidden ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Backup:
    """Content of an archive.

    config : the member that is the configuration.  files : content by name, without the manifest.
    left_out : files that the configuration names and a backup does not hold, by dotted path.
    """

    created: datetime
    version: str
    cell: str
    config: str
    fingerprint: str
    files: Mapping[str, bytes]
    left_out: Mapping[str, str]


# --- backups of a cell ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A backup and its archive. holds_password : it contains the hash of a password."""

    backup: Backup
    archive: bytes
    holds_password: bool


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Replaceable parts of a cell, as file contents; None where there is no such file."""

    rig: bytes | None
    cameras: bytes | None
    connections: bytes | None
    jobs: Jobs


def make(config: Path, parts: Parts | None = None) -> Made:
    """Archive the cell of a configuration, and verify it by restoring it once. Raises `UserError`.

    parts : used instead of the present ones; the cell then need not have jobs yet.
    """
    cell = read_cell(config, elsewhere=True) if parts is None else read_any_cell(config, elsewhere=True)
    if parts is None:
        taken = _backup_of(config, cell, parts_at(cell.config.cell.rig, cell.config.cell.jobs))
    else:
        taken = with_parts(config, parts)
    data = pack(taken)
    if restored(unpack(data, config.name)).fingerprint != taken.fingerprint:
        raise UserError(f"{config}: it changed while the backup was made; try again")
    return Made(taken, data, bool(cell.config.password_hashes()))


def parts_at(rig: Path, jobs: Path) -> Parts:
    """Read the present parts of a cell from its files. Raises `FileFormatError`, `ConfigError`."""
    content = read_rig(rig) if rig.exists() else None
    return Parts(content, read_chosen(rig), read_connections(rig), jobs_in(jobs))


def with_parts(config: Path, parts: Parts) -> Backup:
    """Backup of a configuration's cell with these parts, checked by restoring it once. Raises `UserError`."""
    taken = _backup_of(config, read_any_cell(config, elsewhere=True), parts)
    return replace(taken, fingerprint=restored(taken).fingerprint)


def parts_of(taken: Backup) -> Parts:
    """The parts in a backup."""
    name = names_in(taken.files[taken.config], taken.config).get("cell.rig", "")
    rig, cameras, connections = map(
        taken.files.get, (name, _chosen_member(name), connections_file(Path(name)).as_posix())
    )
    return Parts(rig, cameras, connections, jobs_of(taken))


def _backup_of(config: Path, cell: CellFiles | UnfinishedCell, parts: Parts) -> Backup:
    """Backup of a cell with these parts, still with the cell's present fingerprint. Raises `UserError`."""
    files, left_out = _collect(config, cell.config, parts)
    if sum(map(len, files.values())) > MAX_BYTES // 2:
        files, left_out = _without_pairs(files, left_out)
    now = datetime.now(UTC).replace(microsecond=0)
    name = cell.config.cell.name
    return Backup(now, __version__, name, config.name, cell.fingerprint, files, left_out)


def _without_pairs(
    files: Mapping[str, bytes], left_out: Mapping[str, str]
) -> tuple[dict[str, bytes], dict[str, str]]:
    """Members without the pictures that jobs were taught from, so that a large cell still fits an archive."""
    smaller = without_pictures(files)
    if len(smaller) == len(files):
        return dict(files), dict(left_out)
    remark = f"{len(files) - len(smaller)} pictures that jobs were taught from, too large for an archive"
    return smaller, {**left_out, "cell.jobs": remark}


def restored(taken: Backup) -> CellFiles | UnfinishedCell:
    """Restore a backup into a temporary folder, and read the cell there. Raises `UserError`."""
    with tempfile.TemporaryDirectory(prefix="edged-backup-") as place:
        replace_folder(Path(place) / "cell", taken.files)
        return read_any_cell(Path(place) / "cell" / taken.config, elsewhere=True)


def rig_in(taken: Backup) -> bytes:
    """The rig in a backup. Raises `FileFormatError` when there is none."""
    name = names_in(taken.files[taken.config], taken.config).get("cell.rig", "")
    if name not in taken.files:
        raise FileFormatError(f"{taken.config} of the backup: cell.rig: {name!r} is not in it")
    return taken.files[name]


def jobs_of(taken: Backup) -> dict[str, bytes]:
    """Files of the jobs in a backup, by path in their folder."""
    folder = names_in(taken.files[taken.config], taken.config).get("cell.jobs", "")
    inside = f"{folder}/"
    return {name.removeprefix(inside): data for name, data in taken.files.items() if name.startswith(inside)}


def read(archive: Path, signed_by: Path | None = None) -> Backup:
    """Read an archive and check all checksums. Raises `FileFormatError`.

    signed_by : a public key; the signature by that key is checked before anything in the archive is read.
    Raises `UserError` if it does not match.
    """
    data = read_bytes(archive, "a backup", MAX_BYTES)
    if signed_by is not None:
        check_signature(data, archive, signed_by)
    return unpack(data, str(archive))


def fits_map(taken: Backup) -> bool:
    """Whether the backup was made for the same Modbus map as this version's."""
    return taken.files.get(REGISTERS) == _registers()


def _registers() -> bytes:
    """Register map of this version as CSV."""
    # imported late: a running cell needs no templates until it installs a release
    from edged.robots.formats import render

    return render("csv").encode()


# --- files of a cell --------------------------------------------------------------------------


def _collect(path: Path, config: Config, parts: Parts) -> tuple[dict[str, bytes], dict[str, str]]:
    """Members by name, and the files that are left out."""
    path = path.resolve()
    text = read_bytes(path, "a configuration").decode()
    files = {REGISTERS: _registers()}
    member, text = _placed(path, text, "rig", config.cell.rig)
    if parts.rig is not None:
        _add(files, member, config.cell.rig, parts.rig)
    if parts.cameras is not None:
        _add(files, _chosen_member(member), chosen_file(config.cell.rig), parts.cameras)
    if parts.connections is not None:
        beside = connections_file(config.cell.rig)
        _add(files, connections_file(Path(member)).as_posix(), beside, parts.connections)
    jobs, text = _placed(path, text, "jobs", config.cell.jobs)
    for place, data in parts.jobs.items():
        _add(files, f"{jobs}/{place}", config.cell.jobs / place, data)
    if config.zenoh.config_file is not None:
        member, text = _placed(path, text, "config_file", config.zenoh.config_file)
        _add(files, member, config.zenoh.config_file)
    if path.name in files:
        raise UserError(f"{path}: has the name of another file of the cell: {path.name}")
    files[path.name] = text.encode()
    left_out = {place: str(file) for place, file in config.machine_files().items()}
    if config.fleet is not None:
        left_out["fleet.root"] = str(config.fleet.root)  # a root of trust is not distributed by backups
    if (golden := golden_file(config.cell.rig, 0).parent).is_dir():
        left_out["golden"] = str(golden)  # it belongs to the robot's taught path
    if (marks := marks_file(config.cell.rig)).is_file():
        left_out["marks"] = str(marks)  # they belong to the plate at its present position
    if (accepted := acceptance_file(config.cell.rig)).is_file():
        left_out["acceptance"] = str(accepted)  # a cell restored elsewhere was not tested there
    if config.cameras.folder is not None:
        left_out["cameras.folder"] = str(config.cameras.folder)
    return files, left_out


def _chosen_member(rig: str) -> str:
    """Name of the member with the cameras that were chosen for a rig."""
    return chosen_file(Path(rig)).as_posix()


def _add(files: dict[str, bytes], member: str, path: Path, data: bytes | None = None) -> None:
    problem = wrong_name(member)
    if problem or member in files or member == MANIFEST:
        raise UserError(f"{path}: cannot be {member!r} in a backup: {problem or 'the name is taken'}")
    files[member] = read_bytes(path, "a file of a backup") if data is None else data


def _placed(config: Path, text: str, key: str, target: Path) -> tuple[str, str]:
    """Member name for a file or folder that the configuration names, and the configuration's matching text.

    Files under the configuration's folder keep their relative path; others move directly into it.
    """
    folder, target = config.parent, Path(os.path.abspath(target))  # noqa: PTH100  (a link keeps its own name)
    if target.is_relative_to(folder) and target != folder:
        member = target.relative_to(folder).as_posix()
    else:
        member = target.name
    section = "zenoh" if key == "config_file" else "cell"
    wanted = toml_of(text)
    if wanted[section][key] == member:
        return member, text
    wanted[section][key] = member
    # edit only this value, to keep the integrator's comments
    begins = rf"[ \t]*(?:{section}[ \t]*\.[ \t]*)?{key}[ \t]*=[ \t]*"
    line = re.compile(rf"^({begins})(\"[^\"\\]*\"|'[^']*')", re.MULTILINE)
    for found in line.finditer(text):
        edited = f'{text[: found.start(2)]}"{member}"{text[found.end(2) :]}'
        if toml_of(edited) == wanted:
            return member, edited
    raise UserError(f'{config}: {section}.{key}: expected on a line of its own, as {key} = "{target}"')


# --- the archive ------------------------------------------------------------------------------


def pack(taken: Backup) -> bytes:
    """Archive a backup as bytes. Raises `UserError` for too many or too large files."""
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "edged": taken.version,
        "created": taken.created.isoformat(),
        "cell": taken.cell,
        "config": taken.config,
        "fingerprint": taken.fingerprint,
        "left_out": dict(taken.left_out),
        "files": {
            name: {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
            for name, data in sorted(taken.files.items())
        },
    }
    if len(taken.files) >= MAX_MEMBERS or sum(map(len, taken.files.values())) > MAX_BYTES // 2:
        raise UserError(
            f"{taken.cell}: more than {MAX_MEMBERS} files or {MAX_BYTES // 2**21} MiB: not a cell"
        )
    members = {MANIFEST: json.dumps(manifest, indent=1).encode(), **dict(sorted(taken.files.items()))}
    return packed(members, int(taken.created.timestamp()))


def packed(members: Mapping[str, bytes], modified_s: int = 0) -> bytes:
    """Files as a compressed tar, in their order."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size, info.mtime, info.mode = len(data), modified_s, 0o644
            archive.addfile(info, io.BytesIO(data))
    return gzip.compress(buffer.getvalue(), mtime=0)


def unpack(data: bytes, place: str) -> Backup:
    """Read an archive and check all of it. Raises `FileFormatError` that names place and member."""
    members = members_of(data, place)
    try:
        manifest = json_of(members.pop(MANIFEST))
    except KeyError:
        raise FileFormatError(f"{place}: not a backup: {MANIFEST} is missing") from None
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{place}: {MANIFEST}: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise FileFormatError(f'{place}: {MANIFEST}: expected "format": "{FORMAT}"')
    if manifest.get("version") != VERSION:
        raise FileFormatError(f"{place}: version {manifest.get('version')!r}, this edged reads {VERSION}")
    listed = _table(manifest, "files", place)
    for name in sorted(listed.keys() | members.keys()):
        if name not in members or name not in listed:
            where = "the archive" if name not in members else MANIFEST
            raise FileFormatError(f"{place}: {name}: missing in {where}")
        content = members[name]
        stated = listed[name] if isinstance(listed[name], dict) else {}
        if (stated.get("bytes"), stated.get("sha256")) != (len(content), hashlib.sha256(content).hexdigest()):
            raise FileFormatError(f"{place}: {name}: checksum does not match: the archive is damaged")
    texts = {key: manifest.get(key) for key in ("edged", "cell", "config", "fingerprint", "created")}
    for key, text in texts.items():
        if not isinstance(text, str) or not text.isprintable() or len(text) > 200:
            raise FileFormatError(f"{place}: {MANIFEST}: {key}: expected a short text")
    if texts["config"] not in members:
        raise FileFormatError(f"{place}: {MANIFEST}: config: {texts['config']!r} is not in the archive")
    try:
        created = datetime.fromisoformat(str(texts["created"])).astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise FileFormatError(f"{place}: {MANIFEST}: created: {error}") from error
    left_out = {str(key): str(file) for key, file in _table(manifest, "left_out", place).items()}
    return Backup(
        created,
        str(texts["edged"]),
        str(texts["cell"]),
        str(texts["config"]),
        str(texts["fingerprint"]),
        members,
        left_out,
    )


def members_of(data: bytes, place: str) -> dict[str, bytes]:
    """Content of an archive's members by name. Raises `FileFormatError` for other than plain, safe files."""
    found: dict[str, bytes] = {}
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
            plain = packed.read(MAX_BYTES + 1)
        if len(plain) > MAX_BYTES:
            raise FileFormatError(f"{place}: unpacks to more than {MAX_BYTES // 2**20} MiB: not a backup")
        with tarfile.open(fileobj=io.BytesIO(plain), mode="r:") as archive:
            for info in archive:
                problem = wrong_name(info.name)
                if info.name in found:
                    problem = "it is there twice"
                elif not info.isreg() or info.issparse():
                    problem = "expected a plain file"
                elif len(found) >= MAX_MEMBERS:
                    problem = f"more than {MAX_MEMBERS} files"
                if problem:
                    raise FileFormatError(f"{place}: {info.name!r}: {problem}")
                file = archive.extractfile(info)
                found[info.name] = b"" if file is None else file.read()
    except (tarfile.TarError, EOFError, OSError, zlib.error, ValueError) as error:
        raise FileFormatError(f"{place}: not a backup, or damaged: {error}") from error
    return found


def wrong_name(name: str) -> str:
    """Why a member may not have this name; "" if it may."""
    if all(PART.fullmatch(part) for part in name.split("/")) and len(name) <= 1000:
        return ""
    return "expected a relative path without .. and hidden parts, of letters, digits and _ . + @ = -"


def _table(manifest: dict[str, Any], key: str, place: str) -> dict[str, Any]:
    value = manifest.get(key)
    if not isinstance(value, dict):
        raise FileFormatError(f"{place}: {MANIFEST}: {key}: expected an object")
    return value


def names_in(text: bytes, place: str) -> dict[str, str]:
    """Files that a configuration names, by dotted option. Raises `UserError` if it is not TOML."""
    try:
        document = toml_of(text)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise UserError(f"{place}: what it stands on cannot be told: not TOML: {error}") from error
    found = {}
    for section, key in (("cell", "rig"), ("cell", "jobs"), ("zenoh", "config_file")):
        table = document.get(section)
        if isinstance(table, dict) and isinstance(table.get(key), str):
            found[f"{section}.{key}"] = table[key]
    return found
