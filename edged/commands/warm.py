"""`edged warm`: compiles the kernels before they are needed."""

from __future__ import annotations

import importlib
import logging
import os
import pkgutil
import sys
from pathlib import Path

import cv2
import numba

import edged
from edged.files.atomic import write_file
from edged.vision.kernels.jitcache import COMPILING


def warm(*, only_if_needed: bool) -> int:
    """Compile the kernels of every module of the numerical core and the virtual cell.

    only_if_needed : do nothing if a stamp in NUMBA_CACHE_DIR shows that nothing has changed since the last
    time.
    """
    cache = os.environ.get("NUMBA_CACHE_DIR")
    stamp = Path(cache) / "edged-warm" if cache else None
    key = _key()
    if only_if_needed and stamp is not None and stamp.is_file() and stamp.read_text() == key:
        return 0
    sys.stderr.write(f"edged: {COMPILING}\n")
    logging.getLogger("edged.vision.kernels").setLevel(logging.ERROR)  # already printed above
    import edged.sim
    import edged.vision
    from edged.vision.kernels.jit import load_all

    for package in (edged.vision, edged.sim):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            load_all(importlib.import_module(module.name))
    if stamp is not None:
        write_file(stamp, key.encode())
    return 0


def _key() -> str:
    """Return a key that changes with the sources or the versions of compiler and libraries."""
    root = Path(edged.__file__).parent
    sources = sorted(root.rglob("*.py"))
    newest_ns = max(source.stat().st_mtime_ns for source in sources)
    return f"{newest_ns} {len(sources)} numba {numba.__version__} cv2 {cv2.__version__} python {sys.version}"
