"""Check that a command can write its outputs before it starts work."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from edged.errors import FileFormatError, UserError, translated
from edged.owners import as_owner


def check_outputs(
    outputs: Mapping[str, Path | None], inputs: Mapping[str, Path | None] | None = None
) -> None:
    """Refuse outputs that cannot be written, that share one file, or that would overwrite an input.

    outputs, inputs : by the name of their option or argument; None: not used.
    Raises `UserError` that names them.
    """
    named: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        place = path.resolve()
        if place in named:
            raise UserError(f"{named[place]} and {option} are the same file, {path}: expected two")
        named[place] = option
        _check_file(path)
    for option, path in (inputs or {}).items():
        if path is not None and path.resolve() in named:
            output = named[path.resolve()]
            raise UserError(f"{output} is {option}, {path}, which would be lost; expected another file")


def check_folder(path: Path) -> None:
    """Refuse a path that is not a folder or cannot be created or written to. Raises `FileFormatError`."""
    if path.exists():
        if not path.is_dir():
            raise FileFormatError(f"{path}: is a file, expected a folder to write")
        _check_takes(path, path)
        return
    above = next(folder for folder in path.resolve().parents if folder.exists())
    if not above.is_dir():
        raise FileFormatError(f"{path}: {above} is a file, expected a folder")
    _check_takes(path, above)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents; when running as root, do so as their owner.

    Raises `FileFormatError`.
    """
    with translated(FileFormatError, f"{folder}: cannot be written"), as_owner(folder) as place:
        place.mkdir(parents=True, exist_ok=True)


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise FileFormatError(f"{path}: is a folder, expected a file to write")
    folder = path.resolve().parent
    if not folder.is_dir():
        raise FileFormatError(f"{path}: there is no folder {folder} to write into")
    _check_takes(path, folder)


def _check_takes(path: Path, folder: Path) -> None:
    """Check that the folder is writable, with a temporary file: files are written there and then renamed."""
    with (
        translated(FileFormatError, f"{path}: cannot be written into {folder}"),
        tempfile.TemporaryFile(dir=folder),
    ):
        pass
