"""What a process gives up that serves people beside a cell: privileges, and its turn.

`python -m edged.app.lesserprocess PROGRAM ...` becomes that program without them. Capabilities go with the
change of the program, as they come by the ambient set: the filter of the systemd units forbids capset(2).
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from edged.setup.jobs.workerprocess import gain_no_more_rights, python_environment

LESSER = (sys.executable, "-m", "edged.app.lesserprocess")
"""Before a program that is to be less."""
NICER = 10
OOM_SCORE = 500
"""/proc/self/oom_score_adj: where memory is short, the page goes before the cell."""


def become(program: Sequence[str]) -> None:
    """Become a program that gives way to the cell in processor time and memory, and has no capabilities.

    Root keeps its own: it reads and writes the files of others.
    """
    with contextlib.suppress(OSError):
        os.nice(NICER)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(OOM_SCORE))
    gain_no_more_rights()
    os.execv(program[0], list(program))


def environment() -> dict[str, str]:
    """That of a Python beside a cell; systemd hears the cell alone."""
    ours = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
    return {name: text for name, text in python_environment().items() if name not in ours}


if __name__ == "__main__":
    become(sys.argv[1:])
