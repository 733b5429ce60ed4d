"""The same work for both cameras, side by side.

Kernels release the GIL, so the right image is measured on a second core while the left one is on the first.
One thread, started with the first use and joined by the interpreter at its end; what it returns does not
depend on who is done first.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_RIGHT = ThreadPoolExecutor(1, thread_name_prefix="right-camera")


def for_both(work: Callable[[int], T]) -> tuple[T, T]:
    """(work(0), work(1)), the second one in its own thread. An error of either is raised when both ended.

    The work must not call `for_both` itself.
    """
    right = _RIGHT.submit(work, 1)
    try:
        left = work(0)
    finally:
        right.exception()  # waits
    return left, right.result()
