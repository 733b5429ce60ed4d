"""What a process holds, for tools and tests that look whether it grows."""

from __future__ import annotations

import os
from pathlib import Path


def resident_bytes(process: int) -> int:
    """Memory of a process that is not swapped out."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def footprint(process: int, log: Path) -> tuple[int, int, int]:
    """Resident bytes, open files, bytes of its log."""
    return resident_bytes(process), len(list(Path(f"/proc/{process}/fd").iterdir())), log.stat().st_size
