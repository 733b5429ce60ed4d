"""Limit the time and memory that a library may take to read a file."""

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
"""Processor time between two checks: a library that makes objects fills some megabytes in it."""


class _TooMuch(BaseException):
    """Not an `Exception`, so that a library that catches those cannot swallow it."""


@contextmanager
def reading_cost(path: Path, memory_bytes: int, cpu_s: float) -> Iterator[None]:
    """Limit the additional memory and the processor time of the enclosed code.

    Raises `FileFormatError` that names the file and the limit, with the code "large". Enforced only in
    the main thread, where commands and the worker process read files.

    The code is interrupted while some memory is left: when no small object can be allocated at all
    (RLIMIT_AS), CPython 3.11 searches for the handler of its MemoryError for ever.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signal handlers work only in the main thread
        return
    most_bytes, most_s = _memory_bytes() + memory_bytes, time.process_time() + cpu_s

    def look(_number: int, _frame: object) -> None:
        if _memory_bytes() > most_bytes:
            raise _TooMuch(f"{memory_bytes >> 20} MiB")
        if time.process_time() > most_s:
            raise _TooMuch(f"{cpu_s:g} s of processor time")

    before = signal.signal(signal.SIGPROF, look)
    # repeating: an exception raised in a destructor is lost
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
