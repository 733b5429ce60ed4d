"""What the worker process does in tests."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

from edged.commissioning.pairs import Progress
from edged.errors import CalibrationError


def about(_progress: Progress) -> dict[str, int]:
    """The process: its niceness, its score where memory runs out, its processors and threads."""
    return {
        "pid": os.getpid(),
        "nice": os.nice(0),
        "oom": int(Path("/proc/self/oom_score_adj").read_text()),
        "cpus": len(os.sched_getaffinity(0)),
        "threads": threading.active_count(),
    }


def count(progress: Progress, total: int) -> list[int]:
    """Told at each step."""
    for number in range(total + 1):
        progress("counting", number, total)
    return list(range(total))


def refuse(_progress: Progress, message: str) -> None:
    """A mistake in what it was given."""
    raise CalibrationError(message)


def fail(_progress: Progress) -> None:
    """A bug."""
    raise ZeroDivisionError("that was a bug")


def hang(progress: Progress) -> None:
    """For ever, in a loop of Python."""
    progress("hanging", 0, 0)
    while True:
        time.sleep(0.01)


def leave(_progress: Progress, code: int) -> None:
    """As a process that the kernel ends."""
    os._exit(code)


def vanish(_progress: Progress, *_: object) -> None:
    """The same, whatever is asked."""
    os._exit(9)
