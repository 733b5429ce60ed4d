"""`edged registers`: the Modbus map and client sources, from the schema that encodes it."""

from __future__ import annotations

import sys
from pathlib import Path

from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.outputs import make_folder
from edged.robots.texts import SEVERAL, render


def registers(fmt: str, folder: Path | None) -> int:
    """Print the map, or a client's source; or write a client's files into a folder, and print their names.

    Raises `UserError` for another format, for files without a folder, and for a folder without files.
    """
    writer = SEVERAL.get(fmt)
    if (writer is None) != (folder is None):
        needs = (
            "is one file: print it into one with >" if writer is None else "is several files: --output FOLDER"
        )
        raise UserError(f"--format {fmt} {needs}")
    if writer is None or folder is None:
        sys.stdout.write(render(fmt))
        return 0
    make_folder(folder)
    for name, text in writer().items():
        write_file(folder / name, text.encode())
        print(folder / name)
    return 0
