"""Resources that a process holds, for tools and tests that check for leaks."""

from __future__ import annotations

import os
from pathlib import Path


def resident_bytes(process: int) -> int:
    """Resident memory of a process."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def footprint(process: int, log: Path) -> tuple[int, int, int]:
    """Resident bytes, number of open files, size of its log in bytes."""
    return resident_bytes(process), len(list(Path(f"/proc/{process}/fd").iterdir())), log.stat().st_size
