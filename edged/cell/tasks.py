"""Helpers to cancel and await tasks, and to bound blocking calls in time."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from edged.errors import TookTooLong

Result = TypeVar("Result")


async def both(
    left: Coroutine[Any, Any, Result], right: Coroutine[Any, Any, Result], timeout_s: float
) -> tuple[Result, Result]:
    """Run two coroutines as one: return both results, or raise one error with neither still running.

    The first error wins, and the other task is cancelled and awaited before it is raised; likewise
    when the caller is cancelled. Raises `TimeoutError` when either is not done within timeout_s.
    This exists because `asyncio.gather` leaves the other task running, and a `TaskGroup` inside
    `asyncio.timeout` can surface a CancelledError on Python 3.11.
    """
    tasks = (asyncio.ensure_future(left), asyncio.ensure_future(right))
    try:
        await asyncio.wait(tasks, timeout=timeout_s, return_when=asyncio.FIRST_EXCEPTION)
        for task in tasks:
            if task.done():
                task.result()
        if not all(task.done() for task in tasks):
            raise TimeoutError
        return tasks[0].result(), tasks[1].result()
    finally:
        await cancel_and_await(*tasks)


async def cancel_and_await(*tasks: asyncio.Future[Any]) -> None:
    """Cancel tasks and wait until they have ended, even if cancelled meanwhile; their results are dropped."""
    cancelled: asyncio.CancelledError | None = None
    for task in tasks:
        task.cancel()
    while not all(task.done() for task in tasks):
        try:
            await asyncio.wait(tasks)
        except asyncio.CancelledError as error:
            cancelled = error
    for task in tasks:
        if not task.cancelled():
            task.exception()  # retrieved, or asyncio would complain
    if cancelled is not None:
        raise cancelled


async def bounded(
    work: Callable[[], Result], timeout_s: float, what: str, undo: Callable[[Result], object] | None = None
) -> Result:
    """Run a blocking call on a thread of its own. Raises `TookTooLong`, and what the call raises.

    undo : called with a result that comes too late.
    Does not use `asyncio.to_thread`, whose threads are joined at exit, so that a hanging one would block it.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Result] = loop.create_future()
    is_left = threading.Event()

    def settle(setter: Callable[[Any], None], value: object) -> None:
        if not done.done():
            setter(value)

    def run() -> None:
        setter: Callable[[Any], None]
        value: object
        try:
            result = work()
            setter, value = done.set_result, result
            if is_left.is_set() and undo is not None:
                undo(result)
        except Exception as error:  # noqa: BLE001  (any error is raised by the await below)
            setter, value = done.set_exception, error
        with contextlib.suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(settle, setter, value)

    thread = threading.Thread(target=run, name=what, daemon=True)
    thread.start()
    try:
        return await asyncio.wait_for(done, timeout_s)
    except TimeoutError as error:
        raise TookTooLong(f"{what} took longer than {timeout_s:g} s") from error
    finally:
        is_left.set()
        if not done.cancelled():
            thread.join()  # it has only its last line left
