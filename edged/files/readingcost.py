"""Bounds on the time and memory that a library may take to read a file."""

from __future__ import annotations

import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edged.errors import FileFormatError

REPEAT_S = 0.1


class _OutOfTime(BaseException):
    """No `Exception`: a library that goes on after any of those must not after this one."""


@contextmanager
def reading_cost(path: Path, memory_bytes: int, cpu_s: float) -> Iterator[None]:
    """Let what is inside take so much more memory, and so much processor time.

    Raises `FileFormatError` that names the file and the bound, with the code "large". The time is watched in
    the main thread alone, where commands and the worker process read.
    """
    with _memory(memory_bytes), _time(cpu_s):
        try:
            yield
        except MemoryError as error:
            raise _too_much(path, f"{memory_bytes >> 20} MiB") from error
        except _OutOfTime as error:
            raise _too_much(path, f"{cpu_s:g} s of processor time") from error


def _too_much(path: Path, most: str) -> FileFormatError:
    return FileFormatError(f"{path}: takes more than {most} to read: expected one part", "large")


@contextmanager
def _memory(more_bytes: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + more_bytes
    for limit in (soft, hard):
        most = most if limit == resource.RLIM_INFINITY else min(most, limit)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def _time(cpu_s: float) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are for the main thread
        return

    def end(_number: int, _frame: object) -> None:
        raise _OutOfTime

    before = signal.signal(signal.SIGVTALRM, end)
    # again and again: what is raised in a destructor is lost
    signal.setitimer(signal.ITIMER_VIRTUAL, cpu_s, REPEAT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
