"""Runs a program that serves people beside a cell with lower priority and without privileges.

`python -m edged.app.unprivileged PROGRAM ...` becomes that program. Its capabilities come from the ambient
set, so they are dropped by the exec; the system call filter of the systemd units forbids capset(2).
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from edged.setup.jobs.workerprocess import gain_no_more_rights, python_environment

UNPRIVILEGED_PREFIX = (sys.executable, "-m", "edged.app.unprivileged")
"""Command prefix for a program that is to run with less priority and privilege."""
NICER = 10
OOM_SCORE = 500
"""/proc/self/oom_score_adj: if memory runs out, the page is killed before the cell."""


def become(program: Sequence[str]) -> None:
    """Become a program that yields processor time and memory to the cell and has no capabilities.

    Root keeps its capabilities, since it reads and writes files of other users.
    """
    with contextlib.suppress(OSError):
        os.nice(NICER)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))
    gain_no_more_rights()
    os.execv(program[0], list(program))


def environment() -> dict[str, str]:
    """Return the environment for a Python process beside a cell; only the cell itself may notify systemd."""
    ours = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
    return {name: text for name, text in python_environment().items() if name not in ours}


if __name__ == "__main__":
    become(sys.argv[1:])
