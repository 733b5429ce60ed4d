"""`edged registers`: the Modbus map and the programs for robots and PLCs, from the schema that encodes it."""

from __future__ import annotations

import sys
from pathlib import Path

from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.outputs import make_folder
from edged.robots.formats import written


def registers(fmt: str, folder: Path | None) -> int:
    """Print a format that is one file, or write its files into a folder and print their names.

    Raises `UserError` for another format, for files without a folder, and for a folder without files.
    """
    files = written(fmt)
    if (len(files) == 1) != (folder is None):
        needs = "is one file: print it into one with >" if folder else "is several files: --output FOLDER"
        raise UserError(f"--format {fmt} {needs}")
    if folder is None:
        sys.stdout.writelines(files.values())
        return 0
    make_folder(folder)
    for name, text in files.items():
        write_file(folder / name, text.encode())
        print(folder / name)
    return 0
