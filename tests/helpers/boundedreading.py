"""Read files, each in a process with limited memory and CPU time; prints each outcome as a line of JSON.
python boundedreading.py READER FILE [READER FILE ...]
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path

from edged.config import reading
from edged.errors import UserError
from edged.files import images, recording
from edged.files.arrays import unpack_arrays
from edged.files.dxf import read_dxf
from edged.files.rig import load_rig
from edged.files.rigformats import opencv
from edged.files.rigformats.files import DEFAULTS
from edged.files.stl import read_stl
from edged.files.tables import read_table
from edged.setup.releases import archive

ROOM_BYTES = 300 << 20
"""Address space that a reader may use beyond what the process already has."""
SECONDS = 20
READERS: dict[str, Callable[[Path], object]] = {
    "archive": archive.read,
    "configuration": reading.load,
    "drawing": read_dxf,
    "model": read_stl,
    "opencv": lambda path: opencv.read(path, DEFAULTS),
    "picture": images.load_image,
    "recording": recording.load,
    "recorded picture": lambda path: recording.load_picture(path, "left"),
    "rig": load_rig,
    "shape": lambda path: unpack_arrays(path.read_bytes(), path, "edged-shape", 1),
    "snapshot": recording.load_snapshot,
    "table": read_table,
}


def main() -> None:
    """Read the files one after the other, each in a process of its own."""
    for reader, path in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        child = os.fork()
        if child == 0:
            try:
                read(READERS[reader], Path(path))
            except MemoryError:
                print(json.dumps({"failed": "MemoryError"}), flush=True)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if status:
            print(json.dumps({"failed": f"ended by {status}"}), flush=True)


def read(reader: Callable[[Path], object], path: Path) -> None:
    """Read under the limits and report the outcome."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ROOM_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        reader(path)
    except UserError as error:
        print(json.dumps({"refused": str(error)}), flush=True)
    else:
        print(json.dumps({"failed": "it was read"}), flush=True)


if __name__ == "__main__":
    main()
