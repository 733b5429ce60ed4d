"""What a process gives up that serves people beside a cell: privileges, and its turn."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
from pathlib import Path

log = logging.getLogger(__name__)

NICER = 10
OOM_SCORE = 500
"""/proc/self/oom_score_adj: where memory is short, the page goes before the cell."""
PR_SET_NO_NEW_PRIVS, PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL = 38, 47, 4
CAPABILITY_VERSION = 0x20080522
"""<linux/prctl.h>, <linux/capability.h>."""


def become_lesser() -> None:
    """Give way to the cell in processor time and memory, and keep no capability and no way to new ones.

    Root keeps its own: it reads and writes the files of others.
    """
    with contextlib.suppress(OSError):
        os.nice(NICER)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    if os.geteuid() == 0:
        return
    libc.prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)
    header = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION, 0)
    none = (ctypes.c_uint32 * 6)()
    if libc.capset(header, none) != 0:
        log.warning("the page keeps its capabilities: %s", os.strerror(ctypes.get_errno()))
