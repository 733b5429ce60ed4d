"""Bounds on the time and memory that a library may take to read a file."""

from __future__ import annotations

import resource
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edged.errors import FileFormatError

WATCHED_S = 0.01
"""Of processor time, between two looks: a library that makes objects fills some megabytes in it."""


class _TooMuch(BaseException):
    """No `Exception`: a library that goes on after any of those must not after this one."""


@contextmanager
def reading_cost(path: Path, memory_bytes: int, cpu_s: float) -> Iterator[None]:
    """Let what is inside take so much more memory, and so much processor time.

    Raises `FileFormatError` that names the file and the bound, with the code "large". Both are watched in
    the main thread alone, where commands and the worker process read.

    What is watched is ended while there still is memory to end it with: where a small object can no longer be
    made at all (RLIMIT_AS), CPython 3.11 looks for the handler of its MemoryError for ever.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are for the main thread
        return
    most_bytes, most_s = _memory_bytes() + memory_bytes, time.process_time() + cpu_s

    def look(_number: int, _frame: object) -> None:
        if _memory_bytes() > most_bytes:
            raise _TooMuch(f"{memory_bytes >> 20} MiB")
        if time.process_time() > most_s:
            raise _TooMuch(f"{cpu_s:g} s of processor time")

    before = signal.signal(signal.SIGPROF, look)
    # again and again: what is raised in a destructor is lost
    signal.setitimer(signal.ITIMER_PROF, WATCHED_S, WATCHED_S)
    try:
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    except _TooMuch as much:
        raise FileFormatError(f"{path}: takes more than {much} to read: expected one part", "large") from None
    finally:
        signal.signal(signal.SIGPROF, before)


def _memory_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()
