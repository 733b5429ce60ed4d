"""Accesses to a disk that may be full, broken, or answer nothing for hours, as a share of a dead server does.

Python waits at its end for the threads of `asyncio.to_thread` and `ThreadPoolExecutor`, so one access that
hangs would keep a stopped cell alive. Those here are daemon threads.
"""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar

from edged.errors import ImageError

log = logging.getLogger(__name__)

Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

HANG_S = 30.0
"""A disk that takes longer hangs: as long as Linux waits for a command of a SCSI disk
(/sys/block/*/device/timeout)."""
POLL_S = 0.02


async def ended(thread: threading.Thread) -> None:
    """Wait for the end of a thread; if this is cancelled, the process can end without it."""
    while thread.is_alive():  # noqa: ASYNC110  (the end of a thread is no event of the loop)
        await asyncio.sleep(POLL_S)


class DiscThread(Executor):
    """Runs accesses one after another."""

    def __init__(self, name: str) -> None:
        self._calls = queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(
        self, fn: Callable[Arguments, Result], /, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> Future[Result]:
        """Run a call after those before it."""
        future = Future[Result]()
        self._calls.put((future, partial(fn, *args, **kwargs)))
        return future

    async def close(self, *, drop: bool) -> None:
        """Run what was submitted, and end. drop : only what is running."""
        while drop and not self._calls.empty():
            if (call := self._calls.get()) is not None:
                call[0].cancel()
        self._calls.put(None)
        await ended(self._thread)

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            future, work = call
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(work())
                except BaseException as error:  # noqa: BLE001  (whoever waits for the result raises it)
                    future.set_exception(error)


class HasProblem(Protocol):
    """Figures whose problem is "" while all is well."""

    problem: str


class DiscGuard:
    """Says once in the log that a disk fails or hangs, and once that it works again.

    figures : get the problem. lost, again : what the log says, "no recordings" and "recording again".
    """

    def __init__(
        self, figures: HasProblem, folder: Path, lost: str, again: str,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._figures, self._folder, self._lost, self._again = figures, folder, lost, again
        self._clock_s = clock_s
        self._began_s: float | None = None

    @contextmanager
    def access(self) -> Iterator[None]:
        """Access the disk, on its thread; `OSError` and `ImageError` end the access, and are the problem."""
        problem, self._began_s = "", self._clock_s()
        try:
            yield
        except (OSError, ImageError) as error:
            problem = f"{getattr(error, 'strerror', None) or error}"
        finally:
            self._began_s = None
        self._say(problem)

    def look(self) -> None:
        """See whether the running access hangs; to be called on another thread."""
        began_s = self._began_s
        if began_s is not None and self._clock_s() - began_s > HANG_S:
            self._say(f"the disk has not answered for {HANG_S:g} s")

    def _say(self, problem: str) -> None:
        if problem and not self._figures.problem:
            log.error("%s: %s: %s", self._lost, self._folder, problem)
        elif self._figures.problem and not problem:
            log.info(self._again)
        self._figures.problem = problem and f"{self._folder}: {problem}"
