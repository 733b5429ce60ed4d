"""Restores a backup into a folder, in one step.

A folder may hold several cells: only files of the one in the archive are replaced.
"""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

from edged.config.chosencameras import chosen_file
from edged.config.chosenconnections import connections_file
from edged.errors import FileFormatError, UserError, translated
from edged.files.atomic import read_bytes
from edged.files.replacing import replace_files
from edged.owners import as_owner, named_path, resolved
from edged.setup.releases.archive import REGISTERS, Backup, names_in, wrong_name


def restore(taken: Backup, output: Path, *, force: bool) -> Path | None:
    """Restore a cell into `output` in one step; return the folder with its former files, None without any.

    force : replace this cell's files in it; others stay as they are. Raises `UserError`; then nothing has
    changed.
    """
    output = named_path(output)
    with translated(FileFormatError, f"{output}: cannot be written"):
        if output.exists() and not output.is_dir():
            raise UserError(f"{output}: exists and is no folder")
        if output.is_dir() and any(output.iterdir()) and not force:
            raise UserError(
                f"{output}: is not empty; choose another folder, or replace this cell's files in it",
                "not_empty",
            )
        with as_owner(output.parent) as above:
            place = resolved(above / output.name)
            keep = _unused(place.with_name(f"{place.name}.before-restore"))
            is_kept = _put(taken, place, output, keep)
        return resolved(output).with_name(keep.name) if is_kept else None


def _put(taken: Backup, place: Path, output: Path, keep: Path) -> bool:
    """Replace the files; return whether former ones are kept. output : path for messages."""
    names = names_in(taken.files[taken.config], f"{taken.config} of the backup")
    replaced = _replaced(taken, place, names.get("cell.jobs", ""))
    rig = names.get("cell.rig", "")
    beside = [chosen_file(Path(rig)).as_posix(), connections_file(Path(rig)).as_posix()] if rig else []
    # otherwise this cell would take over cameras and connections of another one
    replaced |= {name for name in beside if not wrong_name(name) and os.path.lexists(place / name)}
    _leave_others_alone(taken, place, output, replaced)
    private = {taken.config, names.get("zenoh.config_file", taken.config), *beside[1:]}
    return replace_files(place, taken.files, replaced, keep, private=private)


def _replaced(taken: Backup, output: Path, jobs: str) -> set[str]:
    """Names to replace in the folder: existing members, symbolic links above them, and all former jobs."""
    replaced = {name for name in taken.files if os.path.lexists(output / name)}
    parents = {str(parent) for name in taken.files for parent in PurePosixPath(name).parents}
    replaced |= {parent for parent in parents if (output / parent).is_symlink()}
    if not wrong_name(jobs) and (output / jobs).is_dir():
        replaced |= {
            file.relative_to(output).as_posix()
            for file in (output / jobs).rglob("*")
            if file.is_symlink() or not file.is_dir()
        }
    return replaced


def _leave_others_alone(taken: Backup, place: Path, output: Path, replaced: set[str]) -> None:
    """Raise `UserError` if another cell in the folder uses a file that would change."""
    changed = [
        (place / name).resolve()
        for name in replaced | taken.files.keys()
        if name != REGISTERS and not _is_same(place / name, taken.files.get(name))
    ]
    for other in sorted(place.glob("*.toml")):
        if other.name == taken.config or not other.is_file():
            continue
        for option, name in names_in(read_bytes(other, "a configuration"), str(output / other.name)).items():
            used = (place / name).resolve()
            if any(file.is_relative_to(used) for file in changed):
                raise UserError(
                    f"{output}: {option} of {other.name} is {name}, too, and would become another one; "
                    "restore into another folder"
                )


def _is_same(file: Path, data: bytes | None) -> bool:
    return data is not None and file.is_file() and read_bytes(file, "a file of the cell") == data


def _unused(path: Path) -> Path:
    names = (path.with_name(f"{path.name}-{number}") for number in range(1, 10_000))
    return next(name for name in names if not name.exists())
