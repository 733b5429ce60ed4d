"""What a process gives up that serves people beside a cell: privileges, and its turn.

`python -m edged.app.lesserprocess PROGRAM ...` becomes that program without them. Capabilities go with the
change of the program, as they come by the ambient set: the filter of the systemd units forbids capset(2).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Sequence
from pathlib import Path

NICER = 10
OOM_SCORE = 500
"""/proc/self/oom_score_adj: where memory is short, the page goes before the cell."""
PR_SET_NO_NEW_PRIVS, PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL = 38, 47, 4
"""<linux/prctl.h>."""


def become(program: Sequence[str]) -> None:
    """Become a program that gives way to the cell in processor time and memory, and has no capabilities.

    Root keeps its own: it reads and writes the files of others.
    """
    with contextlib.suppress(OSError):
        os.nice(NICER)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    libc.prctl(PR_CAP_AMBIENT, PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)
    os.execv(program[0], list(program))


if __name__ == "__main__":
    become(sys.argv[1:])
